"""Time bounds by hand, and the facts that they rest on."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from conftest import UNEQUAL, unequal_matrix
from scipy.optimize import minimize

from rendezvous_env import Disc, Scenario, Sensing, certificate, graphs
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.safety.lyapunov import lyapunov
from rendezvous_env.safety.theorems.constants import (
    degrees_stay_equal,
    least_degrees,
    lyapunov_bound,
    merge_rise_allowance,
)
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.safety.theorems.gains import kappa, shrinking
from rendezvous_env.safety.theorems.noise import (
    equal_gain_bounds,
    gains_are_equal,
    law_bounds,
    tolerated_error,
)
from rendezvous_env.safety.theorems.theorem import LAW
from research.time_bounds import pursuit_bound, rendezvous_time_lower_bound

ALLOWANCE = 4 * 0.2 * 6.5
"""(n − 1) r W of UNEQUAL, whose a* is 0.9 and D̄ 6.5."""


def started(scenario):
    """The scenario from one start, robots 1 m or more apart, and its V(0), m²/s, and L(0), m."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    start = np.random.default_rng(0).permuted(np.arange(n * scenario.dim, dtype=float))
    start = start.reshape(n, scenario.dim)
    heaviest = graph.base_weights(n) * graph.weight_range[1]
    return scenario.replace(start_positions=start), float(lyapunov(start, heaviest)), size(start)


# ---- theorems A and C ----------------------------------------------------------------------------


def test_the_time_bound_by_hand():
    team = Scenario(n_robots=5, graph=UNEQUAL, merge_radius=0.2)
    assert merge_rise_allowance(team) == pytest.approx(ALLOWANCE)
    a = 5 * (100 + ALLOWANCE) / (8 * 0.9**2)
    assert time_bound(team, 100.0) == pytest.approx(2 * a)
    assert time_bound(team, 100.0, min_alignment=0.3) == pytest.approx(2 * a / 0.3**2)
    slow = team.replace(max_speed=1.3)
    assert time_bound(slow, 100.0) == pytest.approx(2 * a * 5)  # D̄/v_max = 6.5/1.3
    fast = team.replace(max_speed=100.0)
    assert time_bound(fast, 100.0) == pytest.approx(2 * a)
    long = team.replace(time_step=3 * team.certified_step, allow_long_step=True)
    assert time_bound(long, 100.0, min_alignment=0.3) == pytest.approx(2 * 3 * a / 0.3**2)
    assert math.isinf(time_bound(long, 100.0))  # law (1) as it stands is not scaled
    short = team.replace(time_step=team.certified_step / 7)
    assert time_bound(short, 100.0) == pytest.approx(2 * a)
    np.testing.assert_allclose(time_bound(team, [0.0, 100.0])[1], 2 * a)
    for wrong in (0.0, -0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="min_alignment is"):
            time_bound(team, 1.0, min_alignment=wrong)
    for wrong in (-1.0, math.nan, [1.0, math.inf]):
        with pytest.raises(ValueError, match="initial_lyapunov is"):
            time_bound(team, wrong)


@pytest.mark.parametrize(
    "changes",
    [
        {"sensing": Sensing(delay=1), "time_step": 0.001},  # theorem E1 has a later time
        {"sensing": Sensing(occlusion="robots")},  # and so has G
        {"sensing": Sensing(error=1e-4)},  # and N1
        {"sensing": Sensing(dropout=0.5)},
        {"meeting": "pack", "body_radius": 0.05, "merge_radius": 0.3},
    ],
)
def test_there_is_no_time_where_theorems_a_and_c_do_not_apply(changes):
    team = Scenario(n_robots=5).replace(**changes)
    assert np.isinf(time_bound(team, 10.0)) and np.isinf(time_bound(team, 10.0, min_alignment=0.5))


@pytest.mark.parametrize("n", [2, 3, 5, 40])
def test_the_fade_costs_no_more_than_theorem_c_says(n):
    """The least of Σ x_i² clip(x_i/δ − 1, 0, 1)² under Σx_i ≥ 2a* (lemma 1) is above 4a*²/n."""
    a, delta = 1.3, 1.3 / (2 * n)

    def work(x):
        return np.sum(x**2 * np.clip(x / delta - 1, 0, 1) ** 2)

    # the adversary keeps some robots at the foot of the fade, and shares the rest out
    for resting, foot in itertools.product(range(n), np.linspace(0, 2 * delta, 50)):
        share = (2 * a - resting * foot) / (n - resting)
        x = np.r_[np.full(resting, foot), np.full(n - resting, share)]
        assert work(x) >= 4 * a**2 / n - 1e-12
    x = np.linspace(0, 50 * delta, 2001)
    eight = 8 * delta * x - 16 * delta**2
    assert (x**2 * np.clip(x / delta - 1, 0, 1) ** 2 >= eight - 1e-12).all()


def test_complete_graphs_of_one_weight_by_hand():
    team = Scenario(n_robots=6, graph=graphs.complete(0.7))
    bound = 2 * 50.0 / (4 * 5 * 0.7**2)
    assert time_bound(team, 50.0) == pytest.approx(bound)
    assert time_bound(team, 50.0, min_alignment=0.2) == pytest.approx(bound / 0.2**2)
    assert time_bound(team.replace(max_speed=0.5), 50.0) == pytest.approx(bound * 3.5 / 0.5)
    matrix = team.replace(graph=0.7 * (1 - np.eye(6)))
    assert time_bound(matrix, 50.0) == pytest.approx(bound)
    other = 2 * 6 * (50 + 5 * 0.2 * 15 * 0.7) / (8 * 0.7**2)
    almost = 0.7 * (1 - np.eye(6))
    almost[1, 4] = almost[4, 1] = 0.7000001
    drawn = team.replace(graph=graphs.erdos_renyi(1.0, 0.7))
    assert time_bound(drawn, 50.0) == pytest.approx(other, rel=1e-6)
    # two are left at last, of degree a: V0⁺ max_m m/(4 c_m²) = V0⁺/(2a²)
    late = (50 + 5 * 0.2 * 15 * 0.7) / (2 * 0.7**2) + 5 * team.tau
    for graph in (almost, graphs.complete((0.7, 0.7000001))):
        assert time_bound(team.replace(graph=graph), 50.0) == pytest.approx(late, rel=1e-6)
    walled = team.replace(obstacles=[Disc((0, 0), 1)], obstacle_contact="ignore")
    # midpoints may lie in an obstacle: at one robot's place V can rise by twice as much (theory 5)
    twice = (50 + 2 * 5 * 0.2 * 15 * 0.7) / (2 * 0.7**2) + 5 * team.tau
    assert time_bound(walled, 50.0) == pytest.approx(twice)


def test_v_per_other_robot_never_rises_at_a_merge_of_a_complete_graph():
    """V/(m − 1), on which that bound rests, for any two robots that become one at their middle."""
    random = np.random.default_rng(0)
    for _ in range(300):
        m, d = int(random.integers(3, 9)), int(random.integers(2, 4))
        p = random.normal(size=(m, d)) * np.exp(random.normal(size=(m, 1)))
        merged = np.concatenate([p[2:], p[:2].mean(axis=0, keepdims=True)])
        before = lyapunov(p, 1.0 - np.eye(m)) / (m - 1)
        after = lyapunov(merged, 1.0 - np.eye(m - 1)) / (m - 2)
        assert after <= before * (1 + 1e-12)


# ---- theorem G -----------------------------------------------------------------------------------


def test_kappa_is_the_least_that_robots_can_share_out():
    assert kappa([2, 3, 4]) == pytest.approx([2, 2, 1.75])
    for n in range(2, 12):
        best = math.inf
        for seed in range(6):
            start = np.random.default_rng(seed).dirichlet(np.ones(n)) * math.pi
            found = minimize(
                lambda x: np.sum(np.sin(x) ** 2),
                np.minimum(start, 1.5),
                bounds=[(0, math.pi / 2)] * n,
                constraints={"type": "eq", "fun": lambda x: np.sum(x) - math.pi},
            )
            best = min(best, found.fun) if found.success else best
        alike, flat = np.full(n, math.pi / n), np.full(n, math.pi / (2 * max(n - 1, 1)))
        flat[0] = math.pi / 2
        best = min(best, np.sum(np.sin(alike) ** 2), np.sum(np.sin(flat) ** 2))
        assert kappa(n) == pytest.approx(best, rel=1e-6)


def contracted(weights, random):
    """The weights after one random link is contracted, by the max rule."""
    i, j = random.permutation(np.argwhere(weights > 0))[0]
    union = np.maximum(weights[i], weights[j])
    union[[i, j]] = 0
    weights = weights.copy()
    weights[i], weights[:, i] = union, union
    return np.delete(np.delete(weights, j, axis=0), j, axis=1)


@pytest.mark.parametrize(
    "graph",
    [
        graphs.complete(0.7),
        graphs.cycle(0.7),
        graphs.path(1.1),
        UNEQUAL,
        unequal_matrix(5, 3),
        graphs.from_matrix(np.where(np.eye(5), 0, UNEQUAL + 0.3)),
        graphs.from_edges([(0, 2, 0.4), (2, 4, 2.0), (4, 1, 1.0), (1, 3, 0.9), (3, 0, 0.6)]),
    ],
)
def test_no_merge_brings_a_degree_below_the_least(graph):
    scenario = Scenario(n_robots=5, graph=graph)
    least, random = least_degrees(scenario), np.random.default_rng(0)
    for _ in range(200):
        weights = scenario.sensing_graph.base_weights(5) * scenario.sensing_graph.weight_range[0]
        for m in range(5, 1, -1):
            degrees = weights.sum(axis=0)
            assert degrees.min() >= least[m - 2] - 1e-12
            if degrees_stay_equal(scenario):
                np.testing.assert_allclose(degrees, least[m - 2])
            weights = contracted(weights, random)


def test_where_all_degrees_stay_equal():
    for graph in (graphs.complete(0.7), graphs.cycle(2.0), 3.0 * (1 - np.eye(5))):
        assert degrees_stay_equal(Scenario(graph=graph))
    for graph in (graphs.path(), graphs.star(), UNEQUAL, graphs.cycle((1, 2)), "random_tree"):
        assert not degrees_stay_equal(Scenario(graph=graph))
    assert degrees_stay_equal(Scenario(n_robots=2, graph=graphs.path(0.3)))


def followed(scenario):
    """Time in continuous time over L(0), s/m."""
    team, _, extent = started(scenario)
    return certificate(team).continuous_time_bound / extent


def test_theorem_g_by_hand():
    for n in (2, 3, 5, 12):
        team = Scenario(n_robots=n, graph=graphs.complete(0.7))
        assert followed(team) == pytest.approx(1 / (4 * 0.7))
        assert followed(team.replace(dim=3)) == pytest.approx(1 / (2 * math.pi) / 0.7)
    any_graph = Scenario(graph=UNEQUAL)
    kappa_5 = 1 + 4 * math.sin(math.pi / 8) ** 2
    assert followed(any_graph) == pytest.approx(1 / (2 * 0.9 * kappa_5))
    assert followed(any_graph.replace(dim=3)) == pytest.approx(5 / (2 * math.pi) / (2 * 0.9))
    slow = any_graph.replace(max_speed=0.3)
    assert followed(slow) == pytest.approx(1 / (2 * 0.3 * kappa_5))
    ring = Scenario(n_robots=12, graph="cycle")
    assert followed(ring) == pytest.approx(1 / (4 * 12 * math.sin(math.pi / 12) ** 2))


def test_held_inputs_by_hand():
    """T ≤ L0 sin(π/n)/(2cκ(n) sin((1 − β)π/n)) + (n − 1)τ at τ = (r/2c) sin(βπ/n)."""
    n, c, r, beta = 7, 2 * 0.7, 0.3, 0.6
    step = r / (2 * c) * math.sin(beta * math.pi / n)
    ring = Scenario(n_robots=n, graph=graphs.cycle(0.7), merge_radius=r, time_step=step)
    rate = 2 * c * n * math.sin(math.pi / n) ** 2
    rate *= math.sin((1 - beta) * math.pi / n) / math.sin(math.pi / n)
    ring, _, extent = started(ring)
    assert equal_gain_bounds(ring, LAW).time == pytest.approx(extent / rate + 6 * step)
    space, least = ring.replace(dim=3, start_positions=None), math.atan(1 / math.sqrt(n * (n - 2)))
    eta = 0.6 * least
    space = space.replace(time_step=r / (2 * c) * math.sin(eta))
    bracket = math.cos(eta) / n - math.sin(eta) * math.sqrt(1 - 2 / n)
    space, _, extent = started(space)
    expected = extent / (2 * math.pi) / (2 * c * bracket) + 6 * space.tau
    assert equal_gain_bounds(space, LAW).time == pytest.approx(expected)
    pair, _, extent = started(Scenario(n_robots=2))  # both on one line: no bearing is ever wrong
    assert equal_gain_bounds(pair, LAW).time == pytest.approx(extent / 4 + pair.tau)


def test_held_inputs_are_covered_nowhere_else():
    step = 0.02 * Scenario().certified_step
    assert np.isfinite(equal_gain_bounds(Scenario(time_step=step), LAW).time)
    for other in (
        Scenario(time_step=step, graph="path"),
        Scenario(time_step=step, graph=UNEQUAL),
        Scenario(time_step=step, graph=graphs.complete((1, 2))),
        Scenario(time_step=step, max_speed=3.9),
    ):
        assert gains_are_equal(other, LAW)
    # the certified step: asin(1) is more than π/5
    assert (
        not gains_are_equal(Scenario(), LAW) and equal_gain_bounds(Scenario(), LAW).time == np.inf
    )
    assert shrinking(5, 2, 1.0, 0.99 * math.pi / 5) > 0 == shrinking(5, 2, 1.0, math.pi / 5)
    sharp = math.atan(1 / math.sqrt(15))
    assert shrinking(5, 3, 1.0, 0.99 * sharp) > 0 == shrinking(5, 3, 1.0, 1.01 * sharp)


def test_pursuit_by_hand():
    team = Scenario(robot_model="unicycle", max_turn_rate=4.0, merge_radius=0.2)
    kappa_5 = 1 + 4 * math.sin(math.pi / 8) ** 2
    turning = 5 * math.pi / (4 - 2 * 0.3 / 0.2)
    assert pursuit_bound(team, 9.0, 0.3) == pytest.approx(9 / (2 * 0.3 * kappa_5) + turning)
    space = Scenario(robot_model="nonholonomic_3d", dim=3, max_turn_rate=4.0, merge_radius=0.2)
    driving = 5 * 9 / (2 * math.pi) / (2 * 0.3)
    assert pursuit_bound(space, 9.0, 0.3) == pytest.approx(driving + turning)
    for wrong in (0.0, 0.4, math.nan):
        with pytest.raises(ValueError, match=r"speed is .*less than ω_max r/2 = 0\.4 m/s"):
            pursuit_bound(team, 9.0, wrong)


# ---- theorem D -----------------------------------------------------------------------------------


def tank(scenario, **given):
    """Its certificate, ε = 0.3, from the start of ``started``."""
    return certificate(started(scenario)[0], 0.3, by="tank", **given)


def test_the_tank_by_hand():
    team = Scenario(n_robots=5, graph=UNEQUAL, merge_radius=0.2)
    _, initial, _ = started(team)
    most = initial + 2 * ALLOWANCE + 5 * 20.0
    assert lyapunov_bound(team, initial) == pytest.approx(initial + ALLOWANCE)
    bound = 5 * most / (4 * 0.3**2 * 0.9**2)
    found = tank(team, budget=20.0)
    assert found.lyapunov_bound == pytest.approx(most)
    assert found.time_bound == pytest.approx(bound + 4 * team.tau)
    slow = tank(team.replace(max_speed=1.3), budget=20.0)
    assert slow.time_bound == pytest.approx(5 * bound + 4 * team.tau)
    long = team.replace(time_step=3 * team.certified_step, allow_long_step=True)
    assert tank(long, budget=20.0).time_bound == pytest.approx(3 * bound + 4 * long.tau)
    both = tank(long.replace(max_speed=1.3), budget=20.0)
    # the smaller of the two scales, not their product
    assert both.time_bound == pytest.approx(5 * bound + 4 * long.tau)
    assert certificate(Scenario(robot_model="unicycle"), 0.3, by="tank").time_bound == np.inf
    for wrong in (-1.0, math.inf, math.nan, "1"):
        with pytest.raises(ValueError, match="budget is"):
            tank(team, budget=wrong)
    with pytest.raises(ValueError, match="min_alignment is"):
        certificate(team, 0.0, by="tank")


def test_more_sharply_where_degrees_are_known_by_hand():
    """2c_m in place of 2a*: (m − 1) a on complete graphs of weight a, 2a on cycles."""
    a, n, eta = 0.7, 6, 0.1
    team, ring = (Scenario(n_robots=n, graph=g) for g in (graphs.complete(a), graphs.cycle(a)))
    each = (started(team)[1] + n * 2.0) / (n - 1) + (n - 1) * 0.2 * a
    expected = each / (2 * 0.3**2 * a**2) + (n - 1) * team.tau
    assert tank(team, budget=2.0).time_bound == pytest.approx(expected)
    assert tolerated_error(team) == pytest.approx(2 * math.asin(1 / n))
    assert tolerated_error(ring) == pytest.approx(2 * math.asin(1 / n))
    assert tolerated_error(team, 0.3) == pytest.approx(2 * math.asin(0.3 / (1.3 * n)))
    ring, initial, _ = started(ring)
    above = initial + 5 * 0.2 * n * a + 5 * ring.tau * n * (2 * math.sin(eta / 2) * 2 * a) ** 2
    rates = [4 * c**2 / m * (1 - (m * math.sin(eta / 2)) ** 2) for m, c in ((2, a), (6, 2 * a))]
    expected = above / min(rates) + 5 * ring.tau
    assert law_bounds(ring, LAW._replace(error=eta)).time == pytest.approx(expected)
    noisy, initial, _ = started(team.replace(sensing=Sensing(noise=1e-9)))
    above = initial + 5 * 0.2 * 15 * a + 5 * 0.2 * 5 * a * n
    expected = above / (2 * a**2)  # two are left, θ = 1
    assert certificate(noisy).expected_time_bound == pytest.approx(expected)


# ---- the lower bound -----------------------------------------------------------------------------


def test_the_lower_bound_by_hand():
    team = Scenario(n_robots=3, merge_radius=0.2, max_speed=0.5)
    start = [[0.0, 0.0], [6.0, 8.0], [3.0, 4.0]]
    assert rendezvous_time_lower_bound(team, start) == pytest.approx((5 - 2 * 0.1) / 0.5)
    crowded = team.replace(obstacles=[Disc((50.0, 0.0), 1.0)])
    assert rendezvous_time_lower_bound(crowded, start) == pytest.approx((5 - 2 * 0.2) / 0.5)
    assert rendezvous_time_lower_bound(team, np.zeros((3, 2))) == 0
