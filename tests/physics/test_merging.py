"""Merging (theory 5), by hand and against its bound; also for asymmetric weights."""

import numpy as np
import pytest
from conftest import started
from geometry import world
from hypothesis import given
from hypothesis import strategies as st
from parameters import slow

from rendezvous_env import Disc, Scenario
from rendezvous_env.graphs.merging import contract, contract_arcs, merge_swept
from rendezvous_env.physics.potential import (
    lyapunov_of_links,
    net_bearings_of_arcs,
    net_bearings_of_links,
)
from rendezvous_env.safety.lyapunov import lyapunov

pytestmark = pytest.mark.kernels


def linked(n, *links):
    """Weights of links (i, j, a) among n robots."""
    weights = np.zeros((n, n))
    for i, j, a in links:
        weights[i, j] = weights[j, i] = a
    return weights


def links_of(arcs):
    """Mean weights, for code that requires symmetric pairs."""
    mean = (arcs + arcs.T) / 2
    first, second = np.nonzero(np.triu(mean))
    return first, second, mean[first, second]


CHAIN = linked(4, (0, 1, 2.0), (1, 2, 0.5), (2, 3, 1.0))


class Moved:
    """Result of ``merge_swept`` for one team, r = 1."""

    def __init__(self, positions, displacements, weights=CHAIN, obstacles=None, radius=1.0):
        self.positions = np.array(positions, dtype=float)
        self.displacements = np.array(displacements, dtype=float)
        self.lengths = np.linalg.norm(self.displacements, axis=1)
        n = len(self.positions)
        links = links_of(np.array(weights, dtype=float))
        self.merged_into, self.report = np.arange(n), np.zeros(4)
        team = self.positions, self.displacements, self.lengths, links, None, self.merged_into
        here, resting = np.empty_like(self.positions), np.empty(n, dtype=bool)
        work = np.empty(len(links[0])), here, resting, self.report
        self.merges = merge_swept(*team, obstacles, radius, work)
        first, second, weight = (array[links[2] > 0] for array in links)
        self.weights = np.zeros((n, n))
        self.weights[first, second] = self.weights[second, first] = weight


PAIR = linked(2, (0, 1, 1.0))
REST = np.zeros((4, 2))
BY_HAND = {
    "nobody near": ([[0, 0], [5, 0], [10, 0], [15, 0]], [[1, 0], [0, 1], [0, -1], [0, 0]],
        CHAIN, [0, 1, 2, 3], {0: (1, 0), 1: (5, 1), 2: (10, -1), 3: (15, 0)}),
    "through each other": ([[0, 0], [3, 0]], [[100, 0], [-100, 0]],
        PAIR, [0, 0], {0: (1.5, 0), 1: (1.5, 0)}),
    "past just outside r": ([[0, 0], [3, 1.0001]], [[6, 0], [0, 0]], PAIR, [0, 1], {0: (6, 0)}),
    "past just inside r": ([[0, 0], [3, 0.9]], [[6, 0], [0, 0]], PAIR, [0, 0], {}),
    "no neighbours": ([[0, 0], [50, 0], [0.1, 0], [50, 9]], REST, CHAIN, [0, 1, 2, 3], {}),
    "no neighbours, through each other": ([[0, 0], [50, 0], [3, 0], [50, 9]],
        [[6, 0], [0, 0], [-6, 0], [0, 0]], CHAIN, [0, 1, 2, 3], {0: (6, 0), 2: (-3, 0)}),
    "below r at the start": ([[0, 0], [0.4, 0], [9, 0], [20, 0]], [[5, 0], [5, 0], [0, 0], [0, 0]],
        CHAIN, [0, 0, 2, 3], {0: (0.2, 0)}),
    # 1 reaches 2 before it reaches 0
    "the earliest": ([[0, 0], [4, 0], [6, 0], [60, 0]], [[2, 0], [0, 0], [-3, 0], [0, 0]],
        CHAIN, [0, 1, 1, 3], {0: (2, 0), 1: (4.5, 0)}),
    # pairs (0, 1) and (1, 2) touch at the same moment: the lower index wins, and 2 has gone on
    "a tie": ([[0, 0], [4, 0], [8, 0], [60, 0]], [[3, 0], [0, 0], [-3, 0], [0, 0]],
        CHAIN, [0, 0, 2, 3], {0: (3.5, 0), 2: (5, 0)}),
    # (0, 1) at 0.45 and (2, 3) at 1.25 first; those are 0.8 apart
    "a chain within r": ([[0, 0], [0.9, 0], [1.2, 0], [1.3, 0]], REST, CHAIN, [0] * 4,
        {0: (0.85, 0)}),
}  # fmt: skip


@pytest.mark.parametrize("case", BY_HAND)
def test_merge_cases_match_hand_computation(case):
    positions, displacements, weights, merged_into, places = BY_HAND[case]
    moved = Moved(positions, displacements, weights)
    assert moved.merged_into.tolist() == merged_into
    assert moved.merges == len(merged_into) - len(set(merged_into))
    for robot, place in places.items():
        np.testing.assert_allclose(moved.positions[robot], place, atol=1e-15)
    if moved.merges == 0:
        np.testing.assert_array_equal(moved.weights, weights)
        assert not moved.report.any()
    if not any(merged_into):  # one is left
        assert not moved.weights.any() and moved.report[1] == 0


def test_pair_merges_at_first_contact_and_rests():
    # 0 and 1 close in at 2 + 2 from distance 5: r = 1 after the whole motion's share 4/8 … 1 of 4
    moved = Moved([[0, 0], [5, 0], [50, 0], [60, 0]], [[4, 0], [-4, 0], [0, 3], [0, 0]])
    assert moved.merges == 1 and moved.merged_into.tolist() == [0, 0, 2, 3]
    # gap 5 − 8 s = 1 at s = 1/2: they stand at 2 and 3
    np.testing.assert_allclose(moved.positions[:2], [[2.5, 0], [2.5, 0]])
    np.testing.assert_allclose(moved.positions[2], [50, 3])
    np.testing.assert_allclose(moved.lengths, [2, 2, 3, 0])
    # at that moment robot 2 is at (50, 1.5)
    here = np.array([[2, 0], [3, 0], [50, 1.5], [60, 0]])
    assert moved.report[0] == pytest.approx(lyapunov(here, CHAIN))
    after = np.array([[2.5, 0], [2.5, 0], [50, 1.5], [60, 0]])
    contracted = linked(4, (0, 2, 0.5), (2, 3, 1.0))
    np.testing.assert_array_equal(moved.weights, contracted)
    assert moved.report[1] == pytest.approx(lyapunov(after, contracted))
    assert moved.report[2] == 0 and moved.report[3] == 0


def test_survivor_has_union_of_links_with_larger_weight():
    links = (0, 1, 1), (0, 2, 0.5), (1, 2, 0.9), (1, 3, 0.3), (0, 4, 0.7), (1, 4, 0.2), (2, 4, 2)
    weights = linked(5, *links)
    moved = Moved([[0, 0], [0.5, 0], [20, 0], [0, 20], [-20, 0]], np.zeros((5, 2)), weights)
    expected = linked(5, (0, 2, 0.9), (0, 3, 0.3), (0, 4, 0.7), (2, 4, 2))
    np.testing.assert_array_equal(moved.weights, expected)


def test_merged_into_follows_survivor():
    given = {"n_robots": 4, "graph": "path", "merge_radius": 1.0, "max_speed": 9.0}
    apart = Scenario(**given, local_frames="global")
    sim = started(apart, positions=[[0.0, 0], [4, 0], [8, 0], [8.5, 0]])
    sim.step(np.zeros((1, 4, 2)))
    assert sim.merged_into.tolist() == [[0, 1, 2, 2]]
    np.testing.assert_allclose(sim.positions[0, 2:], [[8.25, 0]] * 2)
    while sim.active[0, 2]:
        sim.step([[[0, 0], [0, 0], [-1, 0], [9, 9]]])
    assert sim.merged_into.tolist() == [[0, 1, 1, 1]]
    while sim.active[0, 1]:
        sim.step([[[0, 0], [-1, 0], [9, 9], [9, 9]]])
    assert sim.merged_into.tolist() == [[0, 0, 0, 0]]
    np.testing.assert_array_equal(sim.positions, np.tile(sim.positions[:, :1], (1, 4, 1)))


@pytest.mark.slow
def test_merge_at_lower_index_if_midpoint_is_in_obstacle():
    disc = world([Disc((0.4, 0.0), 0.05)])
    moved = Moved([[0, 0], [0.8, 0]], np.zeros((2, 2)), [[0, 1], [1, 0]], disc)
    np.testing.assert_array_equal(moved.positions, np.zeros((2, 2)))


def test_merge_may_raise_v_within_bound():
    """Robots 0 and 1 have distant neighbours on opposite sides: merging increases lengths."""
    weights = linked(6, (0, 1, 0.2), (0, 2, 1.0), (0, 3, 1.0), (1, 4, 1.0), (1, 5, 1.0))
    positions = np.array([[-0.4, 0], [0.4, 0], [-0.4, 9], [-0.4, -9], [0.4, 9], [0.4, -9]])
    moved = Moved(positions, np.zeros((6, 2)), weights)
    rise = moved.report[1] - moved.report[0]
    by_hand = 2 * (4 * (np.hypot(0.4, 9) - 9) - 0.2 * 0.8)
    assert rise == pytest.approx(by_hand)
    tight = Moved(positions * [1, 0.05], np.zeros((6, 2)), weights)
    assert tight.report[2] > 0.1  # a real rise …
    assert tight.report[3] <= 0  # … within r max(0, D_i + D_j − 4 a_ij) = 4.4 − 0.8


@pytest.mark.parametrize("in_an_obstacle", [False, slow(True)])
def test_bound_is_attained_by_four_collinear_robots(in_an_obstacle):
    """Midpoint: r (D_1 + D_2 − 4 a_12); position of the lower index: r (2 max D − 4 a_12)."""
    weights = linked(4, (0, 1, 0.2), (0, 2, 1.0), (1, 3, 1.5))
    disc = world([Disc((0.5, 0.0), 0.05)]) if in_an_obstacle else None
    start = [[0, 0], [1, 0], [-9, 0], [9, 0]]
    moved = Moved(start, np.zeros((4, 2)), weights, disc)
    attained = 2 * 1.7 - 4 * 0.2 if in_an_obstacle else 1.2 + 1.7 - 4 * 0.2
    assert moved.report[2] == pytest.approx(attained, rel=1e-12)
    assert moved.report[3] == pytest.approx(0, abs=1e-12)


@given(st.integers(3, 7), st.integers(0, 10**6), st.booleans())
def test_merges_never_exceed_bound(n, seed, in_an_obstacle):
    random = np.random.default_rng(seed)
    links = np.triu(random.random((n, n)) < 0.6, 1)
    weights = np.where(links, random.uniform(0.1, 2, (n, n)), 0)
    weights += weights.T
    positions = random.normal(size=(n, 2)) * random.choice([0.3, 1.0, 3.0])
    displacements = random.normal(size=(n, 2)) * random.choice([0.0, 0.2, 1.0])
    disc = world([Disc((0.0, 0.0), 20.0)]) if in_an_obstacle else None
    moved = Moved(positions, displacements, weights, disc, radius=0.7)
    assert moved.report[3] <= 1e-12
    active = moved.merged_into == np.arange(n)
    assert moved.merges == n - active.sum()
    left = moved.positions[active]
    apart = np.linalg.norm(left[:, None] - left, axis=-1)
    seen = moved.weights[np.ix_(active, active)] > 0
    assert (apart[seen] >= 0.7 * (1 - 1e-12)).all()
    assert not moved.weights[~active].any() and not moved.weights[:, ~active].any()
    assert (moved.merged_into[moved.merged_into] == moved.merged_into).all()
    assert (moved.merged_into <= np.arange(n)).all()


PLACES = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [2.0, 3.0]])
ARCS = np.array([[0, 2.0, 0, 0], [0.5, 0, 0, 1.0], [0, 0.25, 0, 4.0], [3.0, 0, 0, 0]])


def test_net_bearings_match_hand_computation():
    f, diagonal = np.empty((4, 2)), np.array([2.0, 3.0]) / np.sqrt(13)
    net_bearings_of_arcs(PLACES, ARCS, f)
    expected = [2.0, 0.0], [-0.5, 1.0], 0.25 * diagonal * [1, -1] + [4.0, 0.0], -3.0 * diagonal
    np.testing.assert_allclose(f, expected, atol=1e-15)


def test_symmetric_arcs_equal_links():
    both, arcs, links = ARCS + ARCS.T, np.empty((4, 2)), np.empty((4, 2))
    net_bearings_of_arcs(PLACES, both, arcs)
    net_bearings_of_links(PLACES, links_of(both), links)
    np.testing.assert_array_equal(arcs, links)
    gaps = np.linalg.norm(PLACES[:, None] - PLACES, axis=-1)
    np.testing.assert_allclose(lyapunov_of_links(PLACES, links_of(ARCS)), (ARCS * gaps).sum())


def test_contraction_matches_hand_computation():
    arcs, links = ARCS.copy(), links_of(ARCS)
    contract(0, 1, links)
    contract_arcs(0, 1, links, arcs)
    # robot 1 saw 3 and was seen by 2; robot 3 saw 0 already
    np.testing.assert_array_equal(
        arcs, [[0, 0, 0, 1.0], [0, 0, 0, 0], [0.25, 0, 0, 4.0], [3.0, 0, 0, 0]]
    )
    kept = {(i, j): w for i, j, w in zip(*(a.tolist() for a in links), strict=True) if w > 0}
    assert kept == {(0, 2): 0.125, (0, 3): 2.0, (2, 3): 2.0}
