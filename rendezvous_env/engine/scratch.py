"""Working memory of a thread: the lane buffers of the block at hand."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .lanes import LANES
from .teams import SCORES

NEAR, WAY, TOUCHES, SCORED = range(4)
"""Rows of ``Scratch.tally``: whether something can meet in the team in this step, 0 no, 1 yes, 2 it
has merged; the paths of all its robots together, m; robots in contact with an obstacle; and from
the last on what becomes the rows of ``Results.scores``."""


class Scratch(NamedTuple):
    """Lane buffers of the block at hand."""

    action: NDArray[np.float64]
    """(n, a·LANES), in the robots' own frames; clipped inputs of nonholonomic robots."""
    displacement: NDArray[np.float64]
    """(n, (d + 1)·LANES), m, and its length."""
    tally: NDArray[np.float64]
    """(rows·LANES,), what happens to the teams in this step; see NEAR."""
    took_part: NDArray[np.bool_]
    """(LANES, n), which robots of a team that has merged existed before."""
    pair: NDArray[np.float64]
    """((4 + d)·LANES,), see ``see_pair``; after all pairs its first number is half of V."""
    rows: NDArray[np.float32]
    """(n·rows, d·LANES), the observations, the d numbers of a lane side by side."""
    balls: NDArray[np.float64]
    """(M, (d + 2)·LANES), the obstacles: centre and radius of the bounding ball, and the radius of
    a disc in the plane, m; NaN is none."""
    sight: NDArray[np.float64]
    """(LANES,), from how near a robot sees obstacles, m; −inf once it is gone."""
    disc: NDArray[np.float64]
    """(7·LANES,), see ``see_disc``."""


@kernel
def make_scratch(n, d, action_size, rows, n_obstacles):
    """Lane buffers for teams of n robots among at most that many obstacles."""
    return Scratch(
        np.zeros((n, action_size * LANES)),
        np.zeros((n, (d + 1) * LANES)),
        np.zeros((SCORED + SCORES) * LANES),
        np.zeros((LANES, n), dtype=np.bool_),
        np.zeros((4 + d) * LANES),
        np.zeros((n * rows, d * LANES), dtype=np.float32),
        np.full((n_obstacles, (d + 2) * LANES), np.nan),
        np.zeros(LANES),
        np.zeros(7 * LANES),
    )
