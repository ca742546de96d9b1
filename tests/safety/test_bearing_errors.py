"""Wrong bearings: headings and tanks that allow for them, under whoever misleads them most."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import UNEQUAL, five
from filtered_teams import Seen, longer
from tuples import triple

from rendezvous_env import Scenario, Simulator, certificate, graphs
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.settings import error_chord
from rendezvous_env.safety.tank import (
    EnergyTank,
    certain_descent,
    descending_velocity,
    promised_descent,
)
from research.desired_velocities import desired_velocities
from train.verify.adversarial_bearings import turned, unit

TEAMS = 12
ERRORS = ("common", "backwards", "random")


def misled(observations, layout, angle, kind, frozen, random):
    """Observations whose bearings are turned by the angle, or by less where it is drawn: towards a
    direction that a robot never changes, away from f, or anywhere.
    """
    k = layout.neighbour_slots
    rows = observations[..., :k, :].astype(np.float64)
    lengths = np.linalg.norm(rows, axis=-1, keepdims=True)
    target = {
        "common": frozen[..., None, :],
        "backwards": -layout.net_bearing(observations)[..., None, :],
        "random": random.normal(size=rows.shape),
    }[kind]
    turn = angle * (random.random(lengths.shape) if kind == "random" else np.ones(lengths.shape))
    wrong = observations.copy()
    wrong[..., :k, :] = turned(unit(rows), np.broadcast_to(target, rows.shape), turn) * lengths
    return wrong


def play(scenario, safety_filter, error, *, kind, choose, steps=None):
    """Episodes under wrong bearings."""
    random, layout = np.random.default_rng(0), scenario.observation_layout
    frozen = random.normal(size=(TEAMS, scenario.n_robots, scenario.dim))

    def mislead(observations):
        return misled(observations, layout, error, kind, frozen, random)

    return Seen(scenario, safety_filter, choose, steps=steps, mislead=mislead)


def chooser(scenario, seed=0):
    return desired_velocities(scenario, TEAMS, np.random.default_rng(seed), "mixed")


def raw_headings(scenario, seed=0):
    """Frozen, drawn anew or across f: raw vectors, or turn rates, in any unit."""
    random = np.random.default_rng(seed)
    size = TEAMS, scenario.n_robots, 1 if scenario.dim == 2 else 2
    if not scenario.model.nonholonomic:
        return chooser(scenario, seed)
    frozen = random.uniform(-1, 1, size)
    return lambda seen, step: np.where(random.random(size) < 0.5, frozen, -frozen)


def bound_of(scenario, start, error, margin, *, faded=0.0, rises=1):
    """Theorems N1', with a dead zone that takes β = ½, and D, which counts rises twice, s."""
    n, a, r = scenario.n_robots, scenario.bottleneck_weight, scenario.merge_radius
    rho = n * scenario.max_degree * math.sin(error / 2) / a
    q = (2 - faded) * margin - 2 * (1 + margin) * rho
    assert q > 0
    most = start + rises * (n - 1) * r * np.triu(UNEQUAL).sum()
    return n * most / (a * q) ** 2 + (n - 1) * scenario.tau


def small_error(scenario):
    """Half of what leaves nothing of q at ε = 0.6, rad."""
    scale = scenario.bottleneck_weight / (scenario.n_robots * scenario.max_degree)
    return 2 * math.asin(0.5 * 0.9 / 3.2 * scale)


# ---- headings ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("error", [0.1, 0.6])
def test_v_never_rises_between_merges(dim, kind, error):
    scenario = five(f"single_integrator-{dim}d", spawn_size=3.0)
    steering = HeadingFilter(scenario, TEAMS, bearing_error=error, min_alignment=0.6, frame="local")
    choose = raw_headings(scenario)
    seen = play(scenario, steering, error, kind=kind, choose=choose, steps=200)
    assert seen.rise <= 0 and seen.calm_steps > 200


@pytest.mark.parametrize("model", ["unicycle", "nonholonomic_3d"])
@pytest.mark.parametrize("by", ["heading", "tank"])
def test_what_bodies_keep(model, by):
    """V never rises under headings, V + ΣA under tanks."""
    scenario = five(model, spawn_size=3.0)
    if by == "heading":
        kept, choose = HeadingFilter(scenario, TEAMS, bearing_error=0.4), raw_headings(scenario)
    else:
        kept = EnergyTank(scenario, TEAMS, bearing_error=0.4, budget=1.0)
        choose = chooser(scenario)
    seen = play(scenario, kept, 0.4, kind="common", choose=choose, steps=200)
    assert seen.rise <= 0 and seen.calm_steps > 200


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_all_meet_in_time_with_small_errors(dim, kind, factor):
    scenario = longer(five(f"single_integrator-{dim}d", spawn_size=3.0), factor)
    error = small_error(scenario)
    steering = HeadingFilter(scenario, TEAMS, bearing_error=error, min_alignment=0.6, frame="local")
    seen = play(scenario, steering, error, kind=kind, choose=raw_headings(scenario))
    assert seen.rise <= 0
    assert (seen.times <= factor * bound_of(scenario, seen.start, error, 0.6, faded=0.5)).all()


EVEN = {"complete": graphs.complete(0.7), "cycle": graphs.cycle(0.7)}


@pytest.mark.parametrize("graph", EVEN)
@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize("by", ["law", "heading", "tank"])
def test_even_graphs_tolerate_more_and_all_meet_in_time(graph, kind, by):
    """Errors that 2a* in place of 2c_m would not allow, within the certificate's time."""
    scenario = longer(Scenario(n_robots=6, graph=EVEN[graph], spawn_size=3.0), 1.0)
    margin = 1.0 if by == "law" else 0.9
    tolerated = certificate(scenario, margin, by=by).tolerated_bearing_error
    n, error = 6, 0.8 * tolerated
    assert error > 2 * math.asin(0.7 / (n * scenario.max_degree)) * (1.0 if by == "law" else 0.5)
    kept = {"bearing_error": error, "frame": "local"}
    if by == "law":  # headings along f̂, not slowed down
        filtered = HeadingFilter(scenario, TEAMS, frame="local")

        def choose(seen, step):
            return scenario.observation_layout.net_bearing(seen)

    elif by == "heading":
        filtered = HeadingFilter(scenario, TEAMS, min_alignment=margin, **kept)
        choose = raw_headings(scenario)
    else:
        filtered = EnergyTank(scenario, TEAMS, min_alignment=margin, **kept)
        choose = chooser(scenario)
    seen = play(scenario, filtered, error, kind=kind, choose=choose)
    found = certificate(scenario, margin, by=by, bearing_error=error)
    assert found.guaranteed and (seen.times <= found.time_bound).all()
    assert seen.rise <= 0 or by == "law"


@pytest.mark.parametrize("model", ["single_integrator-2d", "single_integrator-3d", "unicycle"])
def test_errors_that_are_not_allowed_for_raise_v(model):
    scenario = five(model, spawn_size=3.0)
    steering = HeadingFilter(scenario, TEAMS, min_alignment=0.1, frame="local")
    choose = raw_headings(scenario)
    seen = play(scenario, steering, 1.0, kind="common", choose=choose, steps=200)
    assert seen.rise > 1e-3


def test_a_robot_goes_slower_by_what_errors_could_feign():
    scenario = Scenario(n_robots=3)
    options = {"frame": "local", "min_alignment": 0.5}
    wary, sure = (HeadingFilter(scenario, 1, **options, bearing_error=e) for e in (0.3, 0.0))
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    actions = []
    for steering in (wary, sure):
        steering.hold(f)
        actions.append(np.linalg.norm(steering.act(observations), axis=-1))
    strength = np.linalg.norm(f, axis=-1)
    slower = np.maximum(strength - 2 * math.sin(0.15) * 2.0, 0.0)
    np.testing.assert_allclose(actions[0], slower, atol=1e-6)
    np.testing.assert_allclose(actions[1], strength, atol=1e-6)
    np.testing.assert_allclose(wary.lyapunov_rate, -2 * strength * slower, atol=1e-5)


def test_bare_headings_have_nothing_to_protect():
    with pytest.raises(
        ValueError, match=r"bearing_error is 0\.1; it must be 0 with certified=False"
    ):
        HeadingFilter(Scenario(), 1, certified=False, bearing_error=0.1)


# ---- tanks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ERRORS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("error", "budget"), [(0.1, 0.0), (0.6, 2.0)])
def test_the_ledger_is_kept(dim, kind, error, budget):
    scenario = longer(five(f"single_integrator-{dim}d", spawn_size=3.0), 2.0)
    tank = EnergyTank(
        scenario, TEAMS, frame="local", bearing_error=error, budget=budget, min_alignment=0.6
    )
    choose = chooser(scenario)
    seen = play(scenario, tank, error, kind=kind, choose=choose, steps=200)
    assert seen.rise <= 0 and seen.calm_steps > 200 and tank.levels.min() >= 0


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ERRORS)
def test_all_meet_in_time_under_a_tank(dim, kind):
    scenario = longer(five(f"single_integrator-{dim}d", spawn_size=3.0), 1.0)
    error, margin = small_error(scenario), 0.6
    tank = EnergyTank(scenario, TEAMS, frame="local", bearing_error=error, min_alignment=margin)
    seen = play(scenario, tank, error, kind=kind, choose=chooser(scenario))
    assert (seen.times <= bound_of(scenario, seen.start, error, margin, rises=2)).all()


@pytest.mark.parametrize("model", ["single_integrator-2d", "single_integrator-3d", "unicycle"])
def test_a_ledger_that_believes_wrong_bearings_is_caught(model):
    scenario = five(model, spawn_size=3.0)
    tank = EnergyTank(scenario, TEAMS, frame="local", budget=1.0)
    choose = chooser(scenario)
    seen = play(scenario, tank, 0.6, kind="common", choose=choose, steps=200)
    assert seen.rise > 1e-3


def test_what_a_step_earns_and_owes_with_errors():
    f, moved = triple([3.0, 4.0]), triple([0.3, 0.4])
    free = certain_descent(f, 6.0, moved, 0.5)
    assert certain_descent(f, 6.0, moved, 0.5, 0.7) == pytest.approx(free - 2 * 0.7 * 0.5)
    assert promised_descent(5.0, 0.5, 0.2, 0.1, 0.4) == pytest.approx(0.1 * 0.5 * 0.6**2)
    assert promised_descent(5.0, 0.5, 0.2, 0.1, 1.1) == 0.0
    velocity = descending_velocity(triple([1.0, 0.0]), triple([2.0, 0.0]), 0.5, 0.6, 0.5)
    assert velocity == pytest.approx((0.75, 0.0, 0.0))
    assert error_chord(math.pi / 3) == pytest.approx(1.0)
