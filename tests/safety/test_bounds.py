"""V, and theorems A, C and G by hand, with their lemmas."""

import math

import numpy as np
import pytest
from conftest import UNEQUAL, unequal_matrix
from scipy.optimize import minimize

from rendezvous_env import Disc, Scenario, Sensing, certificate, graphs
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.safety.lyapunov import lyapunov, lyapunov_rate, net_bearings
from rendezvous_env.safety.theorems.constants import (
    degrees_stay_equal,
    largest_lyapunov,
    largest_size,
    merge_rise_allowance,
    min_degrees,
)
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.safety.theorems.gains import depth_gained, kappa, shrinking_to_leader
from research.time_bounds import pursuit_bound, rendezvous_time_lower_bound

ALLOWANCE = 4 * 0.2 * 6.5
"""(n − 1) r W of UNEQUAL, which has a* = 0.9 and D̄ = 6.5."""
SQUARE = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
"""L0 = 16 m, κ(4) = 1 + 3 sin²(π/6) = 1.75."""
close = pytest.approx


def started(scenario):
    """The scenario with given positions at least 1 m apart, V(0), m²/s, and L(0), m."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    start = np.random.default_rng(0).permuted(np.arange(n * scenario.dim, dtype=float))
    start = start.reshape(n, scenario.dim)
    heaviest = graph.base_weights(n) * graph.weight_range[1]
    return scenario.replace(start_positions=start), float(lyapunov(start, heaviest)), size(start)


def test_v_rate_and_net_bearings_match_hand_computation():
    """V counts every edge twice; leading axes broadcast."""
    places = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 0.0]])
    weights = np.array([[0, 2.0, 0.5], [2.0, 0, 0], [0.5, 0, 0]])
    f = [[2 * 0.6 + 0.5, 2 * 0.8], [-1.2, -1.6], [-0.5, 0]]
    scales = np.arange(1.0, 7.0).reshape(2, 3)
    many = places * scales[..., None, None]
    np.testing.assert_allclose(lyapunov(many, weights), 2 * (2 * 5 + 0.5 * 3) * scales)
    found = net_bearings(many, weights)
    np.testing.assert_allclose(found, np.broadcast_to(f, (2, 3, 3, 2)), atol=1e-15)
    assert lyapunov_rate([[1.0, 1.0], [5.0, 5.0], [2.0, 2.0]], [[3, 4], [0, 0], [1, 0]]) == -18
    with pytest.raises(ValueError, match=r"positions \(3, 2\) and weights \(5, 5\)"):
        lyapunov(places, UNEQUAL)


def test_time_bound_matches_hand_computation():
    team = Scenario(n_robots=5, graph=UNEQUAL, merge_radius=0.2)
    assert merge_rise_allowance(team) == close(ALLOWANCE)
    a = 5 * (100 + ALLOWANCE) / (8 * 0.9**2)
    assert time_bound(team, 100.0) == close(2 * a)
    assert time_bound(team, 100.0, min_alignment=0.3) == close(2 * a / 0.3**2)
    # D̄/v_max = 6.5/1.3
    assert time_bound(team.replace(max_speed=1.3), 100.0) == close(2 * a * 5)
    assert time_bound(team.replace(max_speed=100.0), 100.0) == close(2 * a)
    long = team.replace(time_step=3 * team.certified_step, allow_long_step=True)
    assert time_bound(long, 100.0, min_alignment=0.3) == close(2 * 3 * a / 0.3**2)
    assert math.isinf(time_bound(long, 100.0))  # law (1) as it stands is not scaled
    assert time_bound(team.replace(time_step=team.certified_step / 7), 100.0) == close(2 * a)
    np.testing.assert_allclose(time_bound(team, [0.0, 100.0])[1], 2 * a)
    for wrong in (0.0, -0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="min_alignment is"):
            time_bound(team, 1.0, min_alignment=wrong)
    for wrong in (-1.0, math.nan, [1.0, math.inf]):
        with pytest.raises(ValueError, match="initial_lyapunov is"):
            time_bound(team, wrong)
    with pytest.raises(ValueError, match="scenario is 'duo'; it must be a Scenario"):
        time_bound("duo", 1.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"sensing": Sensing(delay=1), "time_step": 0.001},  # theorem E1 has a later time
        {"sensing": Sensing(occlusion="robots")},  # and so has G
        {"sensing": Sensing(error=1e-4)},  # and N1
        {"sensing": Sensing(dropout=0.5)},
        {"graph": graphs.directed_cycle()},
        {"meeting": "pack", "body_radius": 0.05, "merge_radius": 0.3},
    ],
)
def test_time_bound_is_infinite_outside_theorems_a_and_c(changes):
    team = Scenario(n_robots=5).replace(**changes)
    assert np.isinf(time_bound(team, 10.0)) and np.isinf(time_bound(team, 10.0, min_alignment=0.5))


def test_complete_graph_bounds_match_hand_computation():
    team = Scenario(n_robots=6, graph=graphs.complete(0.7))
    bound = 2 * 50.0 / (4 * 5 * 0.7**2)
    assert time_bound(team, 50.0) == close(bound)
    assert time_bound(team, 50.0, min_alignment=0.2) == close(bound / 0.2**2)
    assert time_bound(team.replace(max_speed=0.5), 50.0) == close(bound * 3.5 / 0.5)
    assert time_bound(team.replace(graph=0.7 * (1 - np.eye(6))), 50.0) == close(bound)
    drawn = team.replace(graph=graphs.erdos_renyi(1.0, 0.7))
    other = 2 * 6 * (50 + 5 * 0.2 * 15 * 0.7) / (8 * 0.7**2)
    assert time_bound(drawn, 50.0) == close(other, rel=1e-6)
    # two are left at last, of degree a: V0⁺ max_m m/(4 c_m²) = V0⁺/(2a²)
    late = (50 + 5 * 0.2 * 15 * 0.7) / (2 * 0.7**2) + 5 * team.tau
    almost = 0.7 * (1 - np.eye(6))
    almost[1, 4] = almost[4, 1] = 0.7000001
    for graph in (almost, graphs.complete((0.7, 0.7000001))):
        assert time_bound(team.replace(graph=graph), 50.0) == close(late, rel=1e-6)
    # midpoints may lie in an obstacle: at one robot's place V can rise by twice as much (theory 5)
    walled = team.replace(obstacles=[Disc((0, 0), 1)], obstacle_contact="ignore")
    twice = (50 + 2 * 5 * 0.2 * 15 * 0.7) / (2 * 0.7**2) + 5 * team.tau
    assert time_bound(walled, 50.0) == close(twice)


def contracted(weights, random):
    """Weights after contraction of one random link, by the max rule."""
    i, j = random.permutation(np.argwhere(weights > 0))[0]
    union = np.maximum(weights[i], weights[j])
    union[[i, j]] = 0
    weights = weights.copy()
    weights[i], weights[:, i] = union, union
    return np.delete(np.delete(weights, j, axis=0), j, axis=1)


EQUAL = (graphs.complete(0.7), graphs.cycle(0.7), graphs.from_matrix(3.0 * (1 - np.eye(5))))
UNLIKE = (
    *(graphs.path(1.1), graphs.star(), graphs.cycle((1, 2)), graphs.from_matrix(UNEQUAL)),
    *(graphs.from_matrix(unequal_matrix(5, 3)), graphs.complete((0.5, 2.0))),
    graphs.from_matrix(np.where(np.eye(5), 0, UNEQUAL + 0.3)),
    graphs.from_edges([(0, 2, 0.4), (2, 4, 2.0), (4, 1, 1.0), (1, 3, 0.9), (3, 0, 0.6)]),
)


@pytest.mark.parametrize("graph", [*EQUAL, *UNLIKE])
def test_merges_keep_minimum_degree(graph):
    scenario = Scenario(n_robots=5, graph=graph)
    least, random = min_degrees(scenario), np.random.default_rng(0)
    assert degrees_stay_equal(scenario) == (graph in EQUAL)
    for _ in range(200):
        weights = scenario.sensing_graph.base_weights(5) * scenario.sensing_graph.weight_range[0]
        for m in range(5, 1, -1):
            degrees = weights.sum(axis=0)
            assert degrees.min() >= least[m - 2] - 1e-12
            if graph in EQUAL:
                np.testing.assert_allclose(degrees, least[m - 2])
            weights = contracted(weights, random)


@pytest.mark.parametrize("n", range(2, 12))
def test_kappa_is_minimum_of_sum(n):
    alike, flat = np.full(n, math.pi / n), np.full(n, math.pi / (2 * (n - 1)))
    flat[0] = math.pi / 2
    found = [np.sum(np.sin(alike) ** 2), np.sum(np.sin(flat) ** 2)]
    for seed in range(6):
        start = np.random.default_rng(seed).dirichlet(np.ones(n)) * math.pi
        best = minimize(
            lambda x: np.sum(np.sin(x) ** 2),
            np.minimum(start, 1.5),
            bounds=[(0, math.pi / 2)] * n,
            constraints={"type": "eq", "fun": lambda x: np.sum(x) - math.pi},
        )
        found += [best.fun] if best.success else []
    assert kappa(n) == close(min(found), rel=1e-6)


def followed(scenario, by="law", **given):
    """Time in continuous time over L(0), s/m."""
    team, _, extent = started(scenario)
    return certificate(team, by=by, **given).continuous_time_bound / extent


def test_theorem_g_matches_hand_computation():
    for n in (2, 3, 5, 12):
        team = Scenario(n_robots=n, graph=graphs.complete(0.7))
        assert followed(team) == close(1 / (4 * 0.7))
        assert followed(team.replace(dim=3)) == close(1 / (2 * math.pi) / 0.7)
    any_graph = Scenario(graph=UNEQUAL)
    kappa_5 = 1 + 4 * math.sin(math.pi / 8) ** 2
    assert followed(any_graph) == close(1 / (2 * 0.9 * kappa_5))
    assert followed(any_graph.replace(dim=3)) == close(5 / (2 * math.pi) / (2 * 0.9))
    assert followed(any_graph.replace(max_speed=0.3)) == close(1 / (2 * 0.3 * kappa_5))
    ring = Scenario(n_robots=12, graph="cycle")
    assert followed(ring) == close(1 / (4 * 12 * math.sin(math.pi / 12) ** 2))
    path = Scenario(n_robots=4, graph="path")
    assert followed(path, "gains") == close(1 / (2 * 1.75))
    assert followed(path, "gains", min_gain=0.5) == close(1 / (2 * 0.5 * 1.75))
    slow = path.replace(max_speed=0.25)
    assert followed(slow, "gains", min_gain=0.5) == close(1 / (2 * 0.25 * 1.75))
    # all but the nearest may be hidden, and the nearest is seen
    hidden = Scenario(n_robots=4, sensing=Sensing(occlusion="robots"))
    assert followed(hidden) == followed(hidden, "gains") == close(1 / (2 * 1.75))
    # κ₁: 1 for a pair; π c/(n − 1) in space
    led = Scenario(n_robots=4, graph=graphs.directed([(1, 0), (2, 1), (3, 1, 2.0)]))
    rate = 2 * 3 * math.sin(math.pi / 6) ** 2
    assert followed(led) == followed(led, "gains") == close(1 / rate)
    assert shrinking_to_leader(2, 2, 3.0) == close(6.0)
    assert shrinking_to_leader(3, 3, 1.0) == close(math.pi / 2)


def test_sampled_gains_match_hand_computation():
    """C = D̄ = 2 m/s, τ C = r/2: k = ½/(½ + 2 · ½ · 0.5/2); 2m(1 − cos(π/m)) falls with m.

    With a stationary root, 0.78 of the directions within 75° of one count.
    """
    team = Scenario(n_robots=4, graph="path", start_positions=SQUARE)
    found = certificate(team, by="gains", min_gain=0.5)
    rate = 0.5 * 0.5 / (0.5 + 2 * 0.125)
    least = 8 - 4 * math.sqrt(2)
    assert depth_gained([2, 3, 4], 2, False).tolist() == close([4.0, 3.0, least])
    assert found.time_bound == close(16 / (rate * least) + 3 * team.tau)
    assert float(depth_gained(2, 3, False)) == close(2 * math.pi)
    assert float(depth_gained(2, 2, True)) == close(0.78 * 2 * (1 - math.cos(5 * math.pi / 12)))
    assert math.isinf(found.lyapunov_bound) and found.hull_bound == close(16)
    assert found.tolerated_bearing_error == 0.0  # gains that differ bear nothing


def test_law_1_has_bounds_of_a_g_and_d1():
    start = [[0.0, 0.0], [8.0, 0.0], [4.0, 1.0], [4.0, 3.0], [2.0, 1.0]]
    team = Scenario(graph=UNEQUAL, start_positions=start)
    found, extent = certificate(team), 8 + 2 * 5.0  # the other two lie inside
    above = float(lyapunov(start, UNEQUAL)) + ALLOWANCE
    half, cones = 1 / 2, 10 * (1 - math.cos(math.pi / 5))  # τ D̄ = r/2
    slow = half / (half + 2 * half * 0.9 / 6.5)
    sampled = extent / (0.9 * cones * slow) + 4 * team.tau
    held = min(2 * 5 * above / (8 * 0.9**2), sampled)
    assert found.time_bound == found.sampled_time_bound == close(held)
    expected = {"time": held, "lyapunov": above, "hull": extent}
    assert found.promises == close(expected) and not found.continuous_time_only


def test_two_robots_have_closed_form_bound():
    """Two robots approach at 2a: T = d/(2a), also with held inputs."""
    pair = Scenario(n_robots=2, start_positions=[[0, 0], [3, 4]], graph=graphs.path(0.5))
    found = certificate(pair)
    assert found.continuous_time_bound == close(5 / (2 * 0.5))
    assert found.time_bound == close(5 / (2 * 0.5) + pair.tau)


@pytest.mark.slow
def test_bound_g_is_at_most_bound_a():
    """Clusters, lines and clouds, on all graphs, with and without a speed limit."""
    random = np.random.default_rng(0)
    for trial in range(300):
        n, dim = int(random.integers(2, 9)), 2 + trial % 2
        start = random.normal(size=(n, dim)) * 10.0 ** random.uniform(-3, 2, size=(n, 1))
        start[:, 1:] *= random.choice([0.0, 1.0])
        links = unequal_matrix(n, trial) if trial % 3 else 1.0 - np.eye(n)
        team = Scenario(n_robots=n, dim=dim, graph=links, start_positions=start, merge_radius=1e-6)
        if random.random() < 0.5:
            team = team.replace(max_speed=team.max_degree * random.uniform(0.01, 1))
        found = certificate(team)
        assert found.continuous_time_bound < found.time_bound < math.inf


@pytest.mark.parametrize(
    ("dim", "worst"),
    [
        (2, {2: 2 * math.sqrt(2), 3: 2 + math.sqrt(2), 4: 4, 30: 4}),
        (3, {2: math.pi * math.sqrt(3), 8: 3 * math.pi, 30: 3 * math.pi}),
    ],
)
def test_size_of_spawn_area_matches_hand_computation(dim, worst):
    for n, extent in worst.items():
        assert largest_size(Scenario(n_robots=n, dim=dim, spawn_size=5.0)) == close(5 * extent)


def test_bounds_of_spawn_box_match_hand_computation():
    """The perimeter of a 3 × 4 rectangle, twice its diagonal for two robots, and V = 2W · 5."""
    box = Scenario(n_robots=4, spawn_size=(3.0, 4.0))
    assert largest_size(box) == close(14.0)
    assert largest_size(box.replace(n_robots=2)) == close(10.0)
    assert largest_lyapunov(box) == close(2 * 6 * 5.0)
    assert box.spawn_edges == (3.0, 4.0)


def test_pursuit_bounds_match_hand_computation():
    team = Scenario(robot_model="unicycle", max_turn_rate=4.0, merge_radius=0.2)
    kappa_5 = 1 + 4 * math.sin(math.pi / 8) ** 2
    turning = 5 * math.pi / (4 - 2 * 0.3 / 0.2)
    assert pursuit_bound(team, 9.0, 0.3) == close(9 / (2 * 0.3 * kappa_5) + turning)
    space = team.replace(robot_model="nonholonomic_3d", dim=3)
    driving = 5 * 9 / (2 * math.pi) / (2 * 0.3)
    assert pursuit_bound(space, 9.0, 0.3) == close(driving + turning)
    for wrong in (0.0, 0.4, math.nan):
        with pytest.raises(ValueError, match=r"speed is .*less than ω_max r/2 = 0\.4 m/s"):
            pursuit_bound(team, 9.0, wrong)
    assert np.isfinite(pursuit_bound(team.replace(graph=graphs.directed_cycle()), 9.0, 0.3))
    for none in (  # where a leader rests, or links change
        team.replace(n_robots=2, graph=graphs.directed([(0, 1)], 2)),
        team.replace(graph=graphs.switching([graphs.directed_cycle(), "path"])),
        team.replace(graph=graphs.proximity(), sensing=Sensing(range=9.0)),
    ):
        assert np.isinf(pursuit_bound(none, 9.0, 0.3))


def test_lower_bound_matches_hand_computation():
    team = Scenario(n_robots=3, merge_radius=0.2, max_speed=0.5)
    start = [[0.0, 0.0], [6.0, 8.0], [3.0, 4.0]]
    assert rendezvous_time_lower_bound(team, start) == close((5 - 2 * 0.1) / 0.5)
    crowded = team.replace(obstacles=[Disc((50.0, 0.0), 1.0)])
    assert rendezvous_time_lower_bound(crowded, start) == close((5 - 2 * 0.2) / 0.5)
    assert rendezvous_time_lower_bound(team, np.zeros((3, 2))) == 0
