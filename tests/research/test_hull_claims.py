"""Claims about the size of a team hold, and are found violated where something is made wrong."""

from __future__ import annotations

import dataclasses

import hull_claims
import numpy as np
import pytest
from claims import CLAIMS, check

import baselines
from rendezvous_env import Simulator, graphs
from train.verify.adversaries import by_name
from train.verify.cases import BATCH, Case, draw_case

BY_NAME = {claim.name: claim for claim in hull_claims.HULL}


def findings(name, batches=4, **changes):
    """Teams tried, violations and worst T/bound of a claim with something changed."""
    claim = dataclasses.replace(BY_NAME[name], **changes)
    found = [check(claim, 7, batch, BATCH, 0.3) for batch in range(batches)]
    return (
        sum(f.trials for f in found),
        sum(f.violations for f in found),
        max(f.time_over_bound for f in found),
    )


@pytest.mark.parametrize("name", BY_NAME)
def test_nothing_is_violated(name):
    trials, violations, ratio = findings(name, 4)
    assert trials == 4 * BATCH and violations == 0
    if BY_NAME[name].timed:
        assert 0.02 < ratio <= 1  # a bound that nobody comes near checks little


def test_they_are_among_the_claims_of_the_command():
    assert set(hull_claims.HULL) < set(CLAIMS)
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS)


def tenth(bound):
    return lambda case, teams: bound(case, teams) / 10


@pytest.mark.parametrize("name", [name for name in BY_NAME if BY_NAME[name].timed])
def test_a_bound_ten_times_too_small_is_caught(name):
    assert findings(name, bound=tenth(BY_NAME[name].bound))[1] > 0


@pytest.mark.parametrize("name", ["theorem-G", "bound-N", "bound-C-uniform"])
def test_robots_that_flee_are_caught(name):
    def flee(case, num_envs, random):
        law = baselines.make("bearing-only", case.scenario)
        return lambda observations, time: -law(observations, time)

    trials, violations, _ = findings(name, 1, law=flee, bound=lambda case, teams: np.ones(BATCH))
    assert violations == trials


def test_a_hull_that_grows_for_a_moment_is_caught():
    """Law (1) but for one step, in which all robots go backwards."""

    def nudged(case, num_envs, random):
        law = baselines.make("bearing-only", case.scenario)
        steps = iter(range(10**9))

        def policy(observations, time):
            actions = law(observations, time)
            if next(steps) == 1:
                actions *= -1
            return actions

        return policy

    claim = dataclasses.replace(BY_NAME["theorem-G"], judges=BY_NAME["theorem-G"].judges[1:])
    found = check(dataclasses.replace(claim, law=nudged), 7, 2, BATCH, 0.3)
    assert found.violations > 0 and found.margin < -1e-6


def test_a_held_step_that_is_too_long_is_caught():
    """Twenty times the certified step: robots jump past each other, and the hull grows."""

    def draw(random, batch, least_margin):
        case = draw_case(random, 3, least_margin)
        scenario = case.scenario.replace(graph=graphs.path(), max_speed=None)
        step = 20 * scenario.certified_step
        return Case(scenario.replace(time_step=step, allow_long_step=True), 1.0)

    limit = BY_NAME["occlusion"].bound
    assert findings("theorem-G", draw=draw, bound=limit, batches=2)[1] > BATCH


# ---- pursuit -------------------------------------------------------------------------------------


def test_pursuers_that_do_not_turn_are_caught():
    def blind(case, num_envs, random):
        pursuer = hull_claims.pursuit(case, num_envs, random)

        def policy(observations, time):
            actions = pursuer(observations, time)
            actions[..., 0], actions[..., 1:] = case.scenario.speed_limit, 0.0
            return actions

        return policy

    trials, violations, _ = findings("pursuit", 2, law=blind)
    assert violations > 0.9 * trials


# ---- bodies --------------------------------------------------------------------------------------


def test_bodies_larger_than_half_the_merge_radius_are_caught():
    assert findings("bodies", watch=hull_claims.bodies(0.51))[1] > 0


def test_bodies_where_not_every_pair_docks_are_caught():
    def draw(random, batch, least_margin):
        case = draw_case(random, 3, least_margin, dims=(2,))
        return Case(case.scenario.replace(graph=graphs.star()), case.margin)

    assert findings("bodies", draw=draw)[1] > 0


def test_the_nearest_moment_of_a_step_counts_not_only_its_ends():
    before = np.array([[[-1.0, 0.0], [1.0, 0.3], [0.0, 5.0]]])
    after = np.array([[[1.0, 0.0], [-1.0, 0.3], [0.0, 0.0]]])
    all_three = np.ones((1, 3), dtype=bool)
    without = np.array([[True, True, False]])
    assert hull_claims._nearest_in_a_step(before, after, without) == pytest.approx(0.3)
    assert hull_claims._nearest_in_a_step(before, after, without & ~without) == np.inf
    # the third crosses y = 0 at the end, when the first has gone on to x = 1
    times = np.linspace(0, 1, 100_001)[:, None, None]
    places = before + times * (after - before)
    expected = min(
        np.linalg.norm(places[:, i] - places[:, j], axis=-1).min()
        for i, j in ((0, 1), (0, 2), (1, 2))
    )
    found = hull_claims._nearest_in_a_step(before, after, all_three)
    assert found == pytest.approx(expected, abs=1e-4)


# ---- occlusion -----------------------------------------------------------------------------------


def test_who_hides_whom_by_hand():
    places = np.array([[[0.0, 0.0], [1.0, 0.05], [3.0, 0.0], [0.0, 2.0], [3.0, 1.0]]])
    there = np.ones((1, 5), dtype=bool)
    hidden = hull_claims.hidden_by_robots(places, there, 0.1)[0]
    assert hidden[0].tolist() == [False, False, True, False, False]
    assert hidden[2].tolist() == [True, False, False, False, False]
    assert not hidden[[1, 3, 4]].any()
    gone = there.copy()
    gone[0, 1] = False
    assert not hull_claims.hidden_by_robots(places, gone, 0.1).any()
    assert not hull_claims.hidden_by_robots(places, there, 0.04)[0, 0].any()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_nearest_is_always_seen(dim):
    random = np.random.default_rng(dim)
    places = random.normal(size=(200, 8, dim))
    distance = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    distance += 1e9 * np.eye(8)
    there = np.ones((200, 8), dtype=bool)
    hidden = hull_claims.hidden_by_robots(places, there, 0.3)
    nearest = np.argmin(distance, axis=-1)
    assert not np.take_along_axis(hidden, nearest[..., None], axis=-1).any()
    assert 0.05 < hidden.mean() < 0.9


def test_robots_that_see_nobody_are_caught():
    """The nearest one hidden too."""

    class Hidden(hull_claims.Occluded):
        def hides(self, positions, active, radius):
            distance = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
            distance[distance == 0] = np.inf
            nearest = distance <= distance.min(axis=-1, keepdims=True)
            return super().hides(positions, active, radius) | nearest

    trials, violations, _ = findings("occlusion", 2, law=lambda *given: Hidden())
    assert violations > 0.2 * trials


def test_occlusion_without_anything_hidden_is_law_1():
    case = hull_claims.draw_uniform(np.random.default_rng(3), 3, 0.3)

    class Clear(hull_claims.Occluded):
        def hides(self, positions, active, radius):
            return np.zeros((*active.shape, active.shape[1]), dtype=bool)

    simulator, law = Simulator(case.scenario, BATCH), Clear()
    observations = simulator.reset(0)
    law.watch(simulator)
    expected = by_name("bearing-only")(case, BATCH, None)(observations, simulator.time)
    speed = np.linalg.norm(expected, axis=-1)
    limit = case.scenario.speed_limit
    free = speed < 0.999 * limit
    assert free.any()
    np.testing.assert_allclose(
        law(observations, simulator.time)[free], expected[free], rtol=1e-5, atol=1e-6
    )
