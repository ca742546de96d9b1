"""Rows of all lanes, copied to one array of observations for each environment."""

import numpy as np
import pytest

from rendezvous_env import compilation
from rendezvous_env.engine.memory import LaneBlock
from rendezvous_env.engine.memory.transposition import TILE, transpose_tile
from rendezvous_env.engine.stages.write_observations import write_observations

LANES = LaneBlock().lanes
pytestmark = pytest.mark.kernels


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("n_robots", [2, 3, 4, 7])
@pytest.mark.parametrize("batch", [LANES, LANES + 2, 2 * LANES + 7])
def test_write_observations_moves_each_lane_to_its_environment(batch, n_robots, dim):
    blocks, others = -(-batch // LANES), n_robots - 1
    rows = np.arange(blocks * n_robots * others * LANES * dim, dtype=np.float32)
    rows = rows.reshape(blocks, n_robots, others, LANES * dim)
    written = np.full((batch, n_robots, others, dim), np.nan, np.float32)
    write_observations(LaneBlock(), tuple(range(dim)), 0, blocks, rows, written)
    lanes = rows.reshape(blocks, n_robots, others, LANES, dim).transpose(0, 3, 1, 2, 4)
    expected = lanes.reshape(blocks * LANES, n_robots, others, dim)[:batch]
    np.testing.assert_array_equal(written, expected)


def test_write_observations_writes_only_the_environments_of_its_blocks():
    rows = np.ones((1, 3, 2, 2 * LANES), np.float32)
    written = np.zeros((3 * LANES, 3, 2, 2), np.float32)
    write_observations(LaneBlock(), (0, 1), 1, 2, rows, written)
    assert (written[LANES : 2 * LANES] == 1.0).all()
    assert (written[:LANES] == 0.0).all()
    assert (written[2 * LANES :] == 0.0).all()


@compilation.kernel
def _transposed(source, width, start, target, length, begin):
    transpose_tile(source, start, width, target, begin, length)


def test_transpose_tile_equals_that_of_numpy():
    matrix, transposed = np.arange(42.0).reshape(6, 7), np.zeros((7, 6))
    _transposed(matrix.reshape(-1), 7, 7 + 2, transposed.reshape(-1), 6, 2 * 6 + 1)
    tile = np.s_[1 : 1 + TILE], np.s_[2 : 2 + TILE]
    np.testing.assert_array_equal(transposed.T[tile], matrix[tile])
    assert np.count_nonzero(transposed) == TILE * TILE
