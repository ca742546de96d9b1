"""Certificates with failures and disturbances; what turning frames change."""

import math

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.safety.theorems import gains

BASE = rv.Scenario(n_robots=4, spawn_size=3.0)
PLACES = ((0, 0), (3, 0), (0, 4), (3, 4))


def certificate(by=None, scenario=BASE, **events):
    fields = {"min_alignment": 0.5} if by in ("heading", "tank") else {}
    return rv.certificate(scenario.replace(events=events), by=by, **fields)


def episode(scenario, seed=0, steps=300):
    """Positions under law (1), (steps + 1, n, d), and whether all met."""
    law, sim = baselines.make("bearing-only", scenario), rv.Simulator(scenario)
    seen, places = sim.reset(seed), [sim.positions[0]]
    for _ in range(steps):
        seen = sim.step(law(seen, sim.time)).observations
        places.append(sim.positions[0])
    return np.array(places), sim.active[0].sum() == 1


def test_one_crash_makes_a_stationary_root():
    """The bound is that of the directed graph in which this robot observes no other."""
    found = certificate(crashes=[[1, 2.0]])
    weights = 1.0 - np.eye(4)
    weights[1] = 0.0
    directed = BASE.replace(graph=rv.graphs.directed(weights), time_step=BASE.tau)
    led = gains.bounds(directed, rv.safety.theorems.theorem.LAW)
    assert found.guaranteed and "crashed robot" in found.theorem
    slower = found.time_bound - 2.0 - BASE.tau
    assert led.time >= slower * (1 - 1e-9)  # the undirected graph has larger least degrees
    assert math.isfinite(found.lyapunov_bound) and math.isfinite(found.hull_bound)


def test_crashed_episode_equals_that_of_the_directed_graph():
    weights = 1.0 - np.eye(4)
    weights[1] = 0.0
    directed = BASE.replace(graph=rv.graphs.directed(weights), start_positions=PLACES)
    crashed = BASE.replace(events={"crashes": [[1, 0.0]]}, start_positions=PLACES)
    crashed = crashed.replace(time_step=directed.tau)
    (one, met), (other, all_met) = episode(crashed), episode(directed)
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert met and all_met


def test_two_crashes_are_refused_and_never_meet():
    events = {"crashes": [[0, 0.0], [3, 0.0]]}
    found = certificate(**events)
    assert not found.guaranteed and "can never meet" in found.theorem
    assert set(found.promises) == {"lyapunov", "hull"}
    assert not certificate(n_crashed=2).guaranteed
    assert "can never meet" in certificate("tank", n_crashed=2).theorem
    places, met = episode(BASE.replace(events=events, start_positions=PLACES), steps=2000)
    assert not met and (places[:, [0, 3]] == places[0, [0, 3]]).all()


def test_bounds_of_theorem_n2_are_those_of_the_proof():
    scenario = BASE.replace(start_positions=PLACES, time_step=0.02)
    found = certificate(scenario=scenario, slip=0.2, disturbance=0.5)
    most = 48.0 + 3 * 0.2 * 6.0 + 3 * 0.02 * 4 * 0.25 / 0.8
    rate = min(0.8 * 4 * (m - 1) ** 2 / m - m * 0.25 / 0.8 for m in (2, 3, 4))
    assert found.lyapunov_bound == pytest.approx(most)
    assert found.time_bound == pytest.approx(most / rate + 3 * 0.02)
    late = certificate(scenario=scenario, sensor_failures=[[0, 1.0, 7.0]])
    exact = rv.certificate(scenario.replace(graph=rv.graphs.complete((1.0, 1.0))))
    assert late.time_bound == pytest.approx((48.0 + 3.6) / 2.0 + 3 * 0.02 + 7.0 + 0.02)
    assert late.lyapunov_bound == exact.lyapunov_bound


def test_disturbance_beyond_the_threshold_is_refused_and_keeps_robots_apart():
    """Two robots pull with a = 1 m/s each; a disturbance of that size can cancel it."""
    pair = rv.Scenario(n_robots=2, start_positions=((0, 0), (1, 0)), max_speed=3.0)
    for w, granted in ((0.99, True), (1.0, False)):
        found = certificate(scenario=pair, disturbance=w)
        assert found.guaranteed == granted
    assert "tolerates less than 1 m/s" in found.theorem


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ({"n_adversarial": 1}, "adversarial robot can escape"),
        ({"disturbance_noise": 0.1}, "Gaussian disturbance has no bound"),
        ({"slip": 1.0}, "slip = 1"),
        ({"disturbance": 0.1, "n_blind": 1}, "drifts with the disturbance"),
    ],
)
def test_events_without_a_theorem_are_refused_by_reason(events, words):
    found = certificate(**events)
    assert not found.guaranteed and words in found.theorem


def test_disturbance_needs_speed_and_a_certified_step():
    assert certificate(disturbance=0.1).guaranteed
    for fields in ({"max_speed": 1.0}, {"time_step": 0.1, "allow_long_step": True}):
        assert not certificate(scenario=BASE.replace(**fields), disturbance=0.1).guaranteed


@pytest.mark.parametrize("by", ["law", "heading", "tank", "gains", "links"])
def test_turning_frames_change_no_certificate(by):
    turned = certificate(by, compass_drift=[1.0, -2.0, 5.0, 0.0], compass_walk=3.0)
    assert turned == certificate(by) and turned.guaranteed


@pytest.mark.parametrize(
    "fields",
    [
        {"sensing": {"delay": 1}},
        {"activation": rv.Activation(kind="bounded", max_wait=2), "hold": "command"},
    ],
)
def test_turning_frames_lose_theorems_about_the_past(fields):
    scenario = BASE.replace(time_step=0.01, **fields)
    assert rv.certificate(scenario).guaranteed
    found = certificate(scenario=scenario, compass_drift=1.0)
    assert not found.guaranteed and "local frames turn" in found.theorem


@pytest.mark.parametrize("dim", [2, 3])
def test_memoryless_law_does_not_depend_on_frames_at_any_time(dim):
    """Law (1) moves alike in fixed and in turning frames; a law with a memory does not."""
    scenario = rv.Scenario(n_robots=5, dim=dim, spawn_size=30.0)
    turning = scenario.replace(events={"compass_drift": [3.0, -2.0, 0.5, 9.0, 0.0]})
    (one, _), (other, _) = (episode(each, steps=100) for each in (scenario, turning))
    np.testing.assert_allclose(one, other, atol=1e-4)

    def with_memory(scenario):
        sim = rv.Simulator(scenario)
        held = sim.reset(0)[:, :, : scenario.n_robots - 1].sum(axis=2)
        for _ in range(100):
            sim.step(held)
        return sim.positions[0]

    assert np.abs(with_memory(scenario) - with_memory(turning)).max() > 1.0
