"""Teams of single integrators and unicycles in the plane.

Each robot keeps an angle θ: the heading of a unicycle, or the constant rotation of the frame of a
single integrator. Actions have two components: a velocity, or a speed and a turn rate.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..physics.random_streams import uniform
from ..physics.vectors import dot, scaled, to_global
from .motion import Motion, describe
from .robot_models import RobotModel
from .single_integrator import speed_scale
from .unicycle import arc_along, body_frame_2d, clip

MEMBERS = ("single_integrator", "unicycle")
"""Robot models that a team can mix."""


class MixedTeam(NamedTuple):
    """ṗ = v, or ṗ = v (cos θ, sin θ) and θ̇ = ω, by robot; the memory is (θ,)."""

    duration: float  # τ, s
    speed_limit: float  # of ‖v‖ or v, m/s
    turn_limit: float  # of ω, rad/s
    turns: float  # 1 for a unicycle, 0 for a single integrator
    in_global_frame: float  # 1 if frames of single integrators are the global one, else 0


@kernel
def _propose(model, action, frame, memory):
    if model.turns > 0.0:
        way = abs(clip(action[0], model.speed_limit)) * model.duration
        return _displacement_at(model, action, frame, memory, model.duration), way
    speed, factor = speed_scale(dot(action, action), model.speed_limit)
    scale = model.duration * factor
    return scaled(to_global(frame, action), scale), speed * scale


@kernel
def _displacement_at(model, action, frame, memory, time):
    if model.turns > 0.0:
        speed = clip(action[0], model.speed_limit)
        turn_rate = clip(action[1], model.turn_limit)
        return arc_along((frame[0], frame[2]), speed, turn_rate, time)
    _, factor = speed_scale(dot(action, action), model.speed_limit)
    return scaled(to_global(frame, action), time * factor)


@kernel
def _chord_error_bound(model, action, memory):
    """|v| Ω/8 of a circular arc, or 0 of a straight path."""
    turn_rate = model.turns * clip(action[1], model.turn_limit)
    return abs(clip(action[0], model.speed_limit) * turn_rate) / 8.0


@kernel
def _period(model, action, memory):
    turn_rate = model.turns * abs(clip(action[1], model.turn_limit))
    return 2.0 * math.pi / turn_rate if turn_rate > 0.0 else math.inf


@kernel
def _update(model, action, frame, memory, displacement, contact):
    if model.turns > 0.0:
        return (memory[0] + clip(action[1], model.turn_limit) * model.duration,)
    return memory


@kernel
def _frame(model, frame, memory):
    if model.turns > 0.0:
        return body_frame_2d(memory[0])
    return frame


@kernel
def _init(model, key, counter):
    angle = math.pi * (2.0 * uniform(key, counter) - 1.0)
    return (0.0 if model.in_global_frame > model.turns else angle,)


def _constants(scenario: Any, robot_model: str = "unicycle") -> MixedTeam:
    return MixedTeam(
        scenario.tau,
        scenario.speed_limit,
        scenario.turn_limit,
        float(robot_model == "unicycle"),
        float(scenario.local_frames == "global"),
    )


def mixed_limits(scenario: Any) -> NDArray[np.float64]:
    """Constants of each robot of a mixed team, (n, constants), as ``limits_of``."""
    rows = [_constants(scenario, name) for name in scenario.robot_model]
    table = np.array(rows, dtype=np.float64)
    for column, name in ((1, "speed_limit"), (2, "turn_limit")):
        table[:, column] = [
            getattr(scenario.of_robot(robot), name) for robot in range(scenario.n_robots)
        ]
    return table


describe(
    MixedTeam,
    Motion(
        propose=_propose,
        displacement_at=_displacement_at,
        chord_error_bound=_chord_error_bound,
        update=_update,
        frame=_frame,
        init=_init,
        period=_period,
        drifts=False,
    ),
)
MIXED = RobotModel(
    "mixed",
    dims=(2,),
    constants=_constants,
    bounds=lambda scenario: [scenario.speed_limit, scenario.turn_limit],
    n_angles=1,
    action="a velocity, or v and ω: m/s, rad/s",
)
"""Robot model of teams of several models."""
