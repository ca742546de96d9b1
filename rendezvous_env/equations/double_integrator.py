"""A robot with inertia: its action is an acceleration, held over the step.

    p̈ = a,    ‖a‖ ≤ a_max,    ‖ṗ‖ ≤ v_max

An acceleration that would exceed the speed limit at the end of the step is replaced by the constant
one that reaches the limit in the same direction of motion; so the motion is exact for a held input,
and the speed never exceeds the limit within the step: ‖ṗ‖ is convex along it.
"""

import math
from typing import NamedTuple

from ..compilation import kernel
from .kinematics import keep_frame, speed_scale
from .motion import Motion, describe
from .vectors import scaled, square, to_global, to_local


class DoubleIntegrator(NamedTuple):
    """p̈ = a: the action is an acceleration, m/s², the memory the velocity in the global frame."""

    duration: float
    """τ, s."""
    speed_limit: float
    """v_max, m/s."""
    acceleration_limit: float
    """a_max, m/s²."""
    rest: tuple[float, ...]
    """The velocity at the start, d zeros."""


@kernel
def _plus(a, factor, b):
    """The pair or triple a + factor b."""
    if len(a) == 2:
        return a[0] + factor * b[0], a[1] + factor * b[1]
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@kernel
def final_velocity(model, action, frame, velocity):
    """V + τ R a with ‖a‖ and then the speed limited, direction kept; m/s, global frame."""
    _, factor = speed_scale(square(action), model.acceleration_limit)
    pushed = _plus(velocity, model.duration * factor, to_global(frame, action))
    _, factor = speed_scale(square(pushed), model.speed_limit)
    return scaled(pushed, factor)


@kernel
def _along(model, action, frame, memory, time):
    """V t + ½ a t², with a = (v(τ) − v)/τ."""
    change = _plus(final_velocity(model, action, frame, memory), -1.0, memory)
    half = 0.5 * time * time / model.duration
    return _plus(scaled(memory, time), half, change)


@kernel
def _propose(model, action, frame, memory):
    """The way is a parabola; its length is ∫‖v‖ dt by Simpson's rule."""
    after = final_velocity(model, action, frame, memory)
    middle = scaled(_plus(memory, 1.0, after), 0.5)
    speeds = math.sqrt(square(memory)) + 4.0 * math.sqrt(square(middle)) + math.sqrt(square(after))
    return scaled(middle, model.duration), model.duration * speeds / 6.0


@kernel
def _bend(model, action, memory):
    """a_max/8: a parabola is at most that far from its chord, per square of the time. The speed
    limit, a projection onto a ball, only lessens the change of velocity.
    """
    return model.acceleration_limit / 8.0


@kernel
def _remember(model, action, frame, memory, displacement, touched):
    """The final velocity; after a contact the mean one of what the obstacle left of the motion."""
    if touched:
        return scaled(displacement, 1.0 / model.duration)
    return final_velocity(model, action, frame, memory)


@kernel
def _own_velocity(model, frame, memory):
    """Its velocity in its own frame, m/s."""
    return to_local(frame, memory)


@kernel
def _begin_at_rest(model, key, counter):
    return model.rest


describe(
    DoubleIntegrator,
    Motion(
        propose=_propose,
        along=_along,
        bend=_bend,
        remember=_remember,
        frame=keep_frame,
        sense=_own_velocity,
        begin=_begin_at_rest,
    ),
)
