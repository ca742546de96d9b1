"""Custom robot models in files outside the package, and their compiled code."""

import dataclasses
import importlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import started
from scipy.integrate import solve_ivp
from test_double_integrator import FAR
from test_kernel_cache import python

import rendezvous_env as rv
from rendezvous_env.compilation import compiled
from rendezvous_env.engine.memory import RUNNING
from rendezvous_env.robots import robot_models
from train.compare import Job, play_job
from train.recording import with_observations

HOVER = '''"""A hovering robot: its velocity, a wind that carries it along, and two gusts."""

import math
from typing import NamedTuple

import rendezvous_env as rv

WIND = 0.5


class Hover(NamedTuple):
    duration: float
    speed_limit: float


@rv.kernel
def propose(model, action, frame, memory):
    x = model.duration * (frame[0] * action[0] + frame[1] * action[1] + WIND)
    y = model.duration * (frame[2] * action[0] + frame[3] * action[1])
    if 0.3 < action[0] < 0.3001:
        x = math.nan
    if 0.2 < action[0] < 0.2001:
        x = 50.0
    return (x, y), (x * x + y * y) ** 0.5


rv.describe_motion(Hover, rv.Motion(propose))
rv.register_robot_model(
    rv.RobotModel(
        "hover",
        dims=(2,),
        constants=lambda scenario: Hover(scenario.tau, 2 * scenario.speed_limit + WIND),
        bounds=lambda scenario: [scenario.speed_limit] * 2,
    )
)
'''
SLUGGISH = '''"""A unicycle whose speed lags behind the one asked for; it keeps (θ, speed)."""

import cmath
import math
from typing import NamedTuple

import rendezvous_env as rv


class Sluggish(NamedTuple):
    duration: float
    speed_limit: float
    turn_limit: float
    lag: float


@rv.kernel
def clip(value, limit):
    return min(max(value, -limit), limit)


@rv.kernel
def displacement_at(model, action, frame, memory, time):
    """∫ s(t) exp(i(θ + ωt)) dt with s(t) = v + (s₀ − v) exp(−t/T)."""
    v, w = clip(action[0], model.speed_limit), clip(action[1], model.turn_limit)
    heading = cmath.exp(1j * memory[0])
    turn = 1j * w * time
    steady = time * (1.0 if abs(w * time) < 1e-9 else (cmath.exp(turn) - 1.0) / turn)
    rate = 1j * w - 1.0 / model.lag
    way = heading * (v * steady + (memory[1] - v) * (cmath.exp(rate * time) - 1.0) / rate)
    return way.real, way.imag


@rv.kernel
def propose(model, action, frame, memory):
    fastest = max(abs(memory[1]), abs(clip(action[0], model.speed_limit)))
    return displacement_at(model, action, frame, memory, model.duration), fastest * model.duration


@rv.kernel
def chord_error_bound(model, action, memory):
    return model.speed_limit * (model.turn_limit + 2.0 / model.lag) / 8.0


@rv.kernel
def update(model, action, frame, memory, displacement, contact):
    v, w = clip(action[0], model.speed_limit), clip(action[1], model.turn_limit)
    speed = v + (memory[1] - v) * math.exp(-model.duration / model.lag)
    return memory[0] + w * model.duration, 0.0 if contact else speed


@rv.kernel
def body(model, frame, memory):
    c, s = math.cos(memory[0]), math.sin(memory[0])
    return c, -s, s, c


@rv.kernel
def own_speed(model, frame, memory):
    return memory[1], 0.0


@rv.kernel
def init(model, key, counter):
    return 0.25, 0.0


motion = rv.Motion(
    propose, displacement_at, chord_error_bound, update, body, own_speed, init
)
rv.describe_motion(Sluggish, motion)
rv.register_robot_model(
    rv.RobotModel(
        "sluggish",
        dims=(2,),
        constants=lambda s: Sluggish(s.tau, s.speed_limit, s.turn_limit, 0.3),
        bounds=lambda s: [s.speed_limit, s.turn_limit],
        n_angles=1,
        n_kept=lambda dim: 2,
        senses="velocity",
        action="v, ω: m/s, rad/s",
    )
)
'''


@pytest.fixture
def own(tmp_path, monkeypatch, registry):
    """Import a module from a text in a new folder."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []

    def load(name: str, text: str):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        made.append(name)
        return importlib.import_module(name)

    yield load
    for name in made:
        sys.modules.pop(name, None)


def test_custom_drifting_model_moves(own):
    own("own_hover", HOVER)
    scenario = rv.Scenario(n_robots=3, robot_model="hover", time_limit=20.0)
    start = {"positions": [[0.0, 0.0], [1.0, 0.0], [0.0, 4.0]]}
    follow = lambda seen, time: seen[..., :2, :].sum(axis=-2)  # noqa: E731
    assert rv.rollout(scenario, follow, options=start, num_envs=2).success.all()
    assert "no theorem covers hover robots" in rv.certificate(scenario).theorem
    with pytest.raises(ValueError, match="scenario has hover robots"):
        rv.HeadingVectorWrapper(rv.parallel_env(scenario))

    near, far = [[0.0, 0], [0.1, 0], [0.05, 0.1]], [[0.0, 0], [0.1, 0], [5.0, 0]]
    sim = started(scenario, 2, positions=[near, far])
    sim.step(np.zeros((2, 3, 2)))
    assert sim.ended.tolist() == [True, False] and sim.active[1].tolist() == [True, False, True]
    before = sim.get_state()["positions"]
    sim.step(np.zeros((2, 3, 2)))  # finished teams and merged robots rest in the wind
    moved = sim.get_state()["positions"] - before
    expected = np.zeros((2, 3, 2))
    expected[1, [0, 2], 0] = 0.5 * scenario.tau
    np.testing.assert_allclose(moved, expected, atol=1e-15)


def test_model_is_validated_once_not_per_step(own, monkeypatch):
    own("own_hover", HOVER)
    sim = started(rv.Scenario(n_robots=3, robot_model="hover"), 2)
    monkeypatch.setattr(robot_models, "try_equations", None)
    assert (sim.step(np.zeros((2, 3, 2))).status == RUNNING).all()


def test_leap_beyond_bound_raises_in_step(own):
    own("own_hover", HOVER)
    for leap in (0.30005, 0.20005, 12.0):  # the last is beyond the bounds
        teams = started(rv.Scenario(robot_model="hover", n_robots=3), 2)
        actions = np.zeros((2, 3, 2), np.float32)
        teams.step(actions)
        actions[1, 2, 0] = leap
        told = r"'hover' moved robot 2 of environment 1 by .* m in a"
        with pytest.raises(RuntimeError, match=told):
            teams.step(actions)
        with pytest.raises(RuntimeError, match="reset"):
            teams.step(actions)


@pytest.mark.slow
def test_fast_drift_accepts_own_state(registry):
    still = robot_models.ROBOT_MODELS["double_integrator"]

    def carried(scenario):
        return still.constants(scenario)._replace(speed_limit=scenario.speed_limit + 0.8)

    rv.register_robot_model(dataclasses.replace(still, name="boat", constants=carried))
    scenario = rv.Scenario(n_robots=3, robot_model="boat", obstacles=(FAR[2],))
    env = rv.make_vec(scenario.replace(local_frames="global"), 2)
    env.reset(seed=0)
    for _ in range(30):
        seen, *_ = env.step(env.action_space.high)
        assert env.observation_space.contains(seen)
    state = env.get_state()
    assert np.linalg.norm(state["memory"], axis=-1).max() > 2.5
    env.set_state(state)
    state["memory"][1, 2] = 3.0
    with pytest.raises(ValueError, match=r"memory\[1, 2\] is .* at most 2.8 m/s"):
        env.set_state(state)


@pytest.mark.slow
def test_custom_unicycle_follows_equations(own):
    own("own_sluggish", SLUGGISH)
    disc = rv.Disc((13.0, 0.0), 10.0)
    scenario = rv.Scenario(n_robots=2, robot_model="sluggish", obstacles=(disc,), time_step=0.1)
    sim = started(scenario, positions=[[0.0, 0.0], [-9.0, 0.0]])
    np.testing.assert_array_equal(sim.headings[0], 0.25)
    limit, turn = scenario.speed_limit, scenario.turn_limit
    state, random = np.array([0.0, 0.0, 0.25, 0.0]), np.random.default_rng(1)
    for _ in range(15):
        v, w = random.uniform((-limit, -turn), (limit, turn)).astype(np.float32)
        seen = sim.step([[(v, w), (0.0, 0.0)]]).observations
        rates = lambda t, y, v=v, w=w: (  # noqa: E731
            y[3] * math.cos(y[2]),
            y[3] * math.sin(y[2]),
            w,
            (v - y[3]) / 0.3,
        )
        state = solve_ivp(rates, (0, 0.1), state, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(sim.positions[0, 0], state[:2], atol=1e-8)
        np.testing.assert_allclose(sim.get_state()["memory"][0, 0], state[2:], atol=1e-8)
        np.testing.assert_allclose(seen[0, 0, -1], (state[3], 0.0), atol=1e-6)
    for _ in range(80):  # and no further than the disc
        touches = sim.step([[(limit, 0.0), (0.0, 0.0)]]).contact[0, 0]
        assert math.dist(sim.positions[0, 0], disc.centre) >= disc.radius - 1e-9
    assert touches
    sim.reset(0, {"positions": [[0.0, 0.0], [-9.0, 0.0]], "headings": [0.5, 1.0]})
    np.testing.assert_array_equal(sim.get_state()["memory"][0], [[0.5, 0.0], [1.0, 0.0]])
    # no recording has its speed, by which what was seen could be found again
    (kept,) = play_job(Job(scenario, "random"), episodes=1, seed=0, keep=1).recordings.values()
    assert with_observations(kept, scenario) is kept


PIECE = """
import own_hover
from rendezvous_env.obstacles.contact import place_on
curve = own_hover.Hover(0.1, 9.0), (0.0, 0.0), (1.0, 0.0, 0.0, 1.0), ()
print(place_on(curve, (0.0, 0.0, 0.0), 0.1)[0], sum(place_on.stats.cache_misses.values()))
"""
"""A small kernel of the package, in a file without model imports."""


def ran(folder: Path) -> tuple[float, int]:
    """Output of the code in a new process: a displacement, m, and newly compiled kernels."""
    way, anew = python(PIECE, folder).stdout.split()
    return float(way), int(anew)


@pytest.mark.slow
@pytest.mark.skipif(not compiled(), reason="nothing is kept")
def test_edited_model_is_recompiled(tmp_path):
    """Cached code must follow the file of the model, and the files that it imports."""
    text = HOVER.replace("WIND = 0.5\n", "from own_weather import WIND\n")
    (tmp_path / "own_hover.py").write_text(text, encoding="utf-8")
    for wind in (0.5, 0.25):
        (tmp_path / "own_weather.py").write_text(f"WIND = {wind}\n", encoding="utf-8")
        assert ran(tmp_path)[0] == pytest.approx(0.1 * wind)
    assert ran(tmp_path) == (pytest.approx(0.025), 0)  # what was not edited is kept
    path = tmp_path / "own_hover.py"
    path.write_text(text.replace("+ WIND)", "+ 2 * WIND)"))
    assert ran(tmp_path)[0] == pytest.approx(0.05)
