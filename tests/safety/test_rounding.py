"""What rounding of positions makes of V, the hull, the last of a tolerated error and steps that are
too short, and that certificates promise nothing there.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from alone import alone
from scipy.spatial.distance import pdist
from test_certificate import MARGINS

import baselines
from rendezvous_env import Scenario, Sensing, Simulator, certificate, graphs
from rendezvous_env.safety.theorems.theorem import CHOICES

FAR = 2.0**29  # m
ULP = float(np.spacing(FAR))
FIXED = {"local_frames": "global", "allow_long_step": True}


def ring(n):
    """Places (n, 2) on a circle, m."""
    angles = 0.3 + 2.0 * np.pi / n * np.arange(n)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def weighted(heavy, light):
    """Weights of four robots in a row: light ones next to each other."""
    apart = abs(np.subtract.outer(range(4), range(4)))
    return np.where(apart > 1, heavy, light) * (apart > 0)


SLOW_PAIR = Scenario(
    n_robots=2, graph=graphs.complete(4e-7), start_positions=((8.0, 8.0), (8.5, 8.0)),
    time_step=1e-9, time_limit=1e6,
)  # fmt: skip
"""They go 4e-16 m in a step."""
ROW = np.array([(x, 0.0) for x in (-3.0, -1.0, 1.0, 3.0)])
FAR_ROW = Scenario(n_robots=4, graph=weighted(1e3, 1e-9), start_positions=ROW + 1e3)
"""If each sees those next to it alone they go 3e-14 m in a step, at 1 km."""
NEAR_ROW = {"start_positions": ROW, "graph": weighted(1.0, 1e-6)}
MISLED_PAIR = Scenario(
    n_robots=2, graph=graphs.complete(2e-3), start_positions=((0.7, 0.7), (1.4, 0.7)),
    time_step=1e-9, sensing=Sensing(error=math.pi / 2.0 - 1e-5), **FIXED,
)  # fmt: skip
"""By nearly π/2: they come nearer by 2e-17 m in a step."""
TRIANGLE = Scenario(
    n_robots=3, graph=graphs.complete(1e-3), start_positions=ring(3), time_step=1e-8,
    sensing=Sensing(error=math.pi / 6.0 - 1e-6), **FIXED,
)  # fmt: skip
"""Cones of bearings that are widened by nearly π/6."""
ALMOST = math.pi / 8.0 * (1.0 - 1e-9)  # π/(2n) is too much
SQUARE = Scenario(n_robots=4, start_positions=ring(4), sensing=Sensing(error=ALMOST), **FIXED)
"""Cones, so widened, that leave a speed that float32 makes 0."""
TAKEN = "which rounding takes from"


@pytest.mark.parametrize(
    ("scenario", "by", "words", "better"),
    [
        *(
            (SLOW_PAIR, by, "none: a step may move robots by as little as .* of 8.5 m; it",
             {"time_step": 0.1})
            for by in CHOICES
        ),
        (FAR_ROW.replace(sensing=Sensing(occlusion="robots")), "law", TAKEN, NEAR_ROW),
        (FAR_ROW.replace(sensing=Sensing(range=3.0)), "links", TAKEN, NEAR_ROW),
        (MISLED_PAIR, "law", "the world or errors smaller", {"sensing": Sensing(error=1.5)}),
        (TRIANGLE, "links", TAKEN, {"time_step": 1e-3}),
        (SQUARE, "links", "tolerate less", {"sensing": Sensing(error=ALMOST - 1e-6)}),
    ],
)  # fmt: skip
def test_robots_that_come_no_nearer_are_promised_no_rendezvous(scenario, by, words, better):
    given = {"by": by, "share": 1.0} if by == "links" else {"by": by}
    if by == "links":
        env, simulator = alone(scenario, **given, bearing_error=scenario.sensing.error)
    else:
        law, simulator = baselines.make("bearing-only", scenario), Simulator(scenario)
        seen = simulator.reset(0)
    start = pdist(simulator.positions[0])
    for _ in range(20):
        if by == "links":
            env.step(np.zeros((1, scenario.n_robots, 2)))
        else:
            seen = simulator.step(law(seen, 0.0)).observations
    assert (pdist(simulator.positions[0]) >= start).all()  # and so for ever
    found = certificate(scenario, MARGINS[by], **given)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert re.search(words, found.theorem)
    exact = scenario.replace(sensing=replace(scenario.sensing, error=0.0))
    tolerated = certificate(exact, MARGINS[by], **given).tolerated_bearing_error
    assert found.tolerated_bearing_error == tolerated
    assert certificate(scenario.replace(**better), MARGINS[by], **given).guaranteed


def _farthest(place, other, step):
    """The heading of law (4) along which rounding leads a robot farthest from another one."""
    towards = (other - place) / np.linalg.norm(other - place)
    angle = math.atan2(towards[1], towards[0]) + np.linspace(-1.55, 1.55, 2001)
    headings = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    moved = place + step * (headings @ towards)[:, None] * headings
    return headings[np.argmax(np.linalg.norm(moved - other, axis=-1))]


def test_v_rises_under_headings_where_rounding_turns_steps():
    places = FAR + 60.0 * ULP * np.array([[0.0, 0.0], [-0.616, 0.788]])
    near = {"n_robots": 2, "merge_radius": 16.0 * ULP, "time_limit": 1e-3, **FIXED}
    scenario = Scenario(**near, start_positions=places)
    env, simulator = alone(scenario, "heading", min_alignment=0.01, max_turn_rate=1e9)
    start = simulator.lyapunov()[0]
    for _ in range(40):
        one, other = simulator.positions[0]
        aims = [_farthest(*pair, scenario.tau) for pair in ((one, other), (other, one))]
        env.step(np.array([aims]))
    assert simulator.lyapunov()[0] > start + 2.0 * scenario.merge_radius  # more than r W
    assert not certificate(scenario, 0.01).promises
    assert "lyapunov" in certificate(scenario.replace(start_positions=places - FAR), 0.01).promises


@pytest.mark.parametrize("by", ["law", "gains"])
def test_the_hull_grows_where_rounding_turns_steps(by):
    """Robot 0 goes to robot 1, which it sees at 22.5°, along the x axis."""
    far, angle = 2000.0 * ULP, math.pi / 8.0
    places = [[0.0, 0.0], [far * math.cos(angle), far * math.sin(angle)], [-20.0 * ULP] * 2]
    speed = 0.98 * ULP / 1e-7
    scenario = Scenario(
        n_robots=3, start_positions=FAR + np.array(places), merge_radius=16.0 * ULP, **FIXED,
        graph=graphs.directed([(0, 1, speed), (1, 0, 1e-3 * speed), (2, 1, 1e-3 * speed)]),
        time_step=1e-7, time_limit=1e-3,
    )  # fmt: skip
    simulator = Simulator(scenario)
    seen, size = simulator.reset(0), simulator.size()[0]
    for _ in range(1000):
        f = scenario.observation_layout.net_bearing(seen)
        seen = simulator.step(f.astype(np.float32)).observations
    assert simulator.size()[0] > 1.003 * size
    given = {"min_gain": 1e-3 * speed, "max_gain": speed} if by == "gains" else {}
    assert "hull" not in certificate(scenario, by=by, **given).promises
    alone(scenario, "gains", min_gain=1e-3 * speed, max_gain=speed)  # which can do the same
    near = {"start_positions": [[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]], "merge_radius": 0.1}
    assert "hull" in certificate(scenario.replace(**near), by=by, **given).promises


def test_the_last_of_an_error_that_tanks_tolerate_is_no_use_at_a_small_margin():
    """Two abreast whose wrapper allows for nearly ε: they go 5e-8 of a metre across f, at 1 km."""
    start = {"n_robots": 2, "start_positions": ((1e3, 1e3), (1001.0, 1e3)), **FIXED}
    exact = Scenario(**start, graph="path", time_limit=1e5)
    error = 0.995 * certificate(exact, 1e-4, by="tank").tolerated_bearing_error
    scenario = exact.replace(sensing=Sensing(error=error))
    env, simulator = alone(scenario, "tank", min_alignment=1e-4, bearing_error=error)
    for _ in range(50):
        env.step([[[0.0, 1.0], [0.0, -1.0]]])
    places = simulator.positions[0]
    assert (places[:, 0] == (1e3, 1001.0)).all() and np.linalg.norm(places[1] - places[0]) >= 1.0
    for by in ("tank", "heading"):
        found = certificate(scenario, 1e-4, by=by)
        assert not found.guaranteed and (found.tolerated_bearing_error > error) == (by == "tank")
        assert math.isfinite(found.lyapunov_bound) and certificate(exact, 1e-4, by=by).guaranteed
    assert "the world or errors smaller" in certificate(scenario, 1e-4, by="tank").theorem


def test_links_that_walk_far_aside_on_the_smallest_share_stay_there():
    """Two robots on a diagonal, wanted nearly across their link, which a step of r/4 c along it and
    c² nearer hardly shortens: 4 km aside they still see each other as they did, and law (b) moves
    them by 10⁻¹² m, which is lost.
    """
    half, aside = 0.975 / math.sqrt(2.0) * np.ones(2), np.array([-1.0, 1.0]) / math.sqrt(2.0)
    scenario = Scenario(
        n_robots=2, graph=graphs.complete(6.35e-6), merge_radius=1.0, time_step=0.1, max_speed=1.0,
        start_positions=(-half, half), time_limit=1e6, **FIXED,
    )  # fmt: skip
    env, simulator = alone(scenario, "links", share=1e-6, decision_period=1000)
    steep, ahead = 8e-5, half / 0.975
    env.step(5.0 * steep * (aside + steep * np.array([[ahead, -ahead]])))
    after = simulator.positions[0]
    walked = (after.mean(axis=0) @ aside) / (1.95 - np.linalg.norm(after[1] - after[0]))
    assert walked * 0.95 > 5.8e3  # before they are nearer than r
    state = env.get_state()
    state["env"]["positions"] = state["env"]["positions"] + 5.8e3 * aside
    env.set_state(state)
    before = simulator.positions[0]
    env.step(np.zeros((1, 2, 2)))
    assert (simulator.positions[0] == before).all()
    found = certificate(scenario, by="links", share=1e-6)
    assert not found.guaranteed and "which rounding takes from" in found.theorem
    assert certificate(scenario, by="links", share=1e-2).guaranteed


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
    levels, places = env.tank.levels, simulator.positions
    for side in (1.0, -1.0):
        env.step([[[0.0, side], [0.0, -side]]])
    assert not env.tank.carried_out.any() and (env.tank.levels == levels).all()
    assert (simulator.positions == places).all()  # and so for ever


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
