"""Claims about wrong and noisy bearings hold, and are violated where something is made wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import wrong_bearing_claims
from claims import CLAIMS, check
from hull_claims import HULL
from tank_wishes import Tanked, wishes

from rendezvous_env import Scenario, Simulator
from rendezvous_env.safety.tank import EnergyTank
from train.verify.adversaries import by_name
from train.verify.cases import BATCH

BY_NAME = {claim.name: claim for claim in wrong_bearing_claims.WRONG_BEARINGS}
FAR = 1.0
"""By what errors exceed what is claimed of them, rad."""
GAINS = next(claim for claim in HULL if claim.name == "gain-wrapper")


def findings(claim, batches=3, **changes):
    """Violations and worst T/bound of a claim with something changed."""
    claim = dataclasses.replace(claim, **changes)
    found = [check(claim, 7, batch, BATCH, 0.3) for batch in range(batches)]
    assert sum(f.trials for f in found) == batches * BATCH
    return sum(f.violations for f in found), max(f.time_over_bound for f in found)


@pytest.mark.parametrize("name", BY_NAME)
def test_nothing_is_violated(name):
    violations, ratio = findings(BY_NAME[name])
    assert violations == 0 and 0.01 < ratio <= 1


def test_they_are_among_the_claims_of_the_command():
    assert set(wrong_bearing_claims.WRONG_BEARINGS) < set(CLAIMS)


@pytest.mark.parametrize("name", BY_NAME)
def test_a_bound_a_hundred_times_too_small_is_caught(name):
    bound = BY_NAME[name].bound
    small = dataclasses.replace(BY_NAME[name], bound=lambda case, teams: bound(case, teams) / 100)
    assert findings(small, 2)[0] > 0


def for_fifty_steps(case, teams):
    return np.full(BATCH, 50 * case.scenario.tau)


def test_errors_larger_than_the_ledger_says_are_caught():
    def worse(case, num_envs, random):
        law = by_name("bearing-only")(case, num_envs, random)
        return wrong_bearing_claims.Misled(case.scenario, law, case.error + FAR, random)

    watched = BY_NAME["wrong-law-1"].judges[1:]
    assert findings(BY_NAME["wrong-law-1"], law=worse, judges=watched, bound=for_fifty_steps)[0] > 0


def test_headings_that_trust_wrong_bearings_are_caught():
    """All bearings lean to the heading, by more than it allows for."""

    class TowardsHeading(wrong_bearing_claims.Misled):
        def _towards(self, rows):
            headings = self.policy.steering.headings[:, :, None]
            return np.broadcast_to(headings, rows.shape)

    def trusting(case, num_envs, random):
        steered = wrong_bearing_claims.misled_headings(case, num_envs, random).policy
        return TowardsHeading(case.scenario, steered, case.error + FAR, random)

    claim = BY_NAME["wrong-headings"]
    assert findings(claim, 4, law=trusting, judges=claim.judges[1:], bound=for_fifty_steps)[0] > 0


def test_tanks_that_trust_wrong_bearings_are_caught():
    """All bearings lean to the wish, so that it seems to earn."""

    class TowardsWish(wrong_bearing_claims.Misled):
        def _towards(self, rows):
            return np.broadcast_to(self.policy.tank._held[:, :, None], rows.shape)

    def trusting(case, num_envs, random):
        tank = EnergyTank(
            case.scenario, num_envs, budget=case.budget, min_alignment=0.02, frame="local"
        )
        policy = Tanked(tank, wishes(case.scenario, num_envs, random, "flee"), 5)
        return TowardsWish(case.scenario, policy, case.error + FAR, random)

    claim = BY_NAME["wrong-tank"]
    judges = claim.judges[1:]
    long = {"bound": lambda case, teams: np.full(BATCH, 500 * case.scenario.tau)}
    assert findings(claim, 3, law=trusting, judges=judges, **long)[0] > 0


def test_noise_with_a_bias_is_caught():
    """All bearings to one side by more than a right angle: nobody ever meets."""

    class Biased(wrong_bearing_claims.Misled):
        def _towards(self, rows):
            self._kinds[...] = wrong_bearing_claims.KINDS.index("spinning")
            return super()._towards(rows)

    def law(case, num_envs, random):
        return Biased(case.scenario, by_name("bearing-only")(case, num_envs, random), 1.8, random)

    violations, _ = findings(BY_NAME["noise"], 2, law=law, bound=for_fifty_steps)
    assert violations == 2 * BATCH


def test_weights_that_point_backwards_are_caught():
    def flee(case, num_envs, random):
        policy = GAINS.law(case, num_envs, random)
        return lambda observations, time: -policy(observations, time)

    assert findings(GAINS, 2, law=flee, bound=for_fifty_steps)[0] == 2 * BATCH


@pytest.mark.parametrize("dim", [2, 3])
def test_rows_are_turned_by_the_error_and_stay_as_long(dim):
    scenario = Scenario(n_robots=5, dim=dim, graph="path")
    seen = []

    def policy(observations, time):
        seen.append(observations)
        return np.zeros((BATCH, 5, dim), np.float32)

    misled = wrong_bearing_claims.Misled(scenario, policy, 0.3, np.random.default_rng(0))
    true = Simulator(scenario, BATCH).reset(0)
    kept = true.copy()
    for _ in range(10):
        misled(true, 0.0)
    assert (true == kept).all()
    rows = scenario.observation_layout.neighbours
    a, b = true[..., rows, :].astype(float), np.array(seen)[..., rows, :].astype(float)
    lengths = np.linalg.norm(a, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(b, axis=-1) - lengths, 0.0, atol=1e-6)
    there = lengths > 0
    angles = np.arccos(np.sum(a * b, axis=-1)[:, there] / lengths[there] ** 2)
    np.testing.assert_allclose(angles, 0.3, atol=1e-3)
    assert 0 < there.mean() < 1 and not b[:, ~there].any()
