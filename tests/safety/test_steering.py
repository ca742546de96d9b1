"""HeadingFilter: V near obstacles for any raw vectors; frames, arcs, limits, custom robots."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from conftest import five
from parameters import marked

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator
from rendezvous_env.robots.robot_models import ROBOT_MODELS
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.trajectory import run
from train.verify.adversaries import Adversary
from train.verify.monitors import BatchMoment

TEAMS = 48
ROUNDING = 2.0**-20
"""Rounding of float32 rows and actions, relative to n D̄² τ."""
CLUTTERS = {
    "clutter-12": rv.scenarios.get("clutter-12"),
    "clutter-3d": rv.scenarios.get("clutter-3d"),
    "unicycle": rv.scenarios.get("clutter-12").replace(robot_model="unicycle"),
    "nonholonomic_3d": rv.scenarios.get("clutter-3d").replace(robot_model="nonholonomic_3d"),
}


@pytest.mark.parametrize("contact", ["stop", "slide"])
@pytest.mark.parametrize("name", marked(CLUTTERS, slow=[*CLUTTERS][1:]))
def test_v_never_increases_beside_obstacles_unless_sliding(name, contact):
    """A slide removes the inward part of h hᵀf and may leave motion that increases V.

    It occurs for any raw vectors. Certificates hold without obstacles, see test_promises.
    """
    scenario = CLUTTERS[name].replace(obstacle_contact=contact, time_limit=15.0)
    adversary = Adversary(scenario, TEAMS, "heading", np.random.default_rng(3), 3.0)
    steering, simulator = HeadingFilter(scenario, TEAMS, frame="local"), Simulator(scenario, TEAMS)

    def policy(seen, time):
        steering.hold(adversary(seen, BatchMoment(simulator)))
        return steering.apply(seen)

    most, contacts = scenario.tau * scenario.n_robots * scenario.max_degree**2, 0
    for step in run(simulator, policy, simulator.reset(3)):
        out, on = step.outcome, step.running
        rise = out.lyapunov_before_merge - step.lyapunov - ROUNDING * most - 1e-12 * step.lyapunov
        slides = on & out.contact.any(axis=-1) & (contact == "slide")
        assert (rise[on & ~slides] <= 0).all() and (rise[slides] <= most).all()
        contacts += int((on & out.contact.any(axis=-1)).sum())
    assert contacts > 100


def test_smaller_turn_limit_applies():
    slow = five("unicycle", max_turn_rate=0.5)
    for scenario, limit in ((slow, 0.5), (five("unicycle"), 3.0)):
        steering = HeadingFilter(scenario, 1, certified=False)
        observations = Simulator(scenario).reset(0)
        steering.hold(np.ones((1, 5, 1)))
        np.testing.assert_allclose(steering.apply(observations)[..., 1], limit, rtol=1e-6)


def test_headings_turn_at_most_by_limit():
    scenario = five("single_integrator-2d")
    steering = HeadingFilter(scenario, 1, max_turn_rate=1.0, frame="local")
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)[0]
    first = f / np.linalg.norm(f, axis=-1, keepdims=True)
    steering.hold(np.stack([-f[:, 1], f[:, 0]], axis=-1)[None])
    for k in range(1, 4):
        steering.apply(observations)
        cosines = np.sum(steering.headings[0] * first, axis=-1)
        np.testing.assert_allclose(np.arccos(cosines), k * scenario.tau * 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("table", "most"),
    [
        ([[0.6, 0.8, 0.0], [0.8, -0.8, 0.0]], 0),  # equal and opposite: the first row counts
        ([[0.8, -0.5, 0.0], [0.6, 0.8, 0.0], [0.1, -0.3, 0.0]], 1),
    ],
)
def test_second_axis_in_3d_is_numerically_stable(table, most):
    rows = len(table)
    scenario = Scenario(n_robots=rows + 1, dim=3, graph="complete")
    random = np.random.default_rng(0)
    axis = None
    for _ in range(200):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        seen = np.zeros((1, rows + 1, rows, 3), np.float32)
        seen[0, 0] = table @ turn.T
        view = HeadingFilter(scenario, 1).observe(seen)[0, 0]
        axis = view if axis is None else axis
        np.testing.assert_allclose(view, axis, atol=1e-6)
    np.testing.assert_allclose(axis[most], [0.6, 0.8, 0.0], atol=1e-6)


def test_bearing_error_reduces_speed():
    scenario = Scenario(n_robots=3)
    options = {"frame": "local", "min_alignment": 0.5}
    wary, sure = (HeadingFilter(scenario, 1, **options, bearing_error=e) for e in (0.3, 0.0))
    observations = Simulator(scenario).reset(0)
    f = scenario.observation_layout.net_bearing(observations)
    actions = []
    for steering in (wary, sure):
        steering.hold(f)
        actions.append(np.linalg.norm(steering.apply(observations), axis=-1))
    strength = np.linalg.norm(f, axis=-1)
    slower = np.maximum(strength - 2 * math.sin(0.15) * 2.0, 0.0)
    np.testing.assert_allclose(actions[0], slower, atol=1e-6)
    np.testing.assert_allclose(actions[1], strength, atol=1e-6)
    np.testing.assert_allclose(wary.lyapunov_rate, -2 * strength * slower, atol=1e-5)


class Omni(NamedTuple):
    duration: float
    speed_limit: float


@rv.kernel
def propose(model, action, frame, memory):
    speed = math.hypot(action[0], action[1])
    scale = model.duration * min(1.0, model.speed_limit / max(speed, 1e-300))
    x = scale * (frame[0] * action[0] + frame[1] * action[1])
    y = scale * (frame[2] * action[0] + frame[3] * action[1])
    return (x, y), math.hypot(x, y)


@rv.kernel
def update(model, action, frame, memory, displacement, contact):
    return (memory[0] + 0.5,)


@rv.kernel
def body_frame(model, frame, memory):
    c, s = math.cos(memory[0]), math.sin(memory[0])
    return c, -s, s, c


@rv.kernel
def init(model, key, counter):
    return (0.0,)


rv.describe_motion(Omni, rv.Motion(propose, update=update, frame=body_frame, init=init))


@pytest.fixture
def team(registry):
    """Four robots that rotate by half a radian in every step."""
    rv.register_robot_model(
        rv.RobotModel(
            "omni",
            dims=(2,),
            constants=lambda scenario: Omni(scenario.tau, scenario.speed_limit),
            bounds=lambda scenario: [scenario.speed_limit] * 2,
            n_angles=1,
            bounded=True,
        )
    )
    return Scenario(n_robots=4, robot_model="omni")


@pytest.mark.slow
@pytest.mark.parametrize("by", ["heading", "tank"])
def test_holonomic_custom_model_chooses_directions(team, by):
    """Formerly treated as robots with an axis: speed and turn rate, and V increased."""
    assert rv.certificate(team, 0.3, by=by).guaranteed
    far = team.replace(sensing=rv.Sensing(range=1e6))  # the same, and a kind with the next test's
    env = rv.vector.GuaranteeWrapper(rv.make_vec(far, num_envs=4), by, min_alignment=0.3)
    env.reset(seed=0)
    assert env.action_space.shape == (4, 4, 2)
    simulator, random = env.unwrapped.simulator, np.random.default_rng(0)
    for _ in range(30):
        before, left = simulator.lyapunov(), simulator.active.sum(axis=1)
        levels = env.tank.levels.sum(axis=1) if by == "tank" else 0.0
        env.step(random.uniform(-1.0, 1.0, env.action_space.shape))
        levels = env.tank.levels.sum(axis=1) - levels if by == "tank" else 0.0
        same = simulator.active.sum(axis=1) == left
        assert ((simulator.lyapunov() - before + levels)[same] < 1e-5).all()


def test_delay_in_rotating_frames_is_not_certified(team):
    """Each bearing rotates by 2.5 rad during the delay: V soon exceeds the bound of E1."""
    pair = team.replace(n_robots=2, spawn_size=2.0, sensing=rv.Sensing(delay=5))
    late = pair.replace(time_step=pair.certified_step / 6.0)
    found = rv.certificate(late)
    assert "frames of omni robots turn" in found.theorem and not found.promises
    assert rv.certificate(late.replace(robot_model="single_integrator")).guaranteed


def test_custom_arcs_are_certified_for_their_law_only(registry):
    """Theorem 3 holds for them, but not the gate: their rates might count clockwise."""
    known = ROBOT_MODELS["unicycle"]
    rv.register_robot_model(
        replace(known, name="mirrored", constants=lambda given: known.constants(given))
    )
    mirrored = Scenario(n_robots=3, robot_model="mirrored")
    assert rv.certificate(mirrored).continuous_time_only
    for by in ("heading", "tank"):
        found = rv.certificate(mirrored, 0.3, by=by)
        assert not found.promises and "no theorem covers mirrored robots" in found.theorem
