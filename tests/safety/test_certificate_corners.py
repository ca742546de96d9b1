"""Corner cases with weaker certificates.

These are extreme numbers, too few rows, and initial positions and graphs other than the scenario's.
"""

import inspect
import itertools
import math
import re

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from test_certificate import MARGINS, alone

import baselines
from rendezvous_env import Disc, Scenario, Sensing, Simulator, certificate, graphs, rollout
from rendezvous_env.safety.theorems.constants import max_neighbours
from rendezvous_env.safety.theorems.theorem import CHOICES
from rendezvous_env.vector import EnergyTankWrapper


def test_default_tank_margin_equals_wrapper():
    """The paper's laws have a minimum alignment of 1, which a tank cannot have."""
    scenario = Scenario(n_robots=3)
    usual = inspect.signature(EnergyTankWrapper).parameters["min_alignment"].default
    found = certificate(scenario, by="tank")
    assert found == certificate(scenario, usual, by="tank") and found.min_alignment == usual
    assert found.time_bound > 1000.0


def test_overflowing_bound_is_reported():
    for budget in (1e307, 1e308):  # two of 1e308 m²/s overflow themselves
        found = certificate("duo", 0.1, by="tank", budget=budget)
        assert not found.guaranteed and math.isinf(found.time_bound)
        assert re.match("none: the bound of a tank .* overflows.*is not guaranteed", found.theorem)
        assert "No rendezvous is guaranteed" in str(found)
    wrong = certificate("duo", 0.1, by="tank", budget=1e308, bearing_error=1e-3)
    assert "overflows" in wrong.theorem  # not the error's fault


HUBS = Scenario(
    n_robots=6, graph=graphs.from_edges([(0, 1), (0, 2), (0, 3), (1, 4), (1, 5)]),
    start_positions=((0.0, 0.0), (0.5, 0.0), (0.0, 3.0), (0.0, -3.0), (0.5, 3.0), (0.5, -3.0)),
)  # fmt: skip
"""Two hubs of two leaves each; the hubs merge first and then have four neighbours."""


@pytest.mark.parametrize("by", list(CHOICES))
def test_merged_robots_need_row_per_neighbour(by):
    few, enough = HUBS.replace(neighbour_slots=3), HUBS.replace(neighbour_slots=4)
    with pytest.raises(RuntimeError, match="more than neighbour_slots = 3"):
        rollout(few, baselines.make("bearing-only", few))
    found = certificate(few, MARGINS[by], by=by)
    assert not found.guaranteed and re.match("none: merged robots may have up to 4", found.theorem)
    assert certificate(enough, MARGINS[by], by=by).guaranteed
    assert rollout(enough, baselines.make("bearing-only", enough)).success
    turning = few.replace(robot_model="unicycle")
    assert "up to 4" in certificate(turning).theorem


def test_most_neighbours_includes_merges():
    """Compared with all connected groups of some random trees and graphs."""
    random = np.random.default_rng(0)
    for n, extra in itertools.product((2, 4, 6, 7), (0, 2)):
        links = [(random.integers(i), i) for i in range(1, n)]
        links += [random.permutation(n)[:2] for _ in range(extra)]
        linked = np.zeros((n, n), bool)
        linked[tuple(np.transpose(links))] = True
        linked |= linked.T
        groups = [list(some) for k in range(1, n) for some in itertools.combinations(range(n), k)]
        worst = max(
            np.delete(linked[group].any(axis=0), group).sum()
            for group in groups
            if connected_components(linked[np.ix_(group, group)])[0] == 1
        )
        team = Scenario(n_robots=n, graph=1.0 * linked)
        assert worst <= max_neighbours(team) <= team.sensing_graph.most_neighbours(n)
    for kind, most in {"path": 2, "cycle": 2, "star": 7, "complete": 7}.items():
        assert max_neighbours(Scenario(n_robots=8, graph=kind)) == most


def test_given_positions_require_scenario_field():
    """Far outside the spawn area, V and the time exceed the scenario's bounds."""
    scenario, far = Scenario(n_robots=2), ((0.0, 0.0), (90.0, 0.0))
    own, given = certificate(scenario), certificate(scenario.replace(start_positions=far))
    simulator = Simulator(scenario)
    simulator.reset(0, {"positions": far})
    assert own.lyapunov_bound < simulator.lyapunov()[0] <= given.lyapunov_bound
    assert own.time_bound < 40.0 < given.time_bound  # each goes 1 m/s
    assert "scenario.replace(start_positions=…" in certificate.__doc__


def test_given_weights_require_own_environment():
    """The wrapper's minimum gain is a* of its own scenario, a hundred times smaller."""
    light = Scenario(n_robots=2, graph=graphs.complete((0.01, 1.0)), spawn_size=2.0)
    heavy = light.replace(graph=graphs.complete(1.0))
    found, met = certificate(heavy, by="gains"), []
    for scenario in (light, heavy):
        env, simulator = alone(scenario, "gains")
        env.reset(seed=0, options={"weights": 1.0 - np.eye(2)})
        while simulator.time[0] < found.time_bound:
            if env.step([[[1e-6], [1e-6]]])[2].any():
                break
        met.append(simulator.active.sum() == 1)
    assert met == [False, True]
    assert "create the environment from that scenario" in " ".join(certificate.__doc__.split())


@pytest.mark.slow
def test_given_obstacles_require_own_environment():
    """With obstacles, tanks are not reduced at merges: the last two may use all energy."""
    places = 4.0 * np.random.default_rng(5).normal(size=(8, 2))
    free = Scenario(n_robots=8, start_positions=places, local_frames="global", time_limit=500.0)
    other = free.replace(obstacles=Disc((100.0, 0.0), 1.0))
    bound, met = certificate(free, 0.5, by="tank").time_bound, []
    for scenario in (free, other):
        env, simulator = alone(scenario, "tank", min_alignment=0.5)
        seen, _ = env.reset(seed=0, options={"obstacles": ()})
        while simulator.time[0] < bound:
            f = scenario.observation_layout.net_bearing(seen)
            f *= simulator.active.sum() > 2  # then they rest
            seen, _, ended, *_ = env.step(0.6 * f / scenario.speed_limit)
            if ended.any():
                break
        met.append(simulator.active.sum() == 1)
    assert met == [True, False]
    assert (
        "weights or obstacles passed to ``reset(options=…)`` are not covered" in certificate.__doc__
    )


def test_sampled_links_must_be_visible():
    """Given initial positions: the random tree may contain any pair."""
    places = ((0.0, 0.0), (2.0, 0.0), (4.0, 0.0))
    for graph, far, near in (("path", True, True), (graphs.random_tree(), False, True)):
        for reach, granted in ((3.0, far), (5.0, near)):
            sensing = Sensing(range=reach)
            scenario = Scenario(n_robots=3, graph=graph, sensing=sensing, start_positions=places)
            assert certificate(scenario, by="links").guaranteed == granted


@pytest.mark.parametrize(("told", "lengthened"), [(0.0, True), (0.7, False)])
def test_wrapper_must_know_bearing_error(told, lengthened):
    places = ((0.0, 0.0), (2.0, 0.0))
    scenario = Scenario(n_robots=2, start_positions=places, sensing=Sensing(error=0.7))
    turned = scenario.replace(local_frames="global")
    env, simulator = alone(turned, "links", share=1e-6, bearing_error=told)
    for _ in range(3):
        env.step([[[-0.2, 0.5], [0.2, -0.5]]])
    gap = np.diff(simulator.positions[0], axis=0)[0]
    assert (np.linalg.norm(gap) > 2.0 + 1e-6) == lengthened
    exact = scenario.replace(sensing=Sensing())
    for by in CHOICES:
        words = str(certificate(exact, MARGINS[by], by=by))
        assert ("rounding, with that bearing_error in the wrapper" in words) == (
            by in ("heading", "tank", "links")
        )
        words = str(certificate(scenario, MARGINS[by], by=by))
        assert ("with bearing_error=0.7 in the wrapper" in words) == (
            by in ("heading", "tank", "links")
        )
    turning = Scenario(robot_model="unicycle", sensing=Sensing(error=0.3))  # V, and no more
    for by in ("heading", "tank"):
        assert "these bounds hold with bearing_error" in str(certificate(turning, 0.3, by=by))
