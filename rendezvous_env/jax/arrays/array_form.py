"""Equations of the numba kernels as functions of arrays: one source for both forms.

A kernel is a function of numbers and tuples of numbers. Its Python source is read with
``jax.numpy`` in place of ``math`` and selections in place of branches (``selection``). The result
is the same function of arrays of one shape. A few kernels have a second form, registered with
``replaces``: where loops end early, or where it is faster. Tests compare the two.
"""

import builtins
import inspect
import math
from collections.abc import Callable
from functools import cache, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...physics import random_streams as engine_streams
from ...physics.potential import bearing_factor
from ...physics.trigonometry import cos_sin
from ...physics.vectors import dot, split, store
from . import random_streams
from .selection import HELPERS, divided, is_static, rewritten

Array = jax.Array
_SHORT = 32
_SELECTING: dict[Any, Callable[..., Any]] = {}


def square_root(x: Any) -> Any:
    """√x, and 0 with a derivative of 0 for x ≤ 0, so that gradients stay finite; NaN of NaN."""
    positive = jnp.logical_not(x <= 0.0)  # also of NaN, which is not 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def as_number(x: Any) -> Any:
    """Number or array in the precision of JAX: float64 with ``jax_enable_x64``, else float32."""
    return x if is_static(x) else jnp.asarray(x, jnp.result_type(float))


def _of(number: Callable[..., Any], array: Callable[..., Any]) -> Callable[..., Any]:
    """A function of numbers, and its counterpart of arrays."""
    return lambda *values: (number if is_static(*values) else array)(*values)


def _whole(x: Any) -> Any:
    return x.astype(jnp.int32)


class _Namespace:
    """A module with some of its functions replaced."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self._module = module
        vars(self).update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def angle_of(y: Any, x: Any) -> Any:
    """Angle of (x, y), rad, and 0 with a derivative of 0 for (0, 0)."""
    none = (x == 0.0) & (y == 0.0)
    return jnp.where(none, 0.0, jnp.arctan2(jnp.where(none, 0.0, y), jnp.where(none, 1.0, x)))


def _arc_cosine(x: Any) -> Any:
    """Arc cosine, rad, with a derivative of 0 at ±1."""
    end = jnp.abs(x) >= 1.0
    return jnp.where(end, jnp.where(x > 0.0, 0.0, jnp.pi), jnp.arccos(jnp.where(end, 0.0, x)))


_NAMES = {"sin": "sin", "cos": "cos", "asinh": "arcsinh", "hypot": "hypot"}
_NAMES |= {"copysign": "copysign", "floor": "floor", "ceil": "ceil"}
_MATH = _Namespace(
    math,
    sqrt=_of(math.sqrt, square_root),
    atan2=_of(math.atan2, angle_of),
    acos=_of(math.acos, _arc_cosine),
    **{name: _of(getattr(math, name), getattr(jnp, of)) for name, of in _NAMES.items()},
)
_NUMPY = _Namespace(jnp, float64=as_number, sqrt=square_root, arctan2=angle_of)
_OURS = "rendezvous_env", "baselines"
_BUILT_IN = {
    "min": lambda *values: reduce(_of(min, jnp.minimum), values),
    "max": lambda *values: reduce(_of(max, jnp.maximum), values),
    "abs": _of(abs, jnp.abs),
    "round": _of(round, jnp.round),
    "int": _of(int, _whole),
}


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
    if hasattr(plain, "__wrapped__"):
        return _dispatched(plain)
    code, names = rewritten(plain)
    scope = vars(builtins) | _BUILT_IN | HELPERS
    known = {**plain.__globals__, **inspect.getclosurevars(plain).nonlocals}
    for name in names & known.keys():
        scope[name] = _array_value(known[name])
    exec(code, scope)
    made: Callable[..., Any] = scope[plain.__name__]
    made.__doc__ = plain.__doc__
    return made


def _dispatched(kernel: Any) -> Callable[..., Any]:
    """A function of ``compilation.by_type``, which selects by the type of an argument."""
    rule = inspect.getclosurevars(kernel).nonlocals

    def called(*arguments: Any) -> Any:
        chosen = rule["choose"](type(arguments[rule["place"]]))
        return array_form(chosen)(*arguments) if callable(chosen) else chosen

    return called


def _array_value(value: Any) -> Any:
    """The counterpart over arrays of a global of a kernel."""
    if value is math:
        return _MATH
    if value is np:
        return _NUMPY
    plain = getattr(value, "py_func", value)
    ours = inspect.isfunction(plain) and plain.__module__.split(".")[0] in _OURS
    return (lambda *arguments: array_form(value)(*arguments)) if ours else value


@replaces(bearing_factor)
def _bearing_factor(gain: Any, distance: Any) -> Any:
    return divided(gain, distance)


@replaces(cos_sin)
def _cos_sin(angle: Any) -> Any:
    return _MATH.cos(angle), _MATH.sin(angle)


def norm_of(a: Any) -> Any:
    """‖a‖ of a tuple of arrays."""
    return square_root(array_form(dot)(a, a))


@replaces(split)
def _split(a: Any) -> Any:
    length = norm_of(a)
    inverse = divided(jnp.ones_like(length), length)
    return length, tuple(part * inverse for part in a)


@replaces(store)
def _store(vector: Any, out: Any) -> None:
    out[:] = vector[: len(out)]


@replaces(engine_streams.uniform)
def _uniform(key: Any, counter: Any) -> Any:
    if isinstance(key, random_streams.Numbers):
        return key.values[counter]
    return random_streams.uniform(key, counter, jnp.result_type(float))


def total(values: Any, axis: int) -> Any:
    """Sum over an axis; over a short one written out, since XLA fuses no reductions on a CPU."""
    length = values.shape[axis]
    if not 0 < length <= _SHORT:
        return jnp.sum(values, axis=axis)
    parts = (jax.lax.index_in_dim(values, k, axis, keepdims=False) for k in range(length))
    return reduce(jnp.add, parts)


def select(condition: Any, a: Any, b: Any) -> Any:
    """The first of two tuples where a condition holds, else the second."""
    return tuple(jnp.where(condition, p, q) for p, q in zip(a, b, strict=True))
