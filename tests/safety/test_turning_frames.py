"""Robots of a user's own whose frames turn: headings, tanks, late bearings."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env import vector
from rendezvous_env.robots.robot_models import ROBOT_MODELS


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
    """Four robots that turn by half a radian in every step."""
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
    return rv.Scenario(n_robots=4, robot_model="omni")


@pytest.mark.parametrize("by", ["heading", "tank"])
def test_robots_that_go_any_way_choose_directions_although_they_have_angles(team, by):
    """They were taken for robots that drive along an axis: speed and turn rate, and V rose."""
    assert rv.certificate(team, 0.3, by=by).guaranteed
    far = team.replace(sensing=rv.Sensing(range=1e6))  # the same, and a kind with the next test's
    env = vector.GuaranteeWrapper(rv.make_vec(far, num_envs=4), by, min_alignment=0.3)
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


def test_late_bearings_in_frames_that_turn_are_certified_nothing(team):
    """Each bearing is turned by 2.5 rad on the way: robots part, V is soon beyond E1's bound."""
    pair = team.replace(n_robots=2, spawn_size=2.0, sensing=rv.Sensing(delay=5))
    late = pair.replace(time_step=pair.certified_step / 6.0)
    found = rv.certificate(late)
    assert "frames of omni robots turn" in found.theorem and not found.promises
    assert rv.certificate(late.replace(robot_model="single_integrator")).guaranteed


def test_arcs_of_a_users_own_are_certified_nothing_but_their_law(registry):
    """Theorem 3 is true of them, of the gate nothing: their rates might count clockwise."""
    known = ROBOT_MODELS["unicycle"]
    rv.register_robot_model(
        replace(known, name="mirrored", constants=lambda given: known.constants(given))
    )
    mirrored = rv.Scenario(n_robots=3, robot_model="mirrored")
    assert rv.certificate(mirrored).continuous_time_only
    for by in ("heading", "tank"):
        found = rv.certificate(mirrored, 0.3, by=by)
        assert not found.promises and "no theorem covers mirrored robots" in found.theorem
