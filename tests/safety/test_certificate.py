"""What a certificate says: which theorem, which numbers, or in words why none."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from conftest import UNEQUAL, unequal_matrix

from rendezvous_env import Disc, Scenario, Simulator, certificate, graphs
from rendezvous_env.safety.lyapunov import lyapunov
from rendezvous_env.safety.theorems import gains
from rendezvous_env.safety.theorems.constants import largest_lyapunov, largest_size
from rendezvous_env.safety.theorems.theorem import LAW
from rendezvous_env.scenario import scenarios

WALL = (Disc((0.0, 0.0), 1.0),)
LONG = Scenario(time_step=0.1, allow_long_step=True)
PIECES = Scenario(graph=graphs.from_edges([(0, 1)], 5), require_connected=False)
HEAVY = Scenario(robot_model="double_integrator")


@pytest.mark.parametrize(
    ("scenario", "margin", "guaranteed", "finite", "words"),
    [
        (Scenario(), 1.0, True, True, "theorems 1 and G"),
        (Scenario(), 0.1, True, True, "theorems 2 and C"),
        (Scenario(dim=3), 1.0, True, True, "theorems 1 and G"),
        (Scenario(robot_model="unicycle"), 1.0, True, False, "theorem 3"),
        (Scenario(robot_model="nonholonomic_3d", dim=3), 1.0, True, False, "theorem 4"),
        (Scenario(obstacles=WALL), 1.0, False, False, "none: obstacles"),
        (Scenario(obstacles=WALL, obstacle_contact="ignore"), 1.0, True, True, "theorems 1 and G"),
        (LONG, 1.0, False, False, "none for law"),
        (LONG, 0.1, True, True, "scaled to the long step"),
        (PIECES, 1.0, False, False, "none: the graph is not connected"),
    ],
)
def test_certificates(scenario, margin, guaranteed, finite, words):
    found = certificate(scenario, margin)
    assert found.guaranteed is guaranteed and math.isfinite(found.time_bound) is finite
    assert words in found.theorem
    assert found.by == ("law" if margin == 1 else "heading")
    assert found.min_alignment == found.margin == margin and found.dead_zone == scenario.dead_zone
    assert found.certified_step == scenario.certified_step
    assert found.bottleneck_weight == scenario.bottleneck_weight


# ---- law (1) -------------------------------------------------------------------------------------


def test_law_1_is_certified_by_g_and_a_and_held_by_d1_too():
    start = [[0.0, 0.0], [8.0, 0.0], [4.0, 1.0], [4.0, 3.0], [2.0, 1.0]]
    team = Scenario(graph=UNEQUAL, start_positions=start)
    found = certificate(team)
    kappa = 1 + 4 * math.sin(math.pi / 8) ** 2
    perimeter = 8 + 2 * 5.0  # the other two lie inside
    assert found.continuous_time_bound == pytest.approx(perimeter / (2 * 0.9 * kappa))
    above = float(lyapunov(start, UNEQUAL)) + 4 * 0.2 * 6.5
    psi, half = math.pi / 5, 1 / 2  # τ D̄ = r/2
    slow = half / (half + 2 * half * 0.9 / 6.5)
    sampled = perimeter / (0.9 * math.sin(psi / 2) * psi * slow) + 4 * team.tau
    assert gains.bounds(team, LAW).time == pytest.approx(sampled)
    held = min(2 * 5 * above / (8 * 0.9**2), sampled)
    assert found.time_bound == found.sampled_time_bound == pytest.approx(held)
    assert found.lyapunov_bound == pytest.approx(above)
    assert found.hull_bound == pytest.approx(perimeter) and not found.continuous_time_only
    assert found.promises == {
        "time": found.time_bound,
        "lyapunov": found.lyapunov_bound,
        "hull": found.hull_bound,
    }


def test_g_is_never_above_a():
    """Of clusters, lines and clouds, on all graphs, with and without a speed limit."""
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


def test_a_pair_is_certified_by_the_closed_form_and_a_step():
    """Two robots close at 2a: T = d/(2a), held or not."""
    pair = Scenario(n_robots=2, start_positions=[[0, 0], [3, 4]], graph=graphs.path(0.5))
    found = certificate(pair)
    assert found.continuous_time_bound == pytest.approx(5 / (2 * 0.5))
    assert found.time_bound == pytest.approx(5 / (2 * 0.5) + pair.tau)


def test_the_size_of_the_spawn_area_by_hand():
    worst = {2: 2 * math.sqrt(2), 3: 2 + math.sqrt(2), 4: 4, 30: 4}
    for n, perimeter in worst.items():
        assert largest_size(Scenario(n_robots=n, spawn_size=5.0)) == pytest.approx(5 * perimeter)
    space = {2: math.pi * math.sqrt(3), 8: 3 * math.pi, 30: 3 * math.pi}
    for n, extent in space.items():
        assert largest_size(Scenario(n_robots=n, dim=3, spawn_size=5.0)) == pytest.approx(
            5 * extent
        )


@pytest.mark.parametrize("name", ["fig3", "duo", "ring-12", "tree-12", "cloud-8", "random-10"])
def test_a_certificates_bound_covers_every_start(name):
    scenario = scenarios.get(name)
    sim = Simulator(scenario, 200)
    sim.reset(0)
    assert largest_lyapunov(scenario) >= sim.lyapunov().max()  # with which all bounds grow
    assert largest_size(scenario) * (1 + 1e-9) >= sim.size().max()
    assert certificate(scenario).hull_bound * (1 + 1e-9) >= sim.size().max()


# ---- the tank ------------------------------------------------------------------------------------


def test_a_tank_bounds_v_where_no_time_is_proven():
    v0, w = 20 * 10 * math.sqrt(2), 10
    for scenario, places, words in (
        (Scenario(robot_model="unicycle"), 2, "no time by which unicycle robots"),
        (Scenario(obstacles=WALL), 3, "theorem D still keeps V bounded"),
    ):
        found = certificate(scenario, 0.5, by="tank", budget=3.0)
        assert not found.guaranteed and found.time_bound == np.inf
        assert found.theorem.startswith("none") and words in found.theorem
        assert found.lyapunov_bound == pytest.approx(v0 + places * 4 * 0.2 * w + 15)
    for scenario, words in ((HEAVY, "no theorem covers"), (PIECES, "not connected")):
        found = certificate(scenario, 0.5, by="tank")
        assert not found.guaranteed and words in found.theorem
        assert found.time_bound == found.lyapunov_bound == np.inf


# ---- bad arguments -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"by": "gain"}, "by is 'gain'; it must be one of 'law', 'heading', 'tank', 'gains'"),
        ({"by": 3}, "by is 3"),
        ({"by": "law", "min_alignment": 0.5}, "min_alignment is 0.5; it must be exactly 1 with by"),
        ({"by": "heading"}, "min_alignment is 1.0; it must be less than 1 with by"),
        ({"by": "tank", "min_alignment": 1.5}, "min_alignment is 1.5"),
        ({"by": "tank", "budget": -1.0}, "budget is -1.0; it must be finite and at least 0"),
        ({"by": "tank", "budget": math.nan}, "budget is nan"),
        ({"budget": 1.0}, 'budget is 1.0; it must be 0 with by="law": only a tank has one'),
        ({"by": "gains", "min_alignment": 0.5}, "min_alignment is 0.5; it must be exactly 1"),
        ({"by": "links", "budget": 1.0}, "budget is 1.0; it must be 0 with by"),
        ({"by": "tank", "min_gain": 1.0}, "min_gain is 1.0; it must be None with by"),
        ({"by": "links", "max_gain": 1.0}, "max_gain is 1.0; it must be None with by"),
        ({"by": "gains", "min_gain": -1.0}, "min_gain is -1.0; it must be a positive"),
        ({"by": "gains", "share": 0.2}, "share is 0.2; it must be 0.5 with by"),
        ({"by": "links", "share": 0.0}, r"share is 0.0; it must be in \(0, 1\]"),
        ({"bearing_error": 2.0}, "bearing_error is 2.0; it must be"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        certificate(Scenario(), **given)


@pytest.mark.parametrize("graph", ["cycle", "complete"])
def test_certificates_of_ten_thousand_robots_follow_the_edges(graph):
    """They took 31 s and 4.8 GB; a matrix of the robots alone is 0.8 GB."""
    team = Scenario(n_robots=10_000, graph=graph, spawn_size=1000.0)
    tracemalloc.start()
    for by, margin in (("law", 1.0), ("heading", 0.1), ("tank", 0.1), ("gains", 1.0)):
        assert certificate(team, margin, by=by).guaranteed
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6
