"""Robot models of the paper: one exact step each, with the inputs held.

The single integrator, the unicycle (eqs. 5–6) and the 3-D nonholonomic robot (eqs. 9–10).
"""

import math
from typing import NamedTuple

from ...compilation import inlined_entry, kernel
from ..random_streams import uniform
from ..vectors import scaled, square, to_global
from .arcs import arc_2d, arc_3d, body_frame_2d, body_frame_3d, clip
from .motion import Motion, describe

_LARGEST_START_PITCH = math.pi / 4


class SingleIntegrator(NamedTuple):
    """ṗ = v: the action is a velocity, m/s."""

    duration: float
    """τ, s."""
    speed_limit: float
    """v_max, m/s."""


class Unicycle(NamedTuple):
    """ṗ = v (cos θ, sin θ), θ̇ = ω (eq. 5): the action is (v, ω), the memory (θ,)."""

    duration: float
    """τ, s."""
    speed_limit: float
    """Of v, m/s."""
    turn_limit: float
    """Of ω, rad/s."""


class Nonholonomic3D(NamedTuple):
    """Eq. (9): the action is (v, ω_α, ω_β), the memory (α, β)."""

    duration: float
    """τ, s."""
    speed_limit: float
    """Of v, m/s."""
    yaw_limit: float
    """Of ω_α, rad/s."""
    pitch_limit: float
    """Of ω_β, rad/s."""


@inlined_entry
def speed_scale(square_speed, limit):
    """Speed ‖v‖, and the factor min(1, v_max/‖v‖) that limits it and keeps the direction.

    Args:
        square_speed: ‖v‖², m²/s².
        limit: v_max, m/s.

    Returns:
        Two numbers: ‖v‖, m/s, and the factor. Of accelerations likewise, in m/s².
    """
    speed = math.sqrt(square_speed)
    return speed, limit / speed if speed > limit else 1.0


@inlined_entry
def keep_frame(model, frame, memory):
    """A frame that never turns: R(t + τ) = R(t).

    Args:
        model: constants of a robot model, a NamedTuple.
        frame: R, local → global, row by row, 4 or 9 numbers without unit.
        memory: what the model keeps.

    Returns:
        R, as it was given.
    """
    return frame


@inlined_entry
def _propose_velocity(model, action, frame, memory):
    """τ R v, with ‖v‖ limited."""
    speed, factor = speed_scale(square(action), model.speed_limit)
    scale = model.duration * factor
    return scaled(to_global(frame, action), scale), speed * scale


@kernel
def _along_velocity(model, action, frame, memory, time):
    _, factor = speed_scale(square(action), model.speed_limit)
    return scaled(to_global(frame, action), time * factor)


@inlined_entry
def _straight(model, action, memory):
    return 0.0


@inlined_entry
def _nothing(model, action, frame, memory, displacement, contact):
    return memory


@inlined_entry
def _see_nothing(model, frame, memory):
    return ()


@kernel
def _propose_arc_2d(model, action, frame, memory):
    speed = clip(action[0], model.speed_limit)
    yaw_rate = clip(action[1], model.turn_limit)
    return arc_2d(speed, memory[0], yaw_rate, model.duration), abs(speed) * model.duration


@kernel
def _along_arc_2d(model, action, frame, memory, time):
    speed = clip(action[0], model.speed_limit)
    return arc_2d(speed, memory[0], clip(action[1], model.turn_limit), time)


@kernel
def _bend_2d(model, action, memory):
    """|v| Ω/8, Ω the turn rate of the axis: the sagitta of a circular arc."""
    return abs(clip(action[0], model.speed_limit) * clip(action[1], model.turn_limit)) / 8.0


@kernel
def _turn_2d(model, action, frame, memory, displacement, contact):
    return (memory[0] + clip(action[1], model.turn_limit) * model.duration,)


@kernel
def _body_frame_2d(model, frame, memory):
    return body_frame_2d(memory[0])


@kernel
def _propose_arc_3d(model, action, frame, memory):
    way = abs(clip(action[0], model.speed_limit)) * model.duration
    return _along_arc_3d(model, action, frame, memory, model.duration), way


@kernel
def _along_arc_3d(model, action, frame, memory, time):
    return arc_3d(
        clip(action[0], model.speed_limit),
        memory[0],
        memory[1],
        clip(action[1], model.yaw_limit),
        clip(action[2], model.pitch_limit),
        time,
    )


@kernel
def _bend_3d(model, action, memory):
    yaw_rate = clip(action[1], model.yaw_limit)
    pitch_rate = clip(action[2], model.pitch_limit)
    turn_rate = math.sqrt(yaw_rate * yaw_rate + pitch_rate * pitch_rate)
    return abs(clip(action[0], model.speed_limit)) * turn_rate / 8.0


@kernel
def _turn_3d(model, action, frame, memory, displacement, contact):
    yaw_rate = clip(action[1], model.yaw_limit)
    pitch_rate = clip(action[2], model.pitch_limit)
    return memory[0] + yaw_rate * model.duration, memory[1] + pitch_rate * model.duration


@kernel
def _body_frame_3d(model, frame, memory):
    return body_frame_3d(memory[0], memory[1])


@kernel
def _gravity(model, frame, memory):
    """Unit direction of gravity in the body frame, (−sin β, 0, −cos β)."""
    return -math.sin(memory[1]), 0.0, -math.cos(memory[1])


@kernel
def _begin_with_nothing(model, key, counter):
    return ()


@kernel
def _uniform_yaw(model, key, counter):
    return (math.pi * (2.0 * uniform(key, counter) - 1.0),)


@kernel
def _uniform_yaw_and_pitch(model, key, counter):
    """Pitch within 45° of the horizontal."""
    yaw = math.pi * (2.0 * uniform(key, counter) - 1.0)
    return yaw, _LARGEST_START_PITCH * (2.0 * uniform(key, counter + 1) - 1.0)


describe(
    SingleIntegrator,
    Motion(
        propose=_propose_velocity,
        along=_along_velocity,
        bend=_straight,
        remember=_nothing,
        frame=keep_frame,
        sense=_see_nothing,
        begin=_begin_with_nothing,
        drifts=False,
    ),
)
describe(
    Unicycle,
    Motion(
        propose=_propose_arc_2d,
        along=_along_arc_2d,
        bend=_bend_2d,
        remember=_turn_2d,
        frame=_body_frame_2d,
        sense=_see_nothing,
        begin=_uniform_yaw,
        drifts=False,
    ),
)
describe(
    Nonholonomic3D,
    Motion(
        propose=_propose_arc_3d,
        along=_along_arc_3d,
        bend=_bend_3d,
        remember=_turn_3d,
        frame=_body_frame_3d,
        sense=_gravity,
        begin=_uniform_yaw_and_pitch,
        drifts=False,
    ),
)
