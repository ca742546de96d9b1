"""The 3-D nonholonomic robot, which moves along its body axis (eqs. 9–10).

    ẋ = v cos β cos α,  ẏ = v cos β sin α,  ż = v sin β,  α̇ = ω_α,  β̇ = ω_β

Angles are in radians: yaw α about the vertical, pitch β above the horizontal.
"""

import math
from typing import NamedTuple

from ..compilation import kernel
from ..physics.random_streams import uniform
from ..physics.trigonometry import cos_sin
from .motion import Motion, describe
from .robot_models import RobotModel, register_robot_model
from .unicycle import clip, mean_cos_sin, propose_along_axis

_LARGEST_START_PITCH = math.pi / 4


class Nonholonomic3D(NamedTuple):
    """Eq. (9): the action is (v, ω_α, ω_β), the memory (α, β)."""

    duration: float  # τ, s
    speed_limit: float  # of v, m/s
    yaw_limit: float  # of ω_α, rad/s
    pitch_limit: float  # of ω_β, rad/s


@kernel(inline="code")
def arc_3d(speed, yaw, pitch, yaw_rate, pitch_rate, duration):
    """Exact displacement (x, y, z), m, of a 3-D nonholonomic robot with held inputs.

        ẋ = v cos β cos α,  ẏ = v cos β sin α,  ż = v sin β,  α̇ = ω_α,  β̇ = ω_β     (eq. 9)

    The products of cosines are written as sums of cosines of α + β and α − β, which grow at
    constant rates. Speed v in m/s, yaw α and pitch β at the start in rad, rates in rad/s, duration
    in s.
    """
    distance = speed * duration
    cos_sum, sin_sum = mean_cos_sin(yaw + pitch, (yaw_rate + pitch_rate) * duration)
    cos_difference, sin_difference = mean_cos_sin(yaw - pitch, (yaw_rate - pitch_rate) * duration)
    _, mean_sin_pitch = mean_cos_sin(pitch, pitch_rate * duration)
    return (
        distance * 0.5 * (cos_sum + cos_difference),
        distance * 0.5 * (sin_sum + sin_difference),
        distance * mean_sin_pitch,
    )


@kernel(inline="code")
def body_frame_3d(yaw, pitch):
    """R = R_z(α) R_y(−β), row by row, from the body frame (x = heading h of eq. (9), y = horizontal
    left, z = up-ish) to the global one; yaw α and pitch β in rad.
    """
    ca, sa = cos_sin(yaw)
    cb, sb = cos_sin(pitch)
    return cb * ca, -sa, -sb * ca, cb * sa, ca, -sb * sa, sb, 0.0, cb


@kernel(inline="code")
def _displacement_at(model, action, frame, memory, time):
    return arc_3d(
        clip(action[0], model.speed_limit),
        memory[0],
        memory[1],
        clip(action[1], model.yaw_limit),
        clip(action[2], model.pitch_limit),
        time,
    )


@kernel
def _chord_error_bound(model, action, memory):
    yaw_rate = clip(action[1], model.yaw_limit)
    pitch_rate = clip(action[2], model.pitch_limit)
    turn_rate = math.sqrt(yaw_rate * yaw_rate + pitch_rate * pitch_rate)
    return abs(clip(action[0], model.speed_limit)) * turn_rate / 8.0


@kernel(inline="code")
def _update(model, action, frame, memory, displacement, contact):
    yaw_rate = clip(action[1], model.yaw_limit)
    pitch_rate = clip(action[2], model.pitch_limit)
    return memory[0] + yaw_rate * model.duration, memory[1] + pitch_rate * model.duration


@kernel(inline="code")
def _frame(model, frame, memory):
    return body_frame_3d(memory[0], memory[1])


@kernel(inline="code")
def _gravity(model, frame, memory):
    """Unit direction of gravity in the body frame, (−sin β, 0, −cos β)."""
    return -frame[6], 0.0, -frame[8]


@kernel
def _init(model, key, counter):
    """Uniform yaw, and pitch within 45° of the horizontal."""
    yaw = math.pi * (2.0 * uniform(key, counter) - 1.0)
    return yaw, _LARGEST_START_PITCH * (2.0 * uniform(key, counter + 1) - 1.0)


def _bounds(scenario):
    # law (17) divides ω_α by cos β; at its bound it saturates
    return [scenario.speed_limit, 10 * scenario.turn_limit, scenario.turn_limit]


describe(
    Nonholonomic3D,
    Motion(
        propose=propose_along_axis,
        displacement_at=_displacement_at,
        chord_error_bound=_chord_error_bound,
        update=_update,
        frame=_frame,
        sense=_gravity,
        init=_init,
        drifts=False,
    ),
)
register_robot_model(
    RobotModel(
        "nonholonomic_3d",
        dims=(3,),
        constants=lambda given: Nonholonomic3D(given.tau, *_bounds(given)),
        bounds=_bounds,
        n_angles=2,
        senses="gravity",
        action="v, ω_α, ω_β: m/s, rad/s, rad/s",
        theorem="theorem 4",
    )
)
