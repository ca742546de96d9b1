"""Equations of the numba kernels as functions of arrays: one source for both forms.

A kernel is a function of numbers and tuples of numbers. Its Python source, read with ``jax.numpy``
in place of ``math``, is the same function of arrays of one shape. Kernels that branch on a number
have a second form, which selects; ``replaces`` registers it, and a test compares the two.
"""

import builtins
import inspect
import math
from collections.abc import Callable
from functools import cache
from types import FunctionType, SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..physics.crossings import first_crossing
from ..physics.potential import bearing_factor
from ..physics.vectors import combine, dot, split, split_across, without
from ..rewards.terms import CLEARANCE_PENALTY, team_reward
from ..robots.double_integrator import _NEARLY_STEADY, mean_speed
from ..robots.motion import displacement_at, motion_of
from ..robots.single_integrator import limit_factor
from ..robots.unicycle import mean_cos_sin
from ..safety.heading import _NEARLY_PARALLEL, into_cap

Array = jax.Array
_SELECTING: dict[Any, Callable[..., Any]] = {}


def square_root(x: Any) -> Any:
    """√x, and 0 with a derivative of 0 for x ≤ 0, so that gradients stay finite; NaN of NaN."""
    positive = jnp.logical_not(x <= 0.0)  # also of NaN, which is not 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def quotient(a: Any, b: Any) -> Any:
    """a/b, and 0 with a derivative of 0 where b is 0."""
    some = b != 0.0
    return jnp.where(some, a / jnp.where(some, b, 1.0), 0.0)


def angle_of(y: Any, x: Any) -> Any:
    """Angle of (x, y), rad, and 0 with a derivative of 0 for (0, 0)."""
    none = (x == 0.0) & (y == 0.0)
    return jnp.where(none, 0.0, jnp.arctan2(jnp.where(none, 0.0, y), jnp.where(none, 1.0, x)))


_MATH = SimpleNamespace(
    sqrt=square_root, sin=jnp.sin, cos=jnp.cos, atan2=angle_of, pi=math.pi, inf=math.inf
)
_NUMPY = SimpleNamespace(**vars(jnp) | {"sqrt": square_root, "arctan2": angle_of})
_OURS = "rendezvous_env", "baselines"
_BUILT_IN = {"min": jnp.minimum, "max": jnp.maximum, "abs": jnp.abs}


def replaces(kernel: Any) -> Callable[[Any], Any]:
    """Decorator: this is the array form of a kernel."""

    def register(function: Any) -> Any:
        _SELECTING[kernel] = function
        return function

    return register


@cache
def array_form(kernel: Any) -> Callable[..., Any]:
    """The array form of a kernel: the registered one, or its own source over arrays."""
    if kernel in _SELECTING:
        return _SELECTING[kernel]
    plain = getattr(kernel, "py_func", kernel)
    scope = vars(builtins) | _BUILT_IN
    for name in plain.__code__.co_names:
        if name in plain.__globals__:
            scope[name] = _array_value(plain.__globals__[name])
    made = FunctionType(plain.__code__, scope, plain.__name__, plain.__defaults__)
    made.__doc__ = plain.__doc__
    return made


def _array_value(value: Any) -> Any:
    """The counterpart over arrays of a global of a kernel."""
    if value is math:
        return _MATH
    if value is np:
        return _NUMPY
    plain = getattr(value, "py_func", value)
    ours = inspect.isfunction(plain) and plain.__module__.split(".")[0] in _OURS
    return array_form(value) if ours else value


@replaces(displacement_at)
def _displacement_at(model: Any, action: Any, frame: Any, memory: Any, time: Any) -> Any:
    motion = motion_of(type(model))
    assert motion is not None  # robot models are described before they are registered
    return array_form(motion.displacement_at)(model, action, frame, memory, time)


@replaces(bearing_factor)
def _bearing_factor(gain: Any, distance: Any) -> Any:
    return quotient(gain, distance)


@replaces(limit_factor)
def _limit_factor(speed: Any, limit: Any) -> Any:
    fast = speed > limit
    return jnp.where(fast, limit / jnp.where(fast, speed, 1.0), 1.0)


@replaces(mean_cos_sin)
def _mean_cos_sin(angle: Any, swept: Any) -> Any:
    half = 0.5 * swept
    small = jnp.abs(half) < 1e-8
    nonzero = jnp.where(small, 1.0, half)
    sin_half = jnp.sin(nonzero)
    mean_sin = jnp.where(small, half, sin_half * sin_half / nonzero)
    mean_cos = jnp.where(small, 1.0, sin_half * jnp.cos(nonzero) / nonzero)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return mean_cos * c - mean_sin * s, mean_cos * s + mean_sin * c


@replaces(mean_speed)
def _mean_speed(before: Any, after: Any) -> Any:
    start, end = _norm(before), _norm(after)
    change = tuple(b - a for a, b in zip(before, after, strict=True))
    size = _norm(change)
    steady = size <= _NEARLY_STEADY * jnp.maximum(start, end)
    middle = 0.5 * _norm(tuple(a + b for a, b in zip(before, after, strict=True)))
    simpson = (start + 4.0 * middle + end) / 6.0
    size = jnp.where(steady, 1.0, size)
    along = array_form(dot)(before, change) / size
    across = _norm(array_form(combine)(1.0, before, -along / size, change))
    turns = across > 0.0
    safe = jnp.where(turns, across, 1.0)
    turned = jnp.arcsinh((along + size) / safe) - jnp.arcsinh(along / safe)
    length = (along + size) * end - along * start + across * across * turned
    return jnp.where(steady, simpson, length / (2.0 * size))


def _norm(a: Any) -> Any:
    return square_root(array_form(dot)(a, a))


@replaces(split)
def _split(a: Any) -> Any:
    length = _norm(a)
    inverse = quotient(jnp.ones_like(length), length)
    return length, tuple(part * inverse for part in a)


@replaces(split_across)
def _split_across(a: Any, h: Any) -> Any:
    if len(a) == 2:
        to_left = h[0] * a[1] - h[1] * a[0]
        side = jnp.where(to_left >= 0.0, 1.0, -1.0)
        return jnp.abs(to_left), (-side * h[1], side * h[0])
    return _split(array_form(without)(a, h))


@replaces(into_cap)
def _into_cap(direction: Any, towards: Any, margin: Any, otherwise: Any) -> Any:
    size, across = _split_across(direction, towards)
    edge = array_form(combine)(margin, towards, square_root(1.0 - margin * margin), across)
    inside = array_form(dot)(direction, towards) >= margin
    return select(inside, direction, select(size < _NEARLY_PARALLEL, otherwise, edge))


@replaces(first_crossing)
def _first_crossing(offset: Any, velocity: Any, radius: Any) -> Any:
    product, distance = array_form(dot), _norm(offset)
    approach, square_speed = -product(offset, velocity), product(velocity, velocity)
    moves = (approach > 0.0) & (square_speed > 0.0)
    share = approach / jnp.where(moves, square_speed, 1.0)
    miss = _norm(array_form(combine)(1.0, offset, share, velocity))
    hits = moves & (miss <= radius)
    root = square_root(jnp.where(hits, square_speed * (radius - miss) * (radius + miss), 0.0))
    s = (distance - radius) * (distance + radius) / jnp.where(hits, approach + root, 1.0)
    later = jnp.where(hits & (s <= 1.0), s, jnp.inf)
    return jnp.where(distance <= radius, 0.0, later)


@replaces(team_reward)
def _team_reward(
    progress: Any, time_share: Any, contacts: Any, closeness: Any, met: Any, weights: Any
) -> Any:
    reward = weights[0] * progress - weights[1] * time_share - weights[2] * contacts
    reward = reward - weights[CLEARANCE_PENALTY] * closeness
    return jnp.where(met, reward + weights[3], reward)


def select(condition: Any, a: Any, b: Any) -> Any:
    """The first of two tuples where a condition holds, else the second."""
    return tuple(jnp.where(condition, p, q) for p, q in zip(a, b, strict=True))
