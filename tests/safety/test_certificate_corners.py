"""Corners in which certificates promise less: numbers without size, too few rows, starts and graphs
that are not the scenario's own.
"""

import inspect
import itertools
import math
import re

import numpy as np
import pytest
from alone import alone
from test_certificate import MARGINS

import baselines
from rendezvous_env import Disc, Scenario, Sensing, Simulator, certificate, graphs, rollout
from rendezvous_env.safety.theorems.constants import most_neighbours
from rendezvous_env.safety.theorems.theorem import CHOICES
from rendezvous_env.vector import EnergyTankWrapper


def test_a_tank_that_is_given_no_margin_has_that_of_its_wrapper():
    """1 is the margin of the paper's laws, which no tank can have."""
    scenario = Scenario(n_robots=3)
    usual = inspect.signature(EnergyTankWrapper).parameters["min_alignment"].default
    found = certificate(scenario, by="tank")
    assert found == certificate(scenario, usual, by="tank") and found.min_alignment == usual
    assert found.time_bound > 1000.0


def test_a_bound_that_overflows_says_so():
    for budget in (1e307, 1e308):  # two of 1e308 m²/s overflow themselves
        found = certificate("duo", 0.1, by="tank", budget=budget)
        assert not found.guaranteed and math.isinf(found.time_bound)
        assert re.match("none: the bound of a tank .* overflows.*no rendezvous", found.theorem)
        assert "No rendezvous is guaranteed" in str(found)
    wrong = certificate("duo", 0.1, by="tank", budget=1e308, bearing_error=1e-3)
    assert "overflows" in wrong.theorem  # not the error's fault


@pytest.mark.parametrize("by", list(CHOICES))
def test_steps_that_rounding_swallows_are_promised_nothing(by):
    """Two robots at 8 m that go 4e-16 m in a step stay where they are for ever."""
    scenario = Scenario(
        n_robots=2, graph=graphs.complete(4e-7), start_positions=((8.0, 8.0), (8.5, 8.0)),
        time_step=1e-9, time_limit=1e6,
    )  # fmt: skip
    simulator, still = Simulator(scenario), scenario.start_positions
    simulator.step(baselines.make("bearing-only", scenario)(simulator.reset(0), 0.0))
    assert (simulator.positions[0] == still).all()
    found = certificate(scenario, MARGINS[by], by=by)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert re.match("none: a step may move robots by as little as .*of 8.5 m; it", found.theorem)
    assert certificate(scenario.replace(time_step=0.1), MARGINS[by], by=by).guaranteed


@pytest.mark.parametrize(
    ("by", "sensing"), [("law", Sensing(occlusion="robots")), ("links", Sensing(range=3.0))]
)
def test_steps_that_rounding_swallows_where_only_the_lightest_links_are_in_sight(by, sensing):
    """Each of four robots sees those next to it alone, and goes 3e-14 m in a step, at 1 km."""
    weights = np.where(abs(np.subtract.outer(range(4), range(4))) > 1, 1e3, 1e-9) * (1 - np.eye(4))
    places = tuple((1e3 + x, 1e3) for x in (-3.0, -1.0, 1.0, 3.0))
    scenario = Scenario(n_robots=4, graph=weights, start_positions=places, sensing=sensing)
    law, simulator = baselines.make("bearing-only", scenario), Simulator(scenario)
    seen = simulator.reset(0)
    if by == "links":
        env, simulator = alone(scenario, "links")
    for _ in range(3):
        if by == "law":
            seen = simulator.step(law(seen, 0.0)).observations
        else:
            env.step(np.zeros((1, 4, 2)))
    assert (simulator.positions[0] == places).all()
    found = certificate(scenario, by=by)
    assert not found.guaranteed and "which rounding takes from" in found.theorem
    weights = np.clip(weights, 1e-6, 1.0) * (1 - np.eye(4))
    near = {"start_positions": np.array(places) - 1e3, "graph": weights}
    assert certificate(scenario.replace(**near), by=by).guaranteed


def test_steps_that_rounding_swallows_where_a_tank_has_carried_robots():
    """Law (4) moves them by 10⁻⁷ m, nearly across f: what it brings them nearer is rounded away."""
    start = {"n_robots": 2, "start_positions": ((0.0, 0.0), (1.0, 0.0)), "local_frames": "global"}
    scenario = Scenario(**start, graph=graphs.complete(1e-9), max_speed=1.0)
    found = certificate(scenario, 1e-6, by="tank", budget=1e9)
    assert not found.guaranteed and "which rounding takes from" in found.theorem
    assert certificate(scenario, 1e-4, by="tank").guaranteed
    env, simulator = alone(scenario, "tank", budget=1e9, min_alignment=1e-6)
    simulator.set_max_steps(200)
    for _ in range(112):
        env.step([[[-0.3, 0.0], [0.3, 0.0]]])
    before = env.get_state()
    for side in (1.0, -1.0):
        env.step([[[0.0, side], [0.0, -side]]])
    after = env.get_state()
    assert (
        not env.tank.carried_out.any()
        and (before["tank"]["levels"] == after["tank"]["levels"]).all()
    )
    assert (before["env"]["positions"] == after["env"]["positions"]).all()  # and so for ever


@pytest.mark.parametrize("by", ["heading", "tank", "links"])
def test_errors_of_which_no_wrapper_can_be_told_are_promised_nothing(by):
    """A tank that charges for π/2 rad alone lets V rise by more than it holds."""
    places, budget = ((0.0, 0.0), (1.0, 0.0)), 4.0 * (by == "tank")
    scenario = Scenario(n_robots=2, start_positions=places, sensing=Sensing(error=2.2))
    found = certificate(scenario, MARGINS[by], by=by, budget=budget)
    assert not found.promises and "no wrapper can be told" in found.theorem
    right = certificate(scenario.replace(sensing=Sensing(error=1.5)), MARGINS[by], by=by)
    assert right.lyapunov_bound < 3.0
    if by == "tank":
        scenario = scenario.replace(local_frames="global")
        env, simulator = alone(scenario, "tank", budget=budget, bearing_error=math.pi / 2.0)
        for _ in range(225):
            env.step([[[-0.1, 0.0], [0.1, 0.0]]])
        assert simulator.lyapunov()[0] > right.lyapunov_bound + 2.0 * budget


def test_errors_that_rounding_may_make_too_large_are_promised_nothing():
    """Four in a square whose cones of bearings, so widened, leave a speed that float32 makes 0."""
    angles = 0.3 + np.pi / 2.0 * np.arange(4)
    places = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    error = math.pi / 8.0 * (1.0 - 1e-9)  # π/(2n) is too much
    start = {"n_robots": 4, "start_positions": places, "local_frames": "global"}
    scenario = Scenario(**start, sensing=Sensing(error=error))
    env, simulator = alone(scenario, "links", share=1.0, bearing_error=error)
    env.step(np.zeros((1, 4, 2)))
    assert (simulator.positions[0] == places).all()  # and so for ever
    found = certificate(scenario, by="links", share=1.0)
    assert not found.guaranteed and "known to tolerate less" in found.theorem
    assert [*found.promises] == ["lyapunov", "link_growth"]
    better = scenario.replace(sensing=Sensing(error=error - 1e-6))
    assert certificate(better, by="links", share=1.0).guaranteed


HUBS = Scenario(
    n_robots=6, graph=graphs.from_edges([(0, 1), (0, 2), (0, 3), (1, 4), (1, 5)]),
    start_positions=((0.0, 0.0), (0.5, 0.0), (0.0, 3.0), (0.0, -3.0), (0.5, 3.0), (0.5, -3.0)),
)  # fmt: skip
"""Two hubs of two leaves each, which merge first and then have four neighbours."""


@pytest.mark.parametrize("by", list(CHOICES))
def test_merged_robots_need_a_row_for_each_neighbour(by):
    few, enough = HUBS.replace(neighbour_slots=3), HUBS.replace(neighbour_slots=4)
    with pytest.raises(RuntimeError, match="more than neighbour_slots = 3"):
        rollout(few, baselines.make("bearing-only", few))
    found = certificate(few, MARGINS[by], by=by)
    assert not found.guaranteed and re.match("none: merged robots may have up to 4", found.theorem)
    assert certificate(enough, MARGINS[by], by=by).guaranteed
    assert rollout(enough, baselines.make("bearing-only", enough)).success
    turning = few.replace(robot_model="unicycle")
    assert "up to 4" in certificate(turning).theorem


def test_how_many_neighbours_merged_robots_can_have():
    """Against all connected groups of a few drawn trees and webs."""
    random = np.random.default_rng(0)
    for n in (2, 4, 6, 7):
        for extra in (0, 2):
            links = {(int(random.integers(i)), i) for i in range(1, n)}
            links |= {tuple(sorted(map(int, random.permutation(n)[:2]))) for _ in range(extra)}
            team = Scenario(n_robots=n, graph=graphs.from_edges(sorted(links)))
            worst = max(
                len(
                    {
                        i
                        for link in links
                        if len({*link} & {*group}) == 1
                        for i in {*link} - {*group}
                    }
                )
                for k in range(1, n)
                for group in itertools.combinations(range(n), k)
                if is_joined(group, links)
            )
            assert worst <= most_neighbours(team) <= team.sensing_graph.most_neighbours(n)
    exact = {"path": 2, "cycle": 2, "star": 7, "complete": 7}
    for kind, most in exact.items():
        assert most_neighbours(Scenario(n_robots=8, graph=kind)) == most


def is_joined(group, links):
    """Whether links among them connect some robots."""
    seen = {group[0]}
    for _ in group:
        seen |= {i for link in links if {*link} <= {*group} and {*link} & seen for i in link}
    return seen == {*group}


def test_steps_that_rounding_swallows_are_told_of_turning_robots_and_margins():
    slow = Scenario(robot_model="unicycle", graph=graphs.complete(1e-6), time_step=1e-7)
    assert "rounding" in certificate(slow, 0.3).theorem
    assert certificate(slow).continuous_time_only  # theorem 3 speaks of no steps
    slow = Scenario(graph=graphs.complete(1e-3), time_step=1e-2)  # 2⁻⁵⁹ of 5 m for ε = 10⁻⁶
    assert certificate(slow, 1e-3).guaranteed and not certificate(slow, 1e-6).guaranteed


def test_turns_that_rounding_swallows_are_promised_nothing():
    """Two unicycles across f that turn by 10⁻¹⁶ rad in a step point there for ever."""
    team = {"n_robots": 2, "robot_model": "unicycle", "start_headings": [[math.pi / 2.0]] * 2}
    scenario = Scenario(**team, start_positions=((1.0, 1.0), (2.0, 1.0)), time_step=1e-7)
    slow = scenario.replace(max_turn_rate=1e-9)
    env, _ = alone(slow, "heading", min_alignment=0.3)
    before = env.get_state()["env"]
    env.step([[[1.0], [1.0]]])
    after = env.get_state()["env"]
    assert all((before[name] == after[name]).all() for name in ("positions", "memory"))
    found = certificate(slow, 0.3)
    assert not found.guaranteed and "rounding takes from their angles" in found.theorem
    assert certificate(scenario, 0.3).guaranteed


def test_steps_that_rounding_swallows_where_a_small_margin_has_led_robots():
    """Two abreast walk 1.4 km aside on their budget; what law (4) brings them nearer is lost there,
    10⁻¹³ m in a step, on which they go on aside for ever.
    """
    start = {"start_positions": ((0.0, 0.0), (0.7, -0.7)), "local_frames": "global"}
    scenario = Scenario(n_robots=2, **start, graph=graphs.complete(1e-3), max_speed=1.0)
    settings = {"budget": 0.4, "min_alignment": 1e-6, "decision_period": 1000}
    env, simulator = alone(scenario.replace(time_limit=1e9), "tank", **settings)
    for _ in range(58):
        env.step(np.full((1, 2, 2), 1.8e-4))
    before = simulator.positions[0]
    *_, infos = env.step(np.ones((1, 2, 2)))
    after = simulator.positions[0]
    assert not infos["carried_out"].any() and (after > before).all()
    assert (after[1] - after[0] == before[1] - before[0]).all()
    for by, budget in (("tank", 0.4), ("heading", 0.0)):
        assert "rounding takes" in certificate(scenario, 1e-6, by=by, budget=budget).theorem
        assert certificate(scenario, 1e-3, by=by, budget=budget).guaranteed


def test_steps_that_rounding_swallows_earn_what_tanks_raise_v_by():
    """At 1000 km steps of 5·10⁻¹¹ m towards each other are paid, and move nobody."""
    start = {"start_positions": ((1e6, 1e6), (1e6 + 1e-5, 1e6)), "local_frames": "global"}
    scenario = Scenario(n_robots=2, **start, merge_radius=1e-6, time_limit=10.0)
    found, slow = certificate(scenario, 1e-6, by="tank"), 5e-11 / scenario.tau
    env, simulator = alone(scenario, "tank", min_alignment=1e-6, decision_period=1000)
    for _ in range(40):
        env.step([[[slow, 0.0], [-slow, 0.0]]])
    assert (simulator.positions[0] == scenario.start_positions).all()
    env.decision_period = 75
    env.step([[[-0.05, 0.0], [0.05, 0.0]]])
    assert simulator.lyapunov()[0] > 2e-5 + 2e-6  # V(0) + 2 r W
    assert not found.promises and "rounding takes" in found.theorem


def test_starts_of_options_are_asked_for_in_a_scenario():
    """Far outside of the spawn area V and the time are beyond what the scenario is promised."""
    scenario, far = Scenario(n_robots=2), ((0.0, 0.0), (90.0, 0.0))
    own, given = certificate(scenario), certificate(scenario.replace(start_positions=far))
    simulator = Simulator(scenario)
    simulator.reset(0, {"positions": far})
    assert own.lyapunov_bound < simulator.lyapunov()[0] <= given.lyapunov_bound
    assert own.time_bound < 40.0 < given.time_bound  # each goes 1 m/s
    assert "scenario.replace(start_positions=…" in certificate.__doc__


def test_weights_of_options_are_asked_for_in_an_environment_of_their_own():
    """The wrapper's least gain is a* of its own scenario, a hundred times less than theirs."""
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
    assert "made of that scenario" in certificate.__doc__


def test_obstacles_of_options_are_asked_for_in_an_environment_of_their_own():
    """Tanks of a scenario with obstacles do not shrink at merges: the last two may spend all."""
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
    assert "Of other weights or obstacles" in certificate.__doc__


@pytest.mark.parametrize("by", CHOICES)
def test_a_family_that_need_not_connect_its_robots_promises_nothing(by):
    graphs.family("two-pairs", lambda n, random: [(0, 1), (2, 3)])
    scenario = Scenario(n_robots=4, graph="two-pairs", require_connected=False)
    found = certificate(scenario, MARGINS[by], by=by)
    assert not found.guaranteed and "need not connect" in found.theorem


def test_links_that_may_be_drawn_must_all_be_in_sight():
    """Of given starts: the tree that is drawn may hold any pair."""
    places = ((0.0, 0.0), (2.0, 0.0), (4.0, 0.0))
    for graph, far, near in (("path", True, True), (graphs.random_tree(), False, True)):
        for reach, granted in ((3.0, far), (5.0, near)):
            sensing = Sensing(range=reach)
            scenario = Scenario(n_robots=3, graph=graph, sensing=sensing, start_positions=places)
            assert certificate(scenario, by="links").guaranteed == granted


def test_steps_that_rounding_swallows_where_what_tanks_have_earned_has_carried_robots():
    """Two pairs of heavy links earn 5000 m²/s by meeting, with which the two that are left walk
    kilometres away from each other, along a light link.
    """
    weights = [(0, 1, 1e3), (1, 2, 1e-4), (2, 3, 1e3)]
    scenario = Scenario(
        n_robots=4, graph=graphs.from_edges(weights, 4), local_frames="global", time_step=1.0,
        start_positions=((-6.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (6.0, 1.0)), max_speed=1e3,
        allow_long_step=True,
    )  # fmt: skip
    env, simulator = alone(scenario, "tank", min_alignment=1e-5)
    simulator.set_max_steps(10**6)
    while simulator.active.sum() > 2:
        env.step([[[1e-4, 0.0], [-1e-4, 0.0], [1e-4, 0.0], [-1e-4, 0.0]]])
    for speed in (1.0, 0.1, 0.01):
        env.step([[[-speed, 0.0]] * 2 + [[speed, 0.0]] * 2])
        while env.tank.carried_out.any():
            env.step([[[-speed, 0.0]] * 2 + [[speed, 0.0]] * 2])
    away_from = simulator.positions[0, 3, 0]
    for side in (1.0, -1.0) * 20:
        env.step([[[0.0, side], [0.0, side], [0.0, -side], [0.0, -side]]])
    assert not env.tank.carried_out.any()
    assert simulator.positions[0, 3, 0] == away_from > 4e3
    found = certificate(scenario, 1e-5, by="tank")
    assert not found.guaranteed and "which rounding takes from" in found.theorem
    assert not certificate(scenario, 1e-3, by="tank").guaranteed
    assert certificate(scenario.replace(graph="path"), 1e-3, by="tank").guaranteed


@pytest.mark.parametrize(("told", "lengthened"), [(0.0, True), (0.7, False)])
def test_a_wrapper_bears_the_errors_that_it_is_told_of(told, lengthened):
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
        assert ("rad if the wrapper is told so" in words) == (by in ("heading", "tank", "links"))
        words = str(certificate(scenario, MARGINS[by], by=by))
        assert ("told bearing_error=0.7" in words) == (by in ("heading", "tank", "links"))
    turning = Scenario(robot_model="unicycle", sensing=Sensing(error=0.3))  # V, and no more
    for by in ("heading", "tank"):
        assert "all of this if the wrapper is told" in str(certificate(turning, 0.3, by=by))
