"""Energy tank: equations by hand, tank updates, observed stored energy, errors."""

import math

import numpy as np
import pytest
from conftest import UNEQUAL, five
from geometry import triple
from test_promises import longer

from rendezvous_env import Scenario, Sensing, Simulator
from rendezvous_env.safety.settings import error_chord
from rendezvous_env.safety.tank import (
    EnergyTank,
    certain_descent,
    descending_velocity,
    descent_scale,
    promised_descent,
)

TEAMS = 24
SHORT = Sensing(range=4.0)


@pytest.mark.kernels
class TestEquations:
    @pytest.mark.parametrize(
        ("strength", "degree", "radius", "duration", "limit", "expected"),
        [
            (1.0, 2.0, 0.4, 0.1, 5.0, 1.0),  # the certified step, slow enough
            (1.0, 2.0, 0.4, 0.3, 5.0, 1 / 3),  # three times as long
            (4.0, 2.0, 0.4, 0.1, 1.0, 0.25),  # faster than the robot may go
            (0.0, 2.0, 0.4, 0.1, 1.0, 1.0),
        ],
    )
    def test_scale_matches_hand_computation(
        self, strength, degree, radius, duration, limit, expected
    ):
        found = descent_scale(strength, degree, radius, duration, limit)
        assert found == pytest.approx(expected, rel=1e-15)

    def test_step_gain_and_cost_match_hand_computation(self):
        f, moves = triple([3.0, 4.0]), (triple([0.1, -0.2]), triple([0.3, 0.4]))
        # 2 (0.3 − 0.8) − (2/0.5) 6 (0.01 + 0.04)
        assert certain_descent(f, 6.0, moves[0], 0.5) == pytest.approx(-1.0 - 1.2, rel=1e-15)
        assert promised_descent(5.0, 0.5, 0.2, 0.1) == pytest.approx(0.04 * 0.1 * 0.5 * 25)
        free, wrong = (certain_descent(f, 6.0, moves[1], 0.5, error) for error in (0.0, 0.7))
        assert wrong == pytest.approx(free - 2 * 0.7 * 0.5)
        assert promised_descent(5.0, 0.5, 0.2, 0.1, 0.4) == pytest.approx(0.1 * 0.5 * 0.6**2)
        assert promised_descent(5.0, 0.5, 0.2, 0.1, 1.1) == 0.0
        assert error_chord(math.pi / 3) == pytest.approx(1.0)

    @pytest.mark.parametrize(
        ("wanted", "error", "expected"),
        [
            ((0.0, 0.0), 0.0, (1.0, 0.0)),  # nothing: law (1)
            ((5.0, 0.0), 0.0, (1.0, 0.0)),
            ((-3.0, 0.0), 0.0, (1.0, 0.0)),  # away: the same line
            ((1.0, 1.0), 0.0, (0.5, 0.5)),
            ((-1.0, -1.0), 0.0, (0.5, 0.5)),
            ((0.0, 2.0), 0.0, (0.36, 0.48)),  # across: the edge of the cap, h = (0.6, 0.8)
            ((1.0, 0.0), 0.5, (0.75, 0.0)),
        ],
    )
    def test_law_4_applies_along_desired_line(self, wanted, error, expected):
        velocity = descending_velocity(triple(wanted), triple([2.0, 0.0]), 0.5, 0.6, error)
        np.testing.assert_allclose(velocity, (*expected, 0.0), atol=1e-15)

    def test_empty_tank_is_never_overdrawn(self):
        """G ≥ τ s ((hᵀf)² − ε²‖f‖²) ≥ 0 for law (4) along any desired direction."""
        random = np.random.default_rng(0)
        for _ in range(500):
            f, wanted = random.normal(size=3), random.normal(size=3)
            strength, margin = float(np.linalg.norm(f)), random.uniform(0.01, 0.99)
            degree, radius = strength * random.uniform(1, 4), random.uniform(0.1, 1)
            duration, limit = random.uniform(0.01, 3) * radius / degree, random.uniform(0.1, 9)
            scale = descent_scale(strength, degree, radius, duration, limit)
            error = random.choice([0.0, 1.0]) * random.uniform(0, strength)
            given = triple(wanted), triple(f), scale, margin, error
            velocity = np.array(descending_velocity(*given))
            assert np.linalg.norm(velocity) <= limit * (1 + 1e-12)
            owed = promised_descent(strength, scale, margin, duration, error)
            moved = triple(velocity * duration)
            deposit = certain_descent(triple(f), degree, moved, radius, error) - owed
            assert deposit >= -1e-12 * duration * strength**2
            if error > 0.0:
                continue
            along = f @ velocity / np.linalg.norm(velocity)
            assert along >= margin * strength * (1 - 1e-12)
            least = duration * scale * (along**2 - margin**2 * strength**2)
            assert deposit >= least - 1e-12 * duration * strength**2


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_deposits_match_simulated_motion(kind, factor):
    """Recomputed from positions before and after."""
    scenario = longer(five(kind, spawn_size=8.0), factor)
    simulator = Simulator(scenario, TEAMS)
    tank = EnergyTank(scenario, TEAMS, frame="local", budget=0.05, min_alignment=0.2)
    observations, random = simulator.reset(0), np.random.default_rng(1)
    layout, both = scenario.observation_layout, set()
    for _ in range(5):
        tank.hold(random.uniform(-1, 1, (TEAMS, 5, scenario.action_size)))
        f, degree = layout.net_bearing(observations), layout.degree(observations)
        before, frames, places = tank.levels, simulator.frames, simulator.positions
        outcome = simulator.step(tank.apply(observations))
        whole = outcome.active.all(axis=-1)
        tank.update()
        moved = np.einsum("bnji,bnj->bni", frames, simulator.positions - places)
        strength = np.linalg.norm(f, axis=-1)
        earned = 2 * np.sum(f * moved, axis=-1)
        rate = -earned / scenario.tau
        earned -= 2 / scenario.merge_radius * degree * np.sum(moved**2, axis=-1)
        if scenario.model.bounded:
            r, tau = scenario.merge_radius, scenario.tau
            with np.errstate(divide="ignore", invalid="ignore"):  # robots that are gone
                scale = np.minimum(r / (2 * degree * tau), scenario.speed_limit / strength)
            earned -= 0.2**2 * tau * np.minimum(scale, 1) * strength**2
        expected = np.maximum(before + earned, 0)[whole]
        np.testing.assert_allclose(tank.levels[whole], expected, atol=2e-7)
        np.testing.assert_allclose(tank.lyapunov_rate[whole], rate[whole], atol=1e-5)
        observations = outcome.observations
        both |= set(np.unique(tank.carried_out))
    assert both == {False, True} and whole.any()


def test_desired_velocity_is_executed(kind):
    scenario = five(kind)
    tank = EnergyTank(scenario, 2, frame="local", budget=1e6)
    observations = Simulator(scenario, 2).reset(0)
    desired = np.random.default_rng(0).uniform(-1, 1, (2, 5, scenario.action_size))
    tank.hold(2.0 * desired)
    actions = tank.apply(observations)
    assert tank.carried_out.all()
    expected = np.clip(2 * desired, -1, 1) * scenario.action_bounds
    if scenario.model.bounded:  # too long: direction kept
        lengths = np.linalg.norm(desired, axis=-1, keepdims=True)
        expected = desired * np.minimum(2.0, 1 / lengths) * scenario.speed_limit
    np.testing.assert_allclose(actions, expected, rtol=1e-6)


@pytest.mark.parametrize("model", ["unicycle", "nonholonomic_3d"])
def test_unicycle_with_empty_tank_uses_gate(model):
    scenario = five(model, spawn_size=6.0, max_turn_rate=2.0)
    tank, observations = EnergyTank(scenario, 8), Simulator(scenario, 8).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    desired = np.zeros((8, 5, scenario.action_size))
    desired[..., 0] = -np.sign(f[..., 0])
    tank.hold(desired)
    actions = tank.apply(observations)
    gated = np.abs(f[..., 0]) < 0.05 * np.linalg.norm(f, axis=-1)
    assert not tank.carried_out.any() and (tank.lyapunov_rate <= 0).all()
    assert not actions[..., 1:][~gated].any()  # no turn was desired, and none was due
    np.testing.assert_allclose(actions[..., 0][~gated], f[..., 0][~gated], rtol=1e-5, atol=1e-6)


def test_contact_step_books_losses_only():
    """A robot pressed against a wall along f gains nothing; one pushed away from f pays."""
    scenario = Scenario(n_robots=2, local_frames="global")
    tank = EnergyTank(scenario, 1, frame="local", budget=1.0)
    start = {"positions": [[-2.0, 0.0], [2.0, 0.0]]}
    observations = Simulator(scenario).reset(0, start)
    for along, earns in ((1.0, True), (-1.0, False)):
        tank.hold([[[along, 0.0], [-along, 0.0]]])
        tank.apply(observations)
        before = tank.levels[0]
        tank.update(contact=[[True, False]])
        gained = tank.levels[0] - before
        assert (gained[1] > 0) == earns and (gained[0] == 0 if earns else gained[0] < 0)


def test_levels_at_merge_match_hand_computation():
    """Five robots become four, then two: energies are multiplied by ¾, then by ⅓."""
    tank, twin = (EnergyTank(Scenario(n_robots=5), 1, budget=2.0) for _ in range(2))
    observations = Simulator(tank.scenario).reset(0)
    for each in (tank, twin):
        each.apply(observations)
    twin.update()
    own = twin.levels[0]
    tank.update(merged_into=[[0, 0, 2, 3, 4]])
    expected = 0.75 * np.array([own[0] + own[1], 0.0, *own[2:]])
    np.testing.assert_allclose(tank.levels[0], expected, rtol=1e-15)
    tank.apply(np.where(np.arange(5)[:, None, None] == 1, np.float32(0.0), observations))
    before = tank.levels[0]
    tank.update(contact=np.ones((1, 5), bool), merged_into=[[0, 0, 2, 2, 0]])
    assert tank.levels[0, [1, 3, 4]].tolist() == [0.0, 0.0, 0.0]
    assert tank.levels[0].sum() <= before.sum() / 3
    tank.update(merged_into=[[0, 0, 2, 2, 0]])  # no step in between: nothing merges anew
    assert tank.levels[0].sum() > 0


@pytest.mark.parametrize("change", [{"graph": "path"}, {"graph": UNEQUAL}, {"sensing": SHORT}])
def test_levels_are_unchanged_elsewhere(change):
    tank = EnergyTank(Scenario(**{"n_robots": 5, **change}), 1, budget=2.0)
    tank.apply(Simulator(tank.scenario).reset(0))
    tank.update(merged_into=[[0, 0, 2, 3, 4]], resting=[True])
    assert tank.levels[0].tolist() == [4.0, 0.0, 2.0, 2.0, 2.0]


def test_resting_environments_book_nothing():
    scenario = five("single_integrator-2d")
    tank = EnergyTank(scenario, 3, budget=1.0)
    tank.hold(np.zeros((3, 5, 2)))
    tank.apply(Simulator(scenario, 3).reset(0))
    tank.update(resting=[False, True, False])
    once = tank.levels
    assert (once[1] == 1.0).all() and (once[[0, 2]] < 1.0).all()  # rest has its price
    tank.update()
    np.testing.assert_array_equal(tank.levels, once)


def test_alignment_is_that_of_motion():
    scenario = five("single_integrator-2d")
    tank = EnergyTank(scenario, 1, frame="local", budget=50.0)
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    u = f / np.linalg.norm(f, axis=-1, keepdims=True)
    across = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    for cosine in (-1.0, -0.6, 0.0, 0.8):
        tank.hold(cosine * u + np.sqrt(1 - cosine**2) * across)
        tank.apply(observations)
        np.testing.assert_allclose(tank.alignment, abs(cosine), atol=1e-6)
        assert (np.sign(np.round(tank.lyapunov_rate, 4)) == -np.sign(cosine)).all()
    tank.hold(0 * u)
    tank.apply(observations)
    assert np.isnan(tank.alignment).all()


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"contact": np.zeros((2, 4), bool)}, "contact is"),
        ({"contact": np.zeros((2, 5))}, "contact is"),
        ({"resting": np.zeros(3, bool)}, "resting is"),
        ({"merged_into": np.zeros((2, 5))}, "merged_into is"),
        ({"merged_into": np.full((2, 5), 5)}, "merged_into is .* from 0 to 4"),
        ({"merged_into": np.full((2, 5), -1)}, "merged_into is .* from 0 to 4"),
        ({"merged_into": np.zeros((5, 2), int)}, "merged_into is"),
    ],
)
def test_impossible_steps_are_not_booked(told, message):
    scenario = five("single_integrator-2d")
    tank = EnergyTank(scenario, 2, budget=1.0)
    tank.apply(Simulator(scenario, 2).reset(0))
    with pytest.raises(ValueError, match=message):
        tank.update(**told)
    assert (tank.levels == 1.0).all()
