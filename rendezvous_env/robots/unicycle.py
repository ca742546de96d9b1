"""The unicycle: a planar robot that moves along its body axis and turns (eqs. 5–6).

    ẋ = v cos θ,  ẏ = v sin θ,  θ̇ = ω

Angles are in radians; the heading θ is the yaw of robots in 3-D.
"""

import math
from typing import NamedTuple

from ..compilation import kernel
from ..physics.random_streams import uniform
from ..physics.trigonometry import cos_sin
from .motion import Motion, describe, displacement_at
from .robot_models import RobotModel, register_robot_model


class Unicycle(NamedTuple):
    """ṗ = v (cos θ, sin θ), θ̇ = ω (eq. 5): the action is (v, ω), the memory (θ,)."""

    duration: float  # τ, s
    speed_limit: float  # of v, m/s
    turn_limit: float  # of ω, rad/s


@kernel(inline="code")
def mean_cos_sin(angle, swept):
    """Means of cos and sin over an angle that grows evenly from a by x, rad, of either sign.

    With S = sin(x)/x and C = (1 − cos x)/x they are (S cos a − C sin a, S sin a + C cos a); C is
    written as sin²(x/2)/(x/2), which loses no digits as x → 0.
    """
    return mean_direction(cos_sin(angle), swept)


@kernel(inline="code")
def mean_direction(heading, swept):
    """``mean_cos_sin`` from a pair (cos a, sin a)."""
    half = 0.5 * swept
    cos_half, sin_half = cos_sin(half)
    ratio = 1.0 if abs(half) < 1e-8 else sin_half / half
    mean_cos, mean_sin = ratio * cos_half, ratio * sin_half
    c, s = heading
    return mean_cos * c - mean_sin * s, mean_cos * s + mean_sin * c


@kernel(inline="code")
def arc_2d(speed, yaw, yaw_rate, duration):
    """Exact displacement (x, y), m, of a unicycle with held inputs, in the frame of its yaw.

        ẋ = v cos θ,  ẏ = v sin θ,  θ̇ = ω                         (eq. 5)

    The speed v, m/s, is negative backwards; yaw in rad, its rate in rad/s, duration in s.
    """
    return arc_along(cos_sin(yaw), speed, yaw_rate, duration)


@kernel(inline="code")
def arc_along(heading, speed, yaw_rate, duration):
    """``arc_2d`` from (cos θ, sin θ), two entries of the frame of a robot."""
    distance = speed * duration
    mean_cos, mean_sin = mean_direction(heading, yaw_rate * duration)
    return distance * mean_cos, distance * mean_sin


@kernel(inline="code")
def body_frame_2d(yaw):
    """R(θ), row by row, from the body frame (x = heading, y = left) to the global one; θ in rad."""
    c, s = cos_sin(yaw)
    return c, -s, s, c


@kernel
def clip(value, bound):
    """min(max(value, −bound), bound)."""
    return min(max(value, -bound), bound)


@kernel(inline="code")
def propose_along_axis(model, action, frame, memory):
    """``propose`` of a robot that moves along its body axis, with path length |v| τ."""
    way = abs(clip(action[0], model.speed_limit)) * model.duration
    return displacement_at(model, action, frame, memory, model.duration), way


@kernel(inline="code")
def _displacement_at(model, action, frame, memory, time):
    speed, turn_rate = clip(action[0], model.speed_limit), clip(action[1], model.turn_limit)
    return arc_along((frame[0], frame[2]), speed, turn_rate, time)


@kernel
def _chord_error_bound(model, action, memory):
    """|v| Ω/8, Ω the turn rate of the axis: the sagitta of a circular arc."""
    return abs(clip(action[0], model.speed_limit) * clip(action[1], model.turn_limit)) / 8.0


@kernel
def _period(model, action, memory):
    """2π/|ω|: a circle."""
    turn_rate = abs(clip(action[1], model.turn_limit))
    return 2.0 * math.pi / turn_rate if turn_rate > 0.0 else math.inf


@kernel(inline="code")
def _update(model, action, frame, memory, displacement, contact):
    return (memory[0] + clip(action[1], model.turn_limit) * model.duration,)


@kernel(inline="code")
def _frame(model, frame, memory):
    return body_frame_2d(memory[0])


@kernel
def _init(model, key, counter):
    return (math.pi * (2.0 * uniform(key, counter) - 1.0),)


describe(
    Unicycle,
    Motion(
        propose=propose_along_axis,
        displacement_at=_displacement_at,
        chord_error_bound=_chord_error_bound,
        update=_update,
        frame=_frame,
        init=_init,
        period=_period,
        drifts=False,
    ),
)
register_robot_model(
    RobotModel(
        "unicycle",
        dims=(2,),
        constants=lambda given: Unicycle(given.tau, given.speed_limit, given.turn_limit),
        bounds=lambda given: [given.speed_limit, given.turn_limit],
        n_angles=1,
        action="v, ω: m/s, rad/s",
        theorem="theorem 3",
    )
)
