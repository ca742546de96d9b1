"""Continuous-time integrator: by hand and compared with the environment."""

from itertools import product

import numpy as np
import pytest
from continuous_time import Batch, ContinuousTrial, integrate, outward
from continuous_time_laws import away, followed, turned

import baselines
from rendezvous_env import Scenario, Sensing, Simulator, rollout
from rendezvous_env.safety.gains import Gains
from rendezvous_env.safety.links import link_keeping_law, min_norm_points
from rendezvous_env.trajectory import run
from train.verify.monitors import directions, extents, unit

TEAM = {"n_robots": 5, "spawn_size": 4.0, "merge_radius": 0.2, "time_limit": 60.0}


def test_two_robots_meet_at_exact_time():
    teams = Batch(np.array([[[0.0, 0.0], [2.0, 0.0]], [[0.0, 1.0], [0.0, 5.0]]]), 0.2)

    def law(teams):
        return followed(teams.look().bearings, teams.weights)

    times, _ = integrate(ContinuousTrial(teams, law, 0.07, np.array([10.0, 10.0])))
    np.testing.assert_allclose(times, [0.9, 1.9])  # (distance − r)/2a, at no multiple of the step
    np.testing.assert_allclose(teams.positions[:, 0], [[1.0, 0.0], [0.0, 3.0]])
    assert (teams.into == 0).all() and teams.left.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("places", "velocities", "until", "left", "time"),
    [
        # two that cross within a step dock at r
        ([[-1, 0], [1, 0.1], [0, 9]], [[1, 0], [-1, 0], [0, 0]], 5.0, [0, 2],
         1.0 - np.sqrt(0.2**2 - 0.1**2) / 2),
        # a merge may bring the next one about
        ([[0, 0], [1, 0], [0.5, 0.19]], [[1, 0], [-1, 0], [0, 0]], 1.0, [0], 0.4),
        # a team with no time rests
        ([[0, 0], [0, 0], [0, 0]], [[1, 1], [1, 1], [1, 1]], 0.0, [0, 1, 2], 0.0),
    ],
    ids=["cross", "two merges", "no time"],
)  # fmt: skip
def test_merges_match_hand_computation(places, velocities, until, left, time):
    teams = Batch(np.array([places], float), 0.2)
    teams.advance(np.array([velocities], float), np.array([until]))
    assert np.flatnonzero(teams.active[0]).tolist() == left
    assert teams.time[0] == pytest.approx(time)
    assert len(left) != 2 or teams.positions[0, 0] == pytest.approx([0.0, 0.05], abs=1e-12)


def test_unlinked_robots_pass_and_survivors_inherit_links():
    weights = np.array([[[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [2.0, 3.0, 0.0]]])
    places = np.array([[[0.0, 0.0], [0.05, 0.0], [1.0, 0.0]]])
    teams = Batch(places, 0.2, weights)
    teams.advance(np.zeros((1, 3, 2)), np.array([1.0]))
    assert teams.left.tolist() == [3] and teams.time[0] == 1.0
    teams.advance(np.array([[[0.0, 0.0], [0.0, 5.0], [-1.0, 0.0]]]), np.array([2.0]))
    assert teams.time[0] == pytest.approx(1.8)
    assert teams.into[0].tolist() == [0, 1, 0]
    assert teams.weights[0, 0, 1] == teams.weights[0, 1, 0] == 3.0
    assert teams.lyapunov() == pytest.approx(6.0 * np.hypot(0.05 - 0.1, 4.0))


@pytest.mark.parametrize("dim", [2, 3])
def test_outward_is_gradient_of_size(dim):
    random = np.random.default_rng(dim)
    teams = Batch(random.normal(size=(10, 6, dim)), 1e-6)
    found, sizes, small = outward(teams, teams.look()), teams.size(), 1e-6
    for robot in range(6):
        gradient = np.zeros((10, dim))
        for axis in range(dim):
            moved = teams.positions.copy()
            moved[:, robot, axis] += small
            gradient[:, axis] = (Batch(moved, 1e-6).size() - sizes) / small
        length = np.linalg.norm(gradient, axis=-1)
        corner = length > (1e-3 if dim == 2 else 0.3)
        cosine = np.sum(gradient * found[:, robot], axis=-1)[corner] / length[corner]
        assert (cosine > (1 - 1e-6 if dim == 2 else 0.97)).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_mean_extent_is_size(dim):
    teams = Batch(np.random.default_rng(0).normal(size=(5, 7, dim)), 0.1)
    mean = extents(teams.positions, teams.active, directions(dim, 4000)).mean(axis=-1)
    np.testing.assert_allclose(mean * 2 * np.pi * (dim - 1), teams.size(), rtol=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_bearings_are_rotated_by_error(dim):
    random = np.random.default_rng(1)
    g = unit(random.normal(size=(4, 3, 3, dim)))
    towards = random.normal(size=g.shape)
    towards[0], towards[1] = g[0], -2.0 * g[1]  # towards where they point already, and away
    wrong = turned(g, towards, 0.3)
    np.testing.assert_allclose(np.linalg.norm(wrong, axis=-1), 1.0)
    np.testing.assert_allclose(np.sum(wrong * g, axis=-1), np.cos(0.3))
    gained = np.sum((wrong - g) * towards, axis=-1)
    between = np.sum(g * towards, axis=-1) / np.linalg.norm(towards, axis=-1)
    assert (gained[np.abs(between) < np.cos(0.3)] > 0).all()


def law_1(error):
    def law(teams, step):
        sights = teams.look()
        seen = turned(sights.bearings, away(teams, sights), error) if error else sights.bearings
        return followed(seen, 1.5 * teams.weights)

    return law, lambda scenario: baselines.make("bearing-only", scenario)


def links():
    def law(teams, step):
        rows = 1.5 * teams.look().bearings
        degree = np.linalg.norm(rows, axis=-1).sum(axis=-1)
        return link_keeping_law(
            min_norm_points(rows), degree, merge_radius=teams.merge_radius, duration=step
        )

    return law, lambda scenario: baselines.make("link-keeping", scenario)


def gains():
    chosen = np.random.default_rng(5).random((20, 5, 4))
    weights = np.zeros((20, 5, 5))
    weights[:, ~np.eye(5, dtype=bool)] = chosen.reshape(20, -1)

    def policy(scenario):
        filtered = Gains(scenario, 20, min_gain=2.0, max_gain=2.0, frame="local")
        filtered.hold(chosen)
        return lambda observations, time: filtered.apply(observations)

    def law(teams, step):
        return followed(teams.look().bearings, 2.0 * weights / weights.sum(axis=-1, keepdims=True))

    return law, policy


@pytest.mark.parametrize(
    ("dim", "error", "laws"),
    [(2, 0.3, law_1(0.3)), *product((2, 3), (0.0,), (law_1(0.0), links(), gains()))],
)
def test_environment_trajectories_match_integrator(dim, error, laws):
    law, policy = laws
    graph, sensing = 1.5 * (1.0 - np.eye(5)), Sensing(error=error)
    scenario = Scenario(**TEAM, dim=dim, graph=graph, time_step=0.002, sensing=sensing)
    simulator = Simulator(scenario, 20)
    observations = simulator.reset(3)
    teams = Batch(simulator.positions, 0.2)
    step, compared = scenario.tau, 0
    for _ in run(simulator, policy(scenario), observations):
        whole = teams.active.all(axis=-1) & (teams.left > 1)
        teams.advance(law(teams, step), np.where(teams.left > 1, step, 0.0))
        whole &= teams.active.all(axis=-1)
        assert (simulator.active.all(axis=-1) == whole)[whole].all()
        np.testing.assert_allclose(simulator.positions[whole], teams.positions[whole], atol=2e-5)
        compared += whole.sum()
        if compared > 2000 or not whole.any():
            break
    assert compared > 500


def test_environment_rendezvous_time_matches_integrator():
    scenario = Scenario(**TEAM, time_step=0.005, sensing=Sensing(error=0.3))
    found = rollout(scenario, baselines.make("bearing-only", scenario), 4, num_envs=30)
    law, _ = law_1(0.3)
    teams = Batch(found.positions[0], 0.2)
    times, _ = integrate(
        ContinuousTrial(teams, lambda teams: law(teams, None) / 1.5, 0.005, np.full(30, 60.0))
    )
    # a robot that merges rests for what is left of the step
    np.testing.assert_allclose(found.rendezvous_time, times, atol=0.05)
