"""Laws of others from bearings: against a few lines of NumPy, to the end, and where they fit."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.laws.literature_laws import (
    nearest_pursuit_law,
    rounded_bearings,
    smallest_sector_law,
    unit_mean_law,
)
from baselines.laws.neighbour_order import rows_from_nearest, rows_from_next
from rendezvous_env import graphs
from train import policies

TEAM = rv.Scenario(n_robots=6, max_speed=1.0, time_limit=60.0)
NAMES = ("unit-mean", "smallest-sector", "quantised", "cyclic-pursuit", "nearest-pursuit")


def bearings(positions):
    """(n, n, d), zero on the diagonal."""
    ways = positions[None] - positions[:, None]
    lengths = np.linalg.norm(ways, axis=-1, keepdims=True)
    return np.divide(ways, lengths, out=np.zeros_like(ways), where=lengths > 0)


def mean(g):
    f = g.sum(axis=1)
    return f / np.linalg.norm(f, axis=-1, keepdims=True)


def sector(g):
    """Try every pair of neighbours as the two ends, and take the narrowest that holds all."""
    velocities = np.zeros((len(g), 2))
    for i, rows in enumerate(g):
        others = np.delete(rows, i, axis=0)
        (x, y), (u, v) = others.T[:, :, None], others.T[:, None]
        turn = np.arctan2(x * v - y * u, x * u + y * v)
        right = np.flatnonzero((turn >= 0).all(axis=1))  # all others lie to its left
        left = np.flatnonzero((turn <= 0).all(axis=1))
        if len(right) and len(left):
            velocities[i] = others[right[0]] + others[left[0]]
    return velocities


def rounded(g, sectors=8):
    angles = np.round(np.arctan2(g[..., 1], g[..., 0]) / (2 * np.pi / sectors))
    turned = np.stack([np.cos(angles * 2 * np.pi / sectors), np.sin(angles * 2 * np.pi / sectors)])
    velocity = np.where(g.any(axis=-1), turned, 0.0).sum(axis=-1).T
    return velocity / np.maximum(np.linalg.norm(velocity, axis=-1, keepdims=True), 1.0)


def chase(g):
    n = len(g)
    return g[np.arange(n), (np.arange(n) + 1) % n]


def chase_the_lower(g):
    """Before anybody has merged the nearest by index is one below, but for robot 0."""
    n = len(g)
    return g[np.arange(n), [1, *range(n - 1)]]


LAWS = (mean, sector, rounded, chase, chase_the_lower)


@pytest.mark.parametrize(("name", "law"), list(zip(NAMES, LAWS, strict=True)), ids=NAMES)
def test_it_is_what_a_few_lines_integrate(name, law):
    """Held velocities on straight lines: Euler's method is exact. In the global frame, as sectors
    are counted from each robot's own x axis."""
    team = TEAM.replace(local_frames="global")
    found = rv.rollout(team, baselines.make(name, team), 3, num_envs=4)
    for b in range(4):
        alone = int(np.argmin(found.active[:, b].all(axis=-1)))  # the first merge
        positions = found.positions[0, b].copy()
        for t in range(min(alone, 150)):
            np.testing.assert_allclose(found.positions[t, b], positions, atol=2e-4)
            velocities = law(bearings(positions))
            speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
            positions += team.tau * velocities / np.maximum(speed, 1.0)
        assert alone > 5


@pytest.mark.parametrize("name", NAMES)
def test_they_meet_from_many_starts(name):
    found = rv.rollout(TEAM, baselines.make(name, TEAM), 0, num_envs=100)
    assert found.success.all()


@pytest.mark.parametrize("graph", ["path", "star", "random_tree"])
def test_unit_mean_meets_within_its_bound_on_sparse_graphs(graph):
    """T ≤ V0⁺/(4 v a*), twice that for the held step."""
    team = TEAM.replace(graph=graph, n_robots=5)
    found = rv.rollout(team, baselines.make("unit-mean", team), 0, num_envs=40)
    n, links = 5, 4
    bound = (found.lyapunov[0] + (n - 1) * team.merge_radius * links) / (4 * team.speed_limit)
    assert (found.rendezvous_time <= 2 * bound).all()


@pytest.mark.parametrize("name", ["cyclic-pursuit", "nearest-pursuit"])
def test_pursuit_meets_within_theorem_g(name):
    """Whom a robot pursues changes at merges; the sum of its gains is v all the time."""
    team = TEAM.replace(time_step=0.005)
    found = rv.rollout(team, baselines.make(name, team), 0, num_envs=30)
    simulator = rv.Simulator(team, 30)
    simulator.reset(0)
    one_gain = team.replace(graph=graphs.complete(0.2), max_speed=1.0)  # D_i = v
    own = (one_gain.replace(start_positions=start) for start in simulator.positions)
    bounds = [rv.certificate(start).continuous_time_bound for start in own]
    assert (found.rendezvous_time <= bounds).all()
    assert found.success.all()


@pytest.mark.parametrize("name", ["unit-mean", "cyclic-pursuit", "nearest-pursuit"])
def test_in_space_too(name):
    team = TEAM.replace(dim=3)
    assert rv.rollout(team, baselines.make(name, team), 0, num_envs=40).success.all()


class TestSmallestSector:
    def velocity(self, *degrees):
        angles = np.radians(degrees)
        return smallest_sector_law(np.stack([np.cos(angles), np.sin(angles)], axis=-1))

    @pytest.mark.parametrize(
        ("degrees", "narrowest"),
        [
            ((170, -170), (170, 190)),  # least and largest of atan2 would be the wide sector
            ((-100, 100, 180), (100, 260)),
            ((10, 20, 70), (10, 70)),
            ((45,), (45, 45)),
            ((-179, 1.5, 60), (1.5, 181)),
        ],
    )
    def test_its_ends_by_hand(self, degrees, narrowest):
        ends = np.radians(narrowest)
        wanted = [np.cos(ends).sum(), np.sin(ends).sum()]
        np.testing.assert_allclose(self.velocity(*degrees), wanted, atol=1e-12)

    def test_who_is_surrounded_waits(self):
        assert self.velocity(0, 120, 240).tolist() == [0, 0]
        assert smallest_sector_law(np.zeros((3, 2))).tolist() == [0, 0]

    def test_absent_rows_and_lengths_do_not_count(self):
        rows = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 0.0], [0.0, 0.1]])
        np.testing.assert_allclose(smallest_sector_law(rows), [1, 1], atol=1e-12)

    def test_no_link_is_lengthened(self):
        """As the source proves; a step of r/2 for speeds of up to 2 m/s."""
        team = TEAM.replace(graph="path", max_speed=None, merge_radius=0.2, time_step=0.05)
        found = rv.rollout(team, baselines.make("smallest-sector", team), 2, num_envs=30)
        whole = found.active.all(axis=-1)
        links = np.linalg.norm(np.diff(found.positions, axis=2), axis=-1)
        rises = np.diff(links, axis=0)[whole[1:]]
        assert rises.max() < 1e-6 and len(rises) > 400


def test_the_mean_of_nothing_is_rest():
    assert unit_mean_law(np.zeros((2, 3)), speed=2.0).tolist() == [[0] * 3] * 2
    np.testing.assert_allclose(unit_mean_law(np.array([3.0, 4.0]), speed=2.0), [1.2, 1.6])


def test_rows_are_rounded_and_keep_their_length():
    angle = 0.2
    row = 3 * np.array([math.cos(angle), math.sin(angle)])
    assert rounded_bearings(row, 4).tolist() == [pytest.approx(3), 0]
    finer = rounded_bearings(np.stack([row, 0 * row]), 16)
    turned = 2 * math.pi / 16
    np.testing.assert_allclose(finer, [[3 * math.cos(turned), 3 * math.sin(turned)], [0, 0]])


def test_too_few_sectors_fail():
    """Theorem N: an error of π/k < π/n is borne; half-turns are not directions to go by."""
    team = TEAM.replace(time_limit=20.0)
    coarse = rv.rollout(team, baselines.make("quantised", team, sectors=2), 0, num_envs=20)
    fine = rv.rollout(team, baselines.make("quantised", team, sectors=7), 0, num_envs=20)
    assert coarse.success.mean() < 0.5 and fine.success.all()
    with pytest.raises(ValueError, match="sectors is 1; it must be"):
        baselines.make("quantised", team, sectors=1)


class TestWhoIsNext:
    def test_with_a_row_for_each_it_is_the_next_by_number(self):
        assert rows_from_next(4, 3).tolist() == [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 1, 2]]

    def test_the_nearest_by_number(self):
        assert rows_from_nearest(4, 3).tolist() == [[0, 1, 2], [0, 1, 2], [1, 2, 0], [2, 1, 0]]
        assert rows_from_nearest(4, 1).tolist() == [[0]] * 4
        rows = np.eye(3)[None].repeat(4, axis=0)
        rows[1, 0] = rows[2, 1] = 0.0  # robot 1 does not see robot 0, nor robot 2 robot 1
        towards = nearest_pursuit_law(rows, speed=2.0)
        assert towards.tolist() == [[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, 0, 2]]

    def test_of_few_rows_nobody_knows(self):
        ring = rv.Scenario(n_robots=6, graph="cycle")
        for name in ("cyclic-pursuit", "nearest-pursuit"):
            with pytest.raises(ValueError, match=f"'{name}' does not fit"):
                baselines.make(name, ring)
        every_row = ring.replace(neighbour_slots=5)
        found = rv.rollout(every_row, baselines.make("cyclic-pursuit", every_row), num_envs=5)
        assert found.success.all()


def test_a_comparison_takes_them_only_on_request():
    usual = policies.fitting(TEAM, ())
    assert "bearing-only" in usual and not set(NAMES) & set(usual)
    assert policies.fitting(TEAM, NAMES) == list(NAMES)
