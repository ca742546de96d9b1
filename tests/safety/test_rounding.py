"""Rounding of positions: its effect on V and the hull, and withheld certificates.

The cases are positions far from the origin, bearing errors near the tolerance, and very short
steps.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from test_certificate import MARGINS, alone

import baselines
from rendezvous_env import Scenario, Sensing, Simulator, certificate, graphs
from rendezvous_env.safety.theorems.theorem import CHOICES

FAR = 2.0**29  # m
ULP = float(np.spacing(FAR))
FIXED = {"local_frames": "global", "allow_long_step": True}


def ring(n):
    """Positions (n, 2) on a circle, m."""
    angles = 0.3 + 2.0 * np.pi / n * np.arange(n)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


APART = abs(np.subtract.outer(range(4), range(4)))
ROW = np.array([(x, 0.0) for x in (-3.0, -1.0, 1.0, 3.0)])
FAR_ROW = Scenario(
    n_robots=4, graph=np.choose(APART, (0, 1e-9, 1e3, 1e3)), start_positions=ROW + 1e3
)
"""A robot with only adjacent neighbours moves 3e-14 m in a step, at 1 km."""
NEAR_ROW = {"start_positions": ROW, "graph": np.choose(APART, (0, 1e-6, 1, 1))}
PAIR = Scenario(n_robots=2, start_positions=((0.0, 0.0), (1.0, 0.0)), max_speed=1.0, **FIXED)
SLOW_PAIR = PAIR.replace(
    start_positions=((8.0, 8.0), (8.5, 8.0)), max_speed=None, time_step=1e-9,
    graph=graphs.complete(4e-7),
)  # fmt: skip
"""Robots move 4e-16 m in a step."""
AT_1_KM = Scenario(n_robots=2, start_positions=((1e3, 1e3), (1001.0, 1e3)), graph="path")
BORNE = Sensing(error=0.995 * certificate(AT_1_KM, 1e-4, by="tank").tolerated_bearing_error)
TWO_PAIRS = Scenario(
    n_robots=4, start_positions=((-6.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (6.0, 1.0)), **FIXED,
    graph=graphs.from_edges([(0, 1, 1e3), (1, 2, 1e-4), (2, 3, 1e3)], 4), max_speed=1e3,
    time_step=1.0,
)  # fmt: skip
ALMOST = math.pi / 8.0 * (1.0 - 1e-9)
UNICYCLES = Scenario(n_robots=2, robot_model="unicycle", start_positions=((1.0, 1.0), (2.0, 1.0)))
TAKEN = "none: .* below the rounding error of"
SMALLER = "the world or errors smaller"


@pytest.mark.parametrize(
    ("scenario", "given", "words", "better"),
    [
        *((SLOW_PAIR, {"by": by, "min_alignment": MARGINS[by]},
           "none: a step may move robots by as little as .* of 8.5 m; it", {"time_step": 0.1})
          for by in CHOICES),
        (FAR_ROW.replace(sensing=Sensing(occlusion="robots")), {"by": "law"}, TAKEN, NEAR_ROW),
        (FAR_ROW.replace(sensing=Sensing(range=3.0)), {"by": "links"}, TAKEN, NEAR_ROW),
        # of two that are misled by nearly π/2: 2e-17 m nearer in a step
        (PAIR.replace(graph=graphs.complete(2e-3), max_speed=None, time_step=1e-9,
                      sensing=Sensing(error=math.pi / 2.0 - 1e-5)),
         {"by": "law"}, SMALLER, {"sensing": Sensing(error=1.2)}),
        # cones of bearings that are widened by nearly π/(2n)
        (Scenario(n_robots=3, graph=graphs.complete(1e-3), start_positions=ring(3), time_step=1e-8,
                  sensing=Sensing(error=math.pi / 6.0 - 1e-6)),
         {"by": "links"}, TAKEN, {"time_step": 1e-1}),
        (Scenario(n_robots=4, start_positions=ring(4), sensing=Sensing(error=ALMOST)),
         {"by": "links", "share": 1.0}, "tolerate less", {"sensing": Sensing(error=ALMOST - 1e-6)}),
        # turns of 1e-16 rad in a step, and steps of robots that turn
        (UNICYCLES.replace(time_step=1e-7, max_turn_rate=1e-9), {"min_alignment": 0.3},
         "below the rounding error of their angles", {"max_turn_rate": None}),
        (UNICYCLES.replace(time_step=1e-7, graph=graphs.complete(1e-6)), {"min_alignment": 0.3},
         TAKEN, {"graph": "complete"}),
        # 2⁻⁵⁹ of 5 m
        (Scenario(graph=graphs.complete(1e-3), time_step=1e-2), {"min_alignment": 1e-6}, TAKEN,
         {"min_alignment": 1e-2}),
        # a thousand times slower than a* in a step that is a thousand times too long for the hub
        (Scenario(n_robots=3, graph=[[0, 1e3, 1], [1e3, 0, 1], [1, 1, 0]], time_step=0.1,
                  start_positions=1e8 + ring(3), **FIXED),
         {"min_alignment": 0.1}, TAKEN, {"graph": "complete"}),
        # a tank has carried them where law (4) moves them by 1e-7 m, nearly across f
        (PAIR.replace(graph=graphs.complete(1e-9)),
         {"by": "tank", "budget": 1e9, "min_alignment": 1e-6}, TAKEN,
         {"budget": 0.0, "min_alignment": 1e-4}),
        # a small margin has led them 1.4 km aside, where they come 1e-13 m nearer in a step
        *((PAIR.replace(start_positions=((0.0, 0.0), (0.7, -0.7)), graph=graphs.complete(1e-3)),
           {"by": by, "budget": budget, "min_alignment": 1e-6}, TAKEN, {"min_alignment": 1e-3})
          for by, budget in (("tank", 0.4), ("heading", 0.0))),
        # their tanks allow for errors of nearly ε: 5e-8 m in a step, across f
        (AT_1_KM.replace(sensing=BORNE), {"by": "tank", "min_alignment": 1e-4}, SMALLER,
         {"sensing": Sensing()}),
        (AT_1_KM.replace(sensing=BORNE), {"by": "heading", "min_alignment": 1e-4}, "tolerate less",
         {"sensing": Sensing()}),
        # two pairs earn 5000 m²/s by meeting, and walk 4 km apart along a light link
        (TWO_PAIRS, {"by": "tank", "min_alignment": 1e-5}, TAKEN,
         {"graph": "path", "min_alignment": 1e-3}),
        (TWO_PAIRS, {"by": "tank", "min_alignment": 1e-3}, TAKEN, {"graph": "path"}),
        # two that walk nearly across their link, aside by 4 km before they are nearer than r
        (PAIR.replace(start_positions=0.69 * np.array([(-1, -1), (1, 1)]), merge_radius=1.0,
                      time_step=0.1, graph=graphs.complete(6.35e-6)),
         {"by": "links", "share": 1e-6}, TAKEN, {"share": 1e-2}),
    ],
)  # fmt: skip
def test_no_certificate_for_steps_below_rounding(scenario, given, words, better):
    """All of these rest, or move sideways, for ever."""
    found = certificate(scenario, **given)
    assert not found.guaranteed and math.isinf(found.time_bound)
    assert re.search(words, found.theorem)
    exact = scenario.replace(sensing=replace(scenario.sensing, error=0.0))
    tolerated = certificate(exact, **given).tolerated_bearing_error
    assert found.tolerated_bearing_error == tolerated
    asked = {name: better.get(name, value) for name, value in given.items()}
    fields = {name: value for name, value in better.items() if name not in given}
    assert certificate(scenario.replace(**fields), **asked).guaranteed


def test_slow_pair_stays_in_place():
    simulator, law = Simulator(SLOW_PAIR), baselines.make("bearing-only", SLOW_PAIR)
    simulator.step(law(simulator.reset(0), 0.0))
    assert (simulator.positions[0] == SLOW_PAIR.start_positions).all()


def _farthest(place, other, step):
    """Heading of law (4) for which rounding increases the distance to another robot most."""
    towards = (other - place) / np.linalg.norm(other - place)
    angle = math.atan2(towards[1], towards[0]) + np.linspace(-1.55, 1.55, 2001)
    headings = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    moved = place + step * (headings @ towards)[:, None] * headings
    return headings[np.argmax(np.linalg.norm(moved - other, axis=-1))]


def test_rounding_raises_v_under_headings():
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
def test_rounding_grows_hull(by):
    """Robot 0 moves towards robot 1, at a bearing of 22.5°, along the x axis."""
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


def test_rounding_fills_tanks():
    """At 1000 km, steps of 5·10⁻¹¹ m towards each other are credited without motion."""
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
    assert not found.promises and "rounding error" in found.theorem


@pytest.mark.parametrize("granted", [False, True])
def test_rounding_is_small_relative_to_tank_gain(granted):
    """Two robots far out on a diagonal use all their energy.

    Steps towards each other by the last bit of their coordinates are credited without motion.
    """
    margin, far = 2.0**-12, 2.0**20
    radius = 2.2 * (2.0**-46 if granted else 2.0**-52) * far / margin**2
    places = far + np.array([[0.0, 0.0], [2.0 * radius, 2.0 * radius]])
    scenario = Scenario(
        n_robots=2, start_positions=places, merge_radius=radius, time_limit=1e4, **FIXED
    )
    assert certificate(scenario, margin, by="tank").guaranteed == granted
    env, simulator = alone(scenario, "tank", min_alignment=margin, decision_period=1000)
    start, choice = simulator.lyapunov()[0], 0.501 * margin**2 / math.sqrt(2.0)
    for _ in range(20):
        *_, infos = env.step([[[choice, choice], [-choice, -choice]]])
        assert infos["carried_out"].all()
    promised = 20_000 * 2.0 * margin**2 * scenario.tau
    fallen = start - simulator.lyapunov()[0]
    assert (1.0 - 2.0**-5) * promised <= fallen < 1.01 * promised if granted else fallen == 0.0


def test_rounding_fills_tanks_of_unicycles():
    """Nonholonomic tanks without minimum alignment.

    Two facing robots at 1000 km are credited for steps of half the last bit of their coordinates,
    and use the energy to separate.
    """
    places = 2.0**20 + 4.5e-6 * np.array([[0.0, 0.0], [1.0, 1.0]])
    scenario = Scenario(
        n_robots=2, robot_model="unicycle", start_positions=places, merge_radius=3e-6,
        start_headings=[[0.25 * math.pi], [1.25 * math.pi]], time_limit=0.1,
    )  # fmt: skip
    given = {"by": "tank", "min_alignment": 0.9}
    near = certificate(scenario.replace(start_positions=places - 2.0**20), **given)
    assert not certificate(scenario, **given).promises and "V bounded" in near.theorem
    assert "V bounded" not in certificate(scenario, **given).theorem
    env, simulator = alone(scenario, "tank", min_alignment=0.9, decision_period=10_000)
    share = 0.69 * np.spacing(2.0**20) / scenario.tau
    for _ in range(4):
        env.step([[[share, 0.0], [share, 0.0]]])
    assert (simulator.positions[0] == scenario.start_positions).all()
    env.decision_period = 2
    env.step([[[-1.0, 0.0], [-1.0, 0.0]]])
    assert simulator.lyapunov()[0] > 1.1 * near.promises["lyapunov"]
