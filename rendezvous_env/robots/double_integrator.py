"""Double integrator: the action is an acceleration with zero-order hold.

    p̈ = a,    ‖a‖ ≤ a_max,    ‖ṗ‖ ≤ v_max

An acceleration that would exceed the speed limit in the step is replaced. The replacement is
constant and reaches the limit at the end of the step, in the same direction. The motion is exact
for a held input, and the speed stays within the limit, since ‖ṗ‖ is convex along the step.

A contact removes the normal component of the velocity without friction, or all of it with contact
mode "stop".
"""

import math
from typing import NamedTuple

from ..compilation import kernel
from ..physics.vectors import add, dot, norm, scaled, to_global, to_local
from .motion import FREE, STOPPED, Motion, describe
from .robot_models import RobotModel, register_robot_model
from .single_integrator import speed_scale

# relative change of velocity below which Simpson's rule gives the path length to rounding, while
# the closed form would lose digits
_NEARLY_STEADY = 1e-3


class DoubleIntegrator(NamedTuple):
    """p̈ = a: the action is an acceleration, m/s²; the memory is the velocity, global frame."""

    duration: float  # τ, s
    speed_limit: float  # v_max, m/s
    acceleration_limit: float  # a_max, m/s²
    rest: tuple[float, ...]  # the velocity at the start, d zeros


@kernel
def final_velocity(model, action, frame, velocity):
    """Velocity at the end of a step in the global frame, m/s.

    v + τ R a, with ‖a‖ ≤ a_max and then ‖v‖ ≤ v_max, both limited along their direction.
    """
    _, factor = speed_scale(dot(action, action), model.acceleration_limit)
    pushed = add(velocity, model.duration * factor, to_global(frame, action))
    _, factor = speed_scale(dot(pushed, pushed), model.speed_limit)
    return scaled(pushed, factor)


@kernel
def _displacement_at(model, action, frame, memory, time):
    """Displacement v t + ½ a t², with a = (v(τ) − v)/τ."""
    change = add(final_velocity(model, action, frame, memory), -1.0, memory)
    half = 0.5 * time * time / model.duration
    return add(scaled(memory, time), half, change)


@kernel
def mean_speed(before, after):
    """Mean speed ∫₀¹ ‖v₀ + s (v₁ − v₀)‖ ds along a parabola, m/s.

    It is [u √(u² + h²) + h² asinh(u/h)] / 2‖c‖ between the ends. Here u and h are the parts of the
    velocity along and across its change c.
    """
    start, end = norm(before), norm(after)
    change = add(after, -1.0, before)
    size = norm(change)
    if size <= _NEARLY_STEADY * max(start, end):
        middle = 0.5 * norm(add(before, 1.0, after))
        return (start + 4.0 * middle + end) / 6.0
    along = dot(before, change) / size
    across = norm(add(before, -along / size, change))
    length = (along + size) * end - along * start
    if across > 0.0:
        turned = math.asinh((along + size) / across) - math.asinh(along / across)
        length += across * across * turned
    return length / (2.0 * size)


@kernel
def _propose(model, action, frame, memory):
    after = final_velocity(model, action, frame, memory)
    middle = scaled(add(memory, 1.0, after), 0.5)
    return scaled(middle, model.duration), model.duration * mean_speed(memory, after)


@kernel
def _chord_error_bound(model, action, memory):
    # of a parabola; the speed limit, a projection onto a ball, only reduces the change of velocity
    return model.acceleration_limit / 8.0


@kernel
def _update(model, action, frame, memory, displacement, contact):
    """Velocity after the step; a contact removes its component along the blocked displacement."""
    velocity = final_velocity(model, action, frame, memory)
    if contact == FREE:
        return velocity
    if contact == STOPPED:
        return scaled(velocity, 0.0)
    way = scaled(add(memory, 1.0, velocity), 0.5 * model.duration)
    taken = add(way, -1.0, displacement)
    into, size = dot(velocity, taken), dot(taken, taken)
    return add(velocity, -into / size, taken) if into > 0.0 and size > 0.0 else velocity


@kernel
def _own_velocity(model, frame, memory):
    return to_local(frame, memory)


@kernel
def _init_at_rest(model, key, counter):
    return model.rest


describe(
    DoubleIntegrator,
    Motion(
        propose=_propose,
        displacement_at=_displacement_at,
        chord_error_bound=_chord_error_bound,
        update=_update,
        sense=_own_velocity,
        init=_init_at_rest,
    ),
)
register_robot_model(
    RobotModel(
        "double_integrator",
        dims=(2, 3),
        constants=lambda scenario: DoubleIntegrator(
            scenario.tau, scenario.speed_limit, scenario.acceleration_limit, (0.0,) * scenario.dim
        ),
        bounds=lambda scenario: [scenario.acceleration_limit] * scenario.dim,
        n_kept=lambda dim: dim,
        keeps_velocity=True,
        senses="velocity",
        action="acceleration, m/s²",
    )
)
