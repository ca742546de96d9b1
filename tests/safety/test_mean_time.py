"""Theorems E[T] and E[L] by hand and by simulation."""

import math

import numpy as np
import pytest
from conftest import UNEQUAL
from test_bounds import close, started

from rendezvous_env import Scenario, Sensing, baselines, certificate, make_vec
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.safety.theorems import mean_time
from rendezvous_env.safety.theorems.theorem import LAW, ROUNDED

PAIR = Scenario(n_robots=2, start_positions=((0.0, 0.0), (5.0, 0.0)))
TABLE = [[0.1, 0.0], [1.2, 0.55], [3.2, 0.35]]


def by_v(scenario, **sensing):
    """The bound of theorem E[T], s."""
    return mean_time.lyapunov_bounds(
        scenario.replace(sensing=Sensing(**sensing)), LAW
    ).expected_time


def by_hull(scenario, **sensing):
    """The bound of theorem E[L], s."""
    return mean_time.hull_bounds(scenario.replace(sensing=Sensing(**sensing)), LAW).expected_time


def test_noise_bounds_mean_time_only():
    """θ = 2D̄τ/r = 1 for the certified step of a pair, 1.5 for three robots."""
    found = certificate(noisy := PAIR.replace(sensing=Sensing(noise=0.3)))
    low, high = (math.exp(-0.045) + sign * 0.3 * ROUNDED for sign in (-1, 1))
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert "noise = 0.3" in found.theorem and "expected_time_bound" in found.theorem
    rate, above = 2 * (2 * low - high**2) - (1 - low**2), 10 + 0.2 + 0.4
    assert found.expected_time_bound == close(above / rate)
    near = ((0.0, 0.0), (0.1, 0.0), (5.0, 0.0))  # the first step may go τ D̄ = θ r/2 at once
    three = noisy.replace(n_robots=3, start_positions=near, time_step=0.075, allow_long_step=True)
    above = 20.0 + 2 * 0.2 * 3 + 4 * 3 * 0.15 + 2 * 4 * 0.075 * 4 * (1 + 1.5 / 8)
    rate = 2 * (2 * low - 1.5 * high**2) - 0.75 * (1 - low**2)
    assert certificate(three).expected_time_bound == close(above / rate)
    for changes in ({"bias": 0.1}, {"outliers": 0.1}, {"error": 0.01}, {"noise": 2.0}):
        sensing = Sensing(**{"noise": 0.3, **changes})
        assert math.isinf(certificate(PAIR.replace(sensing=sensing)).expected_time_bound)
    slow = PAIR.replace(time_step=1e-5)  # float32 makes the mean of cos ξ negative at 2π
    for noise, bounded in ((4.0, True), (2.0 * math.pi, False)):
        found = certificate(slow.replace(sensing=Sensing(noise=noise)))
        assert math.isfinite(found.expected_time_bound) == bounded
    for by, margin in (("heading", 0.5), ("tank", 0.5), ("gains", 1.0), ("links", 1.0)):
        other = certificate(noisy, margin, by=by)
        assert not other.guaranteed and math.isinf(other.expected_time_bound)


def test_detection_reads_table_from_merge_radius_on():
    scenario = Scenario(merge_radius=0.2, sensing=Sensing(detection=TABLE, dropout=0.2))
    seen = mean_time.detection_of(scenario)
    assert seen.least == pytest.approx(0.8 * 0.05, abs=1e-6) and seen.most == close(0.8 * 0.55)
    # p(d)/d is largest at 1.2 m, and the slope is 0.5/m
    assert seen.curvature == close(0.8 * (0.2 * 0.55 / 1.2 + 0.2 * 0.5), rel=1e-5)
    assert seen[3:] == (0.0, scenario.tau, scenario.tau)
    alike = mean_time.detection_of(Scenario(sensing=Sensing(dropout=0.25)))
    assert alike.least == 0.75 - ROUNDED and alike.most == 0.75 == close(alike.curvature)


@pytest.mark.parametrize(
    ("share", "steps"), [(0.5, (1, 1)), (1.0, (1, 1)), (2.4, (2, 3)), (3.0, (3, 3))]
)
def test_detection_between_samples(share, steps):
    """Persistence is that of the shortest time between samples."""
    tau = 0.013
    sensing = Sensing(dropout=0.5, persistence=0.02, sample_period=share * tau)
    seen = mean_time.detection_of(Scenario(time_step=tau, sensing=sensing))
    assert (seen.shortest, seen.longest) == close((steps[0] * tau, steps[1] * tau))
    assert seen.kept == close(math.exp(-steps[0] * tau / 0.02))
    assert seen.fresh == close(0.5 * (1 - seen.kept))


def test_lyapunov_bound_matches_hand_computation():
    """A pair and θ = 1: F = (2 − q) 2q² − ½q 2(q − q²) = 3q² − q³ = q · 2 · 0.625 for q = 0.5."""
    q = 0.5
    above = q * (10 + 0.2) + 0.4 * q
    assert by_v(PAIR, dropout=0.5) == close(above / (3 * q**2 - 2 * q**3 + q**3), rel=1e-5)
    kept = math.exp(-1 / 0.3)  # persistence of 0.3 steps
    a, b = 1 - kept, kept
    alpha, eta = a * (2 - q * a), b * (1 - q * a)
    worst = max(p - p**2 for p in np.linspace((1 - kept) * q, kept + (1 - kept) * q, 9999))
    fall = alpha * 4 * q**2 / 2 - 2 * eta * 2 * q - 2 * q * b**2 - 0.5 * q * 2 * worst
    assert by_v(PAIR, dropout=0.5, persistence=0.3 * PAIR.tau) == close(above / fall, rel=1e-5)
    held = PAIR.replace(time_step=PAIR.tau / 2)  # rows are held for one certified step
    above = q * (10 + 0.2) + 8 * 2 * held.tau * (q + 0.5 * q)
    found = by_v(held, dropout=0.5, sample_period=2 * held.tau)
    assert found == close(above / (3 * q**2 - q**3), rel=1e-5)


def test_hull_bound_matches_hand_computation():
    """A pair and θ = 1: L falls by 4 τ k in a sample, k = ½/(½ + 1), if one robot moves."""
    q, tau = 0.5, PAIR.tau
    rate = q * 4 / 3
    assert by_hull(PAIR, dropout=0.5) == close(10 / rate + tau / q, rel=1e-5)
    kept = math.exp(-0.5)
    found = by_hull(PAIR, dropout=0.5, persistence=2 * tau)
    assert found == close(10 / (rate * (1 - kept)) + tau / (q * (1 - kept)), rel=1e-5)
    # the ends of a path can be near each other: two robots must move in one of B = 2 samples
    team = Scenario(n_robots=3, graph="path", start_positions=((0, 0), (4, 0), (0, 3)))
    rates = [(1 - 0.5**b) ** 2 * 0.5 ** (b - 1) / b for b in range(1, 9)]
    assert max(rates) == rates[0]
    k = 0.5 / (0.5 + 2 * 0.25)
    expected = 12 / (0.25 * 3 * k) + 2 * team.tau / 0.25
    assert by_hull(team, dropout=0.5) == close(expected, rel=1e-5)


def test_unlinked_robots_are_counted():
    found = {
        "complete": [1, 1, 1, 1],
        "path": [1, 2, 3, 3],
        "cycle": [1, 2, 2, 2],
        "star": [1, 2, 3, 4],
        "directed_cycle": [1, 2, 2, 2],
        "random_tree": [1, 2, 3, 4],
    }
    for graph, counts in found.items():
        assert mean_time.max_unlinked(Scenario(graph=graph)).tolist() == counts, graph


@pytest.mark.parametrize(
    ("sensing", "bounded"),
    [
        ({"dropout": 0.4}, True),
        ({"detection": TABLE}, True),
        ({"dropout": 0.4, "persistence": 1.0}, True),
        ({"sample_period": 0.02}, True),
        ({"dropout": 1.0}, False),
        ({"detection": [[0.1, 1.0], [5.0, 0.0]]}, False),
    ],
)
@pytest.mark.parametrize("graph", ["complete", "path", UNEQUAL, "directed_cycle"])
def test_certificate_grants_mean_time_of_detection_by_chance(sensing, bounded, graph):
    scenario = Scenario(graph=graph, time_step=0.01, sensing=Sensing(**sensing))
    found = certificate(scenario)
    assert not found.guaranteed and math.isfinite(found.expected_time_bound) == bounded
    assert "expected_time_bound" in found.theorem
    for by in ("heading", "tank", "gains", "links"):
        other = certificate(scenario, 0.5 if by in ("heading", "tank") else 1.0, by=by)
        assert math.isinf(other.expected_time_bound) and "expected_time" not in other.theorem


@pytest.mark.parametrize(
    "sensing",
    [{"field_of_view": 2.0}, {"range": 5.0}, {"min_range": 0.5}, {"occlusion": "obstacles"}],
    ids=lambda fields: next(iter(fields)),
)
def test_certificate_names_what_hides_neighbours_for_ever(sensing):
    found = certificate(Scenario(sensing=Sensing(dropout=0.4, **sensing)))
    assert math.isinf(found.expected_time_bound)
    assert f"{next(iter(sensing))} can hide a neighbour permanently" in found.theorem


def unit_bearings(places):
    """Bearings g_ij, (n, n, d), of positions (n, d); zero for i = j."""
    offsets = places - places[:, None]
    apart = np.linalg.norm(offsets, axis=-1, keepdims=True)
    return np.divide(offsets, apart, out=np.zeros_like(offsets), where=apart > 0.0)


def spread(random, n, dim, graph, r):
    """Positions with linked robots r or more apart, unlinked ones anywhere, (n, d), m."""
    while True:
        places = r * random.uniform(0.0, 3.0, (n, dim))
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        if (apart[graph > 0.0] >= r).all():
            return places


def smooth(distances):
    """p(d) = 0.3 + 0.4 d, and its integral P(d) from 0, constant below r = 0.2 m; (...) each."""
    beyond = np.maximum(distances - 0.2, 0.0)
    p = 0.38 + 0.4 * beyond
    return p, 0.38 * np.minimum(distances, 0.2) + 0.38 * beyond + 0.2 * beyond**2


@pytest.mark.parametrize("gamma", [1.0, 0.7])
@pytest.mark.parametrize("graph", ["complete", "path", "cycle", UNEQUAL])
def test_mean_decrease_of_u_in_a_step(graph, gamma):
    """E U(t+τ) ≤ U(t) − τ Σ_i [γ(2 − θ_i βγ)‖F_i‖² − ½θ_i β Σ_j a_ij²(p − γ²p²)], θ_i = 2D_iτ/r.

    Probabilities rise with distance: β = max r p(d)/d + r · 0.4, here 0.38 + 0.08.
    """
    random, beta, r = np.random.default_rng(1), 0.46, 0.2
    scenario = Scenario(graph=graph, merge_radius=r)
    n, weights = scenario.n_robots, scenario.sensing_graph.base_weights(5)
    tau, nearest = scenario.tau, math.inf
    theta = 2.0 * weights.sum(axis=1) * tau / r
    for _ in range(12):
        places = spread(random, n, 2, weights, r)
        offsets = places - places[:, None]
        p, potential = smooth(np.linalg.norm(offsets, axis=-1))
        bearings = unit_bearings(places)
        mean = np.einsum("ij,ijd->id", p * weights, bearings)
        scatter = (weights**2 * (p - (gamma * p) ** 2)).sum(axis=1)
        fall = gamma * (2.0 - theta * beta * gamma) * (mean**2).sum(axis=1)
        fall = float((fall - 0.5 * theta * beta * scatter).sum())
        gains = weights * (random.random((2000, n, n)) < p)
        angles = math.acos(gamma) * random.choice([-1.0, 1.0], gains.shape)
        c, s = np.cos(angles), np.sin(angles)
        x, y = bearings[..., 0], bearings[..., 1]
        turned = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        moved = places + tau * (gains[..., None] * turned).sum(axis=2)
        ends = smooth(np.linalg.norm(moved[:, None] - moved[:, :, None], axis=-1))[1]
        fallen = (weights * (potential - ends)).sum(axis=(1, 2)) / tau
        error = fallen.std() / math.sqrt(len(fallen))
        assert fallen.mean() + 5 * error >= fall
        nearest = min(nearest, fallen.mean() - fall)
    assert nearest < 0.4 * weights.sum()  # of what V can fall by


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("graph", ["complete", "path", "directed_cycle"])
def test_mean_decrease_of_hull_in_a_step(graph, dim):
    """E L(t+τ) ≤ L(t) − τρ, ρ for m = n robots and B = 1; robots may be near unlinked ones."""
    random, q = np.random.default_rng(dim), 0.6
    scenario = Scenario(n_robots=4, graph=graph, dim=dim, sensing=Sensing(dropout=1.0 - q))
    weights, r = scenario.sensing_graph.base_weights(4), 0.2
    one_way = np.maximum(weights, weights.T)
    many = {"complete": 3, "path": 1, "directed_cycle": 1}[graph]
    chance = q if graph == "complete" else q ** mean_time.max_unlinked(scenario)[-1]
    spare = r - scenario.tau * scenario.max_degree
    rate = chance * many * float(mean_time.depth_gained(4, dim, False))
    rate *= spare / (spare + 2 * scenario.tau * many)
    for _ in range(10 if dim == 2 else 4):
        places = spread(random, 4, dim, one_way, r)
        gains = weights * (random.random((300, 4, 4)) < q)
        moved = places + scenario.tau * np.einsum("bij,ijd->bid", gains, unit_bearings(places))
        fallen = size(places) - np.array([size(one) for one in moved])
        assert fallen.min() > -1e-12  # the hull is nested
        error = fallen.std() / math.sqrt(len(fallen))
        assert fallen.mean() + 5 * error >= scenario.tau * rate


@pytest.mark.parametrize(
    ("graph", "sensing"),
    [
        ("complete", {"dropout": 0.7}),
        ("path", {"detection": [[0.2, 0.3], [3.0, 0.9]]}),
        ("cycle", {"dropout": 0.4, "noise": 0.2}),
        ("directed_cycle", {"dropout": 0.5, "persistence": 0.05}),
        ("path", {"dropout": 0.3, "sample_period": 0.06}),
    ],
)
def test_measured_mean_time_is_below_bound(graph, sensing):
    scenario = started(Scenario(n_robots=4, graph=graph))[0]
    scenario = scenario.replace(time_step=0.6 * scenario.tau, time_limit=200.0)
    scenario = scenario.replace(sensing=Sensing(**sensing))
    env = make_vec(scenario, num_envs=32, autoreset_mode="Disabled", num_threads=1)
    law, simulator = baselines.make("bearing-only", scenario), env.simulator
    observations, _ = env.reset(seed=0)
    times = np.full(32, np.inf)
    while np.isinf(times).any():
        assert simulator.time.max() < 190.0
        observations, *_ = env.step(law(observations, simulator.time))
        alone = simulator.active.sum(axis=1) == 1
        times[alone] = np.minimum(times[alone], simulator.time[alone])
    bound = certificate(scenario).expected_time_bound
    assert times.mean() < bound < 300.0 * times.mean()
