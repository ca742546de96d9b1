"""f and contraction where a_ij need not be a_ji."""

from __future__ import annotations

import numpy as np

from rendezvous_env.graphs.merging import contract, contract_arcs
from rendezvous_env.physics.potential import (
    lyapunov_of_links,
    net_bearings_of_arcs,
    net_bearings_of_links,
)

PLACES = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [2.0, 3.0]])
ARCS = np.array([[0, 2.0, 0, 0], [0.5, 0, 0, 1.0], [0, 0.25, 0, 4.0], [3.0, 0, 0, 0]])


def links_of(arcs):
    """What takes pairs gets of them: mean weights."""
    mean = (arcs + arcs.T) / 2
    first, second = np.nonzero(np.triu(mean))
    return first, second, mean[first, second]


def test_net_bearings_by_hand():
    f, diagonal = np.empty((4, 2)), np.array([2.0, 3.0]) / np.sqrt(13)
    net_bearings_of_arcs(PLACES, ARCS, f)
    expected = [2.0, 0.0], [-0.5, 1.0], 0.25 * diagonal * [1, -1] + [4.0, 0.0], -3.0 * diagonal
    np.testing.assert_allclose(f, expected, atol=1e-15)


def test_arcs_that_go_both_ways_alike_are_links_and_mean_weights_have_the_v_of_all():
    both, arcs, links = ARCS + ARCS.T, np.empty((4, 2)), np.empty((4, 2))
    net_bearings_of_arcs(PLACES, both, arcs)
    net_bearings_of_links(PLACES, links_of(both), links)
    np.testing.assert_array_equal(arcs, links)
    gaps = np.linalg.norm(PLACES[:, None] - PLACES, axis=-1)
    np.testing.assert_allclose(lyapunov_of_links(PLACES, links_of(ARCS)), (ARCS * gaps).sum())


def test_contraction_by_hand():
    arcs, links = ARCS.copy(), links_of(ARCS)
    contract(0, 1, links)
    contract_arcs(0, 1, links, arcs)
    # robot 1 saw 3 and was seen by 2; robot 3 saw 0 already
    np.testing.assert_array_equal(
        arcs, [[0, 0, 0, 1.0], [0, 0, 0, 0], [0.25, 0, 0, 4.0], [3.0, 0, 0, 0]]
    )
    kept = {(i, j): w for i, j, w in zip(*(a.tolist() for a in links), strict=True) if w > 0}
    assert kept == {(0, 2): 0.125, (0, 3): 2.0, (2, 3): 2.0}
