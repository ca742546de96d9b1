"""Claims about energy tanks hold, and are found violated where a ledger is broken on purpose."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from claims import CLAIMS, check
from tank_claims import TANK, deposits, draw_bodies, draw_ledgers, draw_obstructed, tanked
from tank_wishes import Tanked, wishes

from rendezvous_env import Simulator
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.trajectory import run
from train.verify.cases import BATCH, Case, draw_case

BY_NAME = {claim.name: claim for claim in TANK}


def findings(name, batches=4, **changes):
    """Teams tried, violations and worst T/bound of a claim with something changed."""
    claim = dataclasses.replace(BY_NAME[name], **changes)
    found = [check(claim, 7, batch, BATCH, 0.3) for batch in range(batches)]
    return (
        sum(f.trials for f in found),
        sum(f.violations for f in found),
        max(f.time_over_bound for f in found),
    )


def under(broken, kind="flee"):
    """A law: wishes of a kind under another tank."""

    def law(case, num_envs, random):
        given = {"budget": case.budget, "min_alignment": case.margin, "frame": "local"}
        tank = broken(case.scenario, num_envs, **given)
        return Tanked(tank, wishes(case.scenario, num_envs, random, kind))

    return law


@pytest.mark.parametrize("name", BY_NAME)
def test_nothing_is_violated(name):
    trials, violations, ratio = findings(name)
    assert trials == 4 * BATCH and violations == 0
    if BY_NAME[name].timed:
        assert 0.02 < ratio <= 1  # a bound that nobody comes near checks little


def test_they_are_among_the_claims_of_the_command():
    assert set(TANK) < set(CLAIMS)
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS)


# ---- broken on purpose ---------------------------------------------------------------------------


class ForgetsTheSquare(EnergyTank):
    """As if a step were so short that ‖Δ‖² did not matter."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self._constants = self._constants._replace(merge_radius=1e9)


class BooksTooMuch(EnergyTank):
    """Something is earned by doing anything."""

    def act(self, observations):
        actions = super().act(observations)
        self._deposits += 1.0
        return actions


class NeverBooks(EnergyTank):
    """What is spent can be spent again."""

    def book(self, contact=None, merged_into=None, resting=None):
        super().book(resting=np.ones(len(self._held), bool))


BROKEN = (ForgetsTheSquare, BooksTooMuch, NeverBooks)


@pytest.mark.parametrize("broken", BROKEN)
def test_the_ledger_of_a_broken_tank_is_caught(broken):
    assert findings("tank-ledger", law=under(broken))[1] > 0


@pytest.mark.parametrize("broken", [BooksTooMuch, NeverBooks])
@pytest.mark.parametrize("name", ["tank-start", "theorem-D", "tank-obstacles"])
def test_v_above_what_a_tank_allows_is_caught(name, broken):
    def limit(case, teams):  # enough to run away
        return np.full(BATCH, 300 * case.scenario.tau)

    watched = BY_NAME[name].judges[-1:]
    assert findings(name, law=under(broken), bound=limit, judges=watched)[1] > 0


@pytest.mark.parametrize("broken", [BooksTooMuch, NeverBooks])
def test_nonholonomic_robots_with_a_broken_tank_are_caught(broken):
    assert findings("tank-nonholonomic", law=under(broken))[1] > 0


def test_a_bound_twenty_times_too_small_is_caught():
    bound = BY_NAME["theorem-D"].bound
    assert findings("theorem-D", bound=lambda case, teams: bound(case, teams) / 20)[1] > 0


def test_robots_that_owe_less_than_promised_are_caught():
    """A margin of a tenth: who rests does so a hundred times as long."""

    def law(case, num_envs, random):
        return under(EnergyTank, "rest")(
            dataclasses.replace(case, margin=0.1 * case.margin), num_envs, random
        )

    assert findings("tank-ledger", law=law)[1] > 0


def test_without_any_tank_robots_that_flee_are_caught():
    def law(case, num_envs, random):
        chosen = wishes(case.scenario, num_envs, random, "flee")
        limit = case.scenario.speed_limit
        return lambda seen, time: (limit * chosen(seen, 0)).astype(np.float32)

    for name in ("tank-ledger", "tank-start"):
        trials, violations, _ = findings(name, law=law)
        assert violations > trials / 2


# ---- what the cases and the watch are ------------------------------------------------------------


def test_the_cases_are_of_every_kind():
    random = np.random.default_rng(0)
    drawn = [draw_ledgers(random, batch, 0.3) for batch in range(80)]
    margins = [case.margin for case in drawn]
    assert 0.05 <= min(margins) < 0.08 and 0.6 < max(margins) <= 0.8
    steps = [case.scenario.tau / case.scenario.certified_step for case in drawn]
    assert min(steps) < 0.6 and 2.5 < max(steps) <= 3.0
    assert 20 < sum(case.budget == 0 for case in drawn) < 60
    assert max(case.budget for case in drawn) > 5
    assert {case.scenario.dim for case in drawn} == {2, 3}
    obstructed = draw_obstructed(random, 1, 0.3)
    assert obstructed.scenario.obstacles and obstructed.scenario.obstacle_contact == "slide"
    models = {draw_bodies(random, batch, 0.3).scenario.robot_model for batch in range(8)}
    assert models == {"unicycle", "nonholonomic_3d"}


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_deposits_by_hand_are_those_of_the_tank(factor):
    scenario = draw_case(np.random.default_rng(1), 2, 0.3, step_factors=(factor, factor)).scenario
    case = Case(scenario, 0.3, budget=2.0)
    policy = under(EnergyTank, "mixed")(case, BATCH, np.random.default_rng(0))
    simulator = Simulator(scenario, BATCH)
    observations = simulator.reset(0)
    before, checked = policy.tank.levels, 0
    for number, step in enumerate(run(simulator, policy, observations)):
        earned = deposits(scenario, step, 0.3)
        policy.tank.book()
        booked = policy.tank.levels - before
        before = policy.tank.levels
        positive = before > 0  # a loss that would empty a tank is rounding
        np.testing.assert_allclose(earned[positive], booked[positive], atol=2e-6)
        checked += positive.sum()
        if number == 5 or not step.outcome.active.all():
            break
    assert checked > BATCH


def test_survivors_inherit_once_teams_are_shown():
    scenario = draw_case(np.random.default_rng(2), 1, 0.3).scenario
    policy = tanked(Case(scenario, 0.3, budget=3.0), BATCH, np.random.default_rng(0))
    merged = np.tile(np.arange(scenario.n_robots), (BATCH, 1))
    merged[0, 1] = 0
    policy.watch(SimpleNamespace(merged_into=merged))
    policy(Simulator(scenario, BATCH).reset(0), 0.0)
    levels = policy.tank.levels
    assert levels[0, 0] == 6.0 and levels[0, 1] == 0.0 and (levels[1:] == 3.0).all()
