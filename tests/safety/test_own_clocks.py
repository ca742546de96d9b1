"""Theorem E3: law (1) where robots have activation is asynchronous."""

import math

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.safety.theorems.delay import longest_held_step

BASE = rv.Scenario(n_robots=4, spawn_size=3.0)
STEPS = {1: 1.0, 2: 0.618034, 3: 0.390388, 10: 0.105110}
"""θ_k by hand: the positive root of (k − 1)² θ² + θ = 1."""


def bounded(k, hold="command", **fields):
    return BASE.replace(activation=rv.Activation(kind="bounded", max_wait=k), hold=hold, **fields)


@pytest.mark.parametrize(("k", "share"), STEPS.items())
def test_longest_held_step_solves_the_condition_of_the_theorem(k, share):
    scenario = bounded(k)
    theta = longest_held_step(scenario) / scenario.certified_step
    assert theta == pytest.approx(share, abs=1e-6)
    assert (k - 1) ** 2 * theta**2 + theta == pytest.approx(1.0)


def test_default_step_is_refused_with_the_step_that_is_needed():
    scenario = bounded(3)
    found = rv.certificate(scenario)
    assert not found.guaranteed and not found.promises
    needed = float(found.theorem.split("time_step of at most ")[1].split(" s")[0])
    assert needed == pytest.approx(0.390388 * scenario.certified_step, rel=1e-5)
    granted = rv.certificate(scenario.replace(time_step=needed))
    assert granted.guaranteed and granted.theorem.startswith("theorem E3")
    assert not rv.certificate(scenario.replace(time_step=1.001 * needed)).guaranteed


def test_bounds_with_held_commands_are_those_of_the_proof():
    scenario = bounded(3, time_step=0.01, start_positions=((0, 0), (3, 0), (0, 4), (3, 4)))
    n, r, k, degree = 4, scenario.merge_radius, 3, 3.0
    theta, total = 2 * degree * 0.01 / r, 6.0
    start = 2 * (2 * 3 + 2 * 4 + 2 * 5)
    most = start + (n - 1) * r * total
    most += (n - 1) * (2 * k * theta * r * total + 8 * theta**3 * n * r * degree / 2)
    found = rv.certificate(scenario)
    assert found.lyapunov_bound == pytest.approx(most)
    slowest = min(4 * (m - 1) ** 2 / m for m in (2, 3, 4))
    assert found.time_bound == pytest.approx(most / slowest + (n * k - 1) * 0.01)


def test_bounds_of_robots_that_stand_still_are_those_of_the_proof():
    places = ((0, 0), (3, 0), (0, 4), (3, 4))
    for clocks in (
        {"kind": "bounded", "max_wait": 5},
        {"kind": "periodic", "period": [5, 1, 2, 3]},
    ):
        found = rv.certificate(BASE.replace(activation=clocks, hold="stop", start_positions=places))
        most, slow = 48.0 + 3 * BASE.merge_radius * 6.0, (1.0 + math.sqrt(4.0)) ** 2
        assert found.lyapunov_bound == pytest.approx(most)
        assert found.time_bound == pytest.approx(5 * slow * most / 2.0 + 4 * 5 * BASE.tau)
        assert math.isfinite(found.hull_bound)


def test_random_activation_has_a_mean_time_and_no_longest_one():
    scenario = BASE.replace(activation={"kind": "random", "probability": 0.25}, hold="stop")
    found = rv.certificate(scenario)
    assert not found.guaranteed and "no bound" in found.theorem
    assert set(found.promises) == {"lyapunov", "hull", "expected_time"}
    sim = rv.Simulator(scenario.replace(time_limit=300.0), 64)
    seen, law = sim.reset(1), baselines.make("bearing-only", scenario)
    while not sim.ended.all():
        seen = sim.step(law(seen, sim.time)).observations
    assert (sim.active.sum(axis=1) == 1).all()
    assert sim.time.mean() < found.expected_time_bound
    held = rv.certificate(scenario.replace(hold="command", time_step=1e-4))
    assert not held.guaranteed and not held.promises


@pytest.mark.parametrize("by", ["tank", "links"])
@pytest.mark.parametrize("hold", ["command", "stop"])
def test_filters_that_count_on_every_step_are_refused(by, hold):
    found = rv.certificate(bounded(2, hold), by=by)
    assert not found.guaranteed and not found.promises
    assert "activation is asynchronous" in found.theorem and "max_wait = 2" in found.theorem


@pytest.mark.parametrize(
    "fields",
    [{"graph": "directed_cycle"}, {"sensing": {"noise": 0.1}}, {"robot_model": "unicycle"}],
)
def test_other_flaws_lose_the_theorem(fields):
    for hold in ("command", "stop"):
        assert not rv.certificate(bounded(2, hold, time_step=1e-3, **fields)).guaranteed


def test_v_rises_with_commands_held_far_beyond_the_longest_step():
    """What the condition is for: two robots overshoot each other on commands that are old."""
    places = ((-0.5, 0.0), (0.5, 0.0), (0.0, 0.4), (0.0, -0.4))
    clocks = {"kind": "periodic", "period": 40, "phase": [0, 10, 20, 30]}
    scenario = BASE.replace(activation=clocks, start_positions=places)
    assert scenario.tau > 10 * longest_held_step(scenario)
    law, rises = baselines.make("bearing-only", scenario), {}
    for hold in ("command", "stop"):
        sim = rv.Simulator(scenario.replace(hold=hold))
        seen, rises[hold] = sim.reset(0), -np.inf
        for _ in range(60):
            before = sim.lyapunov()
            output = sim.step(law(seen, sim.time))
            seen = output.observations
            rises[hold] = max(rises[hold], (output.lyapunov_before_merge - before).max())
    assert rises["command"] > 0.01 and rises["stop"] <= 1e-9
