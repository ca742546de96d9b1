"""What rounding of positions makes of V, the hull and the last of a tolerated error, and that
certificates promise nothing there.
"""

import math

import numpy as np
import pytest
from alone import alone

from rendezvous_env import Scenario, Sensing, Simulator, certificate, graphs

FAR = 2.0**29  # m
ULP = float(np.spacing(FAR))
FIXED = {"local_frames": "global", "allow_long_step": True}


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


def test_the_last_of_a_tolerated_error_is_no_use_to_steps_that_rounding_swallows():
    """Two robots misled by nearly π/2, and a triangle whose cones are widened by nearly π/6."""
    places = ((0.7, 0.7), (1.4, 0.7))
    pair = Scenario(
        n_robots=2, graph=graphs.complete(2e-3), start_positions=places, time_step=1e-9,
        sensing=Sensing(error=math.pi / 2.0 - 1e-5), **FIXED,
    )  # fmt: skip
    simulator = Simulator(pair)
    seen = simulator.reset(0)
    for _ in range(500):  # 2e-17 m nearer in each
        seen = simulator.step(pair.observation_layout.net_bearing(seen)).observations
    assert (simulator.positions[0, :, 0] == (0.7, 1.4)).all()
    found = certificate(pair)
    assert not found.guaranteed and "the world or errors smaller" in found.theorem
    exact = certificate(pair.replace(sensing=Sensing()))
    assert found.tolerated_bearing_error == exact.tolerated_bearing_error > pair.sensing.error
    assert certificate(pair.replace(sensing=Sensing(error=1.5))).guaranteed
    angles = 0.3 + 2.0 * np.pi / 3.0 * np.arange(3)
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    error = math.pi / 6.0 - 1e-6
    team = Scenario(
        n_robots=3, graph=graphs.complete(1e-3), start_positions=corners, time_step=1e-8,
        sensing=Sensing(error=error), **FIXED,
    )  # fmt: skip
    env, simulator = alone(team, "links", bearing_error=error)
    env.step(np.zeros((1, 3, 2)))
    assert (simulator.positions[0] == corners).all()
    assert not certificate(team, by="links").guaranteed
    assert certificate(team.replace(time_step=1e-3), by="links").guaranteed


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
