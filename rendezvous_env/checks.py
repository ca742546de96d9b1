"""Validation of arguments; an error gives the field, its value and a remedy."""

import math
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from .limits import LARGEST, SMALLEST
from .suggestions import closest_match

_MAX_DIFFERING = 3
_MAX_CHARACTERS = 60


class UnknownFieldError(TypeError, ValueError):
    """Unknown field: a TypeError, as in Python, and a ValueError, as elsewhere in this package."""


class _Shown(reprlib.Repr):
    """Shortened ``repr`` that never fails and has limited recursion."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxlong, self.maxother = 5, 90, 60, 200
        self.maxlist = self.maxtuple = self.maxdict = self.maxset = self.maxarray = 12

    def repr_int(self, x: int, level: int) -> str:
        """An integer; Python rejects the conversion of very long ones."""
        if abs(x) < 10**self.maxlong:
            return repr(x)
        return f"an integer of about {int(x.bit_length() * 0.30103) + 1} digits"

    def repr_instance(self, x: Any, level: int) -> str:
        """Any other value, on one line."""
        return " ".join(super().repr_instance(x, level).split())


short_repr = _Shown().repr
"""Value for messages: its repr, shortened if long."""


def raise_invalid(field: str, value: Any, wanted: str) -> NoReturn:
    """Raise a ValueError with a field, its invalid value and the requirement."""
    raise ValueError(f"{field} is {short_repr(value)}; it must be {wanted}")


def raise_other_scenario(
    policy: str, own: str, here: str, differing: Mapping[str, tuple[Any, Any]]
) -> NoReturn:
    """Raise a ValueError for a policy made for another scenario, with both values of fields.

    ``own`` and ``here`` are the names of the scenarios; ``differing`` has the values by field.
    """
    values = [
        f"{name} is {_abridged(now)} instead of {_abridged(made)}"
        for name, (made, now) in list(differing.items())[:_MAX_DIFFERING]
    ]
    others = f" and {left} more" if (left := len(differing) - _MAX_DIFFERING) > 0 else ""
    raise ValueError(
        f"policy is {policy}, made for {own!r}; in {here!r} {', '.join(values)}{others}: make the "
        "policy with this scenario"
    )


def _abridged(value: Any) -> str:
    """As ``short_repr``, at most 60 characters."""
    text = short_repr(value)
    return text if len(text) <= _MAX_CHARACTERS else f"{text[: _MAX_CHARACTERS - 1]}…"


def format_limit(limit: float) -> str:
    """Limit with all digits, so that the printed value is accepted as input."""
    short = f"{limit:g}"
    return short if float(short) == limit else repr(float(limit))


def counted(count: int, noun: str) -> str:
    """Count with its noun, in the plural unless it is 1: "1 step", "2 policies"."""
    if count == 1:
        return f"1 {noun}"
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count} {plural}"


def to_float(value: Any) -> float:
    """Number of any type as a Python float; infinite beyond float64, NaN for other values.

    Values are compared with bounds in this form, because NumPy would round the bounds to a smaller
    type.
    """
    numeric = isinstance(value, int | float | np.integer | np.floating)
    if not numeric or isinstance(value, bool):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def is_int(value: Any) -> bool:
    """True if a value is one integer, and not a bool."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_sequence(value: Any) -> bool:
    """True if a value is a sequence other than a string."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


# A check of one value takes the name of a field and its value, and returns the stored value.


def number(
    field: str, value: Any, least: float = -LARGEST, most: float = LARGEST, unit: str = ""
) -> float:
    """Finite number within bounds."""
    if not least <= to_float(value) <= most:
        bounds = f"from {format_limit(least)} to {format_limit(most)} {unit}".rstrip()
        raise_invalid(field, value, f"a finite number {bounds}")
    return to_float(value)


def positive(field: str, value: Any, unit: str = "") -> float:
    """Positive number within the limits."""
    if not SMALLEST <= to_float(value) <= LARGEST:
        bounds = f"from {SMALLEST:g} to {LARGEST:g} {unit}".rstrip()
        raise_invalid(field, value, f"a positive, finite number, {bounds}")
    return to_float(value)


def edge_lengths(field: str, value: Any) -> float | tuple[float, ...]:
    """Edge length of a square or cube, m, or those of a rectangle or box; equal ones are one."""
    if not isinstance(value, list | tuple | np.ndarray):
        return positive(field, value, "m")
    if len(value) not in (2, 3):
        raise_invalid(field, value, "a number, or one number for each dimension")
    edges = tuple(positive(f"{field}[{axis}]", edge, "m") for axis, edge in enumerate(value))
    return edges[0] if len(set(edges)) == 1 else edges


def one_or_each(
    field: str,
    value: Any,
    check: Callable[[str, Any], Any],
    unit: str = "",
    keeps_lists: bool = False,
) -> Any:
    """One value for all robots, or a list with one for each, by a check of one value.

    A list of equal values is returned as one value, unless it ``keeps_lists``.
    """
    if not is_sequence(value):
        return check(field, value)
    if len(value) == 0:
        raise_invalid(
            field, value, "one value, or a list of one for each robot" + f", {unit}" * bool(unit)
        )
    each = tuple(check(f"{field}[{robot}]", entry) for robot, entry in enumerate(value))
    return each[0] if not keeps_lists and len(each) > 1 and len(set(each)) == 1 else each


def check_int(field: str, value: Any, least: int, most: int) -> int:
    """Integer within bounds."""
    if not is_int(value) or not least <= value <= most:
        raise_invalid(field, value, f"an integer, {least} or more, at most {most}")
    return int(value)


def flag(field: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise_invalid(field, value, "one of True, False")
    return bool(value)


def choice(field: str, value: Any, choices: Iterable[str]) -> str:
    """One of several words."""
    known = tuple(choices)
    if not isinstance(value, str) or value not in known:
        raise_invalid(
            field, value, f"one of {', '.join(map(repr, known))}{closest_match(value, known, '; ')}"
        )
    return value


def text(field: str, value: Any) -> str:
    """String."""
    if not isinstance(value, str):
        raise_invalid(field, value, "a text")
    return value


def number_range(
    field: str, value: Any, least: float = SMALLEST, unit: str = ""
) -> tuple[float, float]:
    """Minimum and maximum of a range of positive numbers, from two numbers or one."""
    pair = tuple(value) if is_sequence(value) else (value, value)
    if len(pair) != 2 or not least <= to_float(pair[0]) <= to_float(pair[1]) <= LARGEST:
        bounds = f"{format_limit(least)} <= low <= high <= {LARGEST:g} {unit}".rstrip()
        raise_invalid(field, value, f"a finite number, or a pair of them with {bounds}")
    return to_float(pair[0]), to_float(pair[1])


def mapping(field: str, value: Any, wanted: str) -> Mapping[Any, Any]:
    """Mapping."""
    if not isinstance(value, Mapping):
        raise_invalid(field, value, wanted)
    return value


def floats(field: str, value: Any, dtype: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
    """Numbers of any shape as an array, infinite where they exceed the type.

    Other values are rejected.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RecursionError, RuntimeError) as error:
        told = f"{short_repr(value)}; it must be an array of numbers without gaps"
        raise ValueError(f"{field} is {_unreadable(value) or told}") from error
    if array.dtype.kind not in "fiub":
        raise_invalid(field, value, "numbers, each of them in the range of float64")
    if np.can_cast(array.dtype, dtype):  # cannot overflow, and suppressing warnings is slow
        return array.astype(dtype, copy=False)
    with np.errstate(over="ignore"):
        return array.astype(dtype)


def check_shape(name: str, array: Any, *shapes: tuple[int, ...], axes: str = "") -> None:
    """Reject a named array of another shape; ``axes`` names the axes."""
    if array.shape not in shapes:
        wanted = f"{axes} = " * bool(axes) + " or ".join(dict.fromkeys(map(str, shapes)))
        has, it = ("have", "they") if name.endswith("s") else ("has", "it")
        raise ValueError(f"{name} {has} shape {array.shape}; {it} must be {wanted}")


def _unreadable(value: Any) -> str:
    """Reason why NumPy cannot read a tensor, with a remedy; empty for other values."""
    if not all(hasattr(value, name) for name in ("detach", "requires_grad", "device", "dtype")):
        return ""
    grad = " that requires grad" if value.requires_grad else ""
    tensor = f"a {value.dtype} tensor on {value.device}{grad}"
    return f"{tensor}, which NumPy cannot read; give its .detach().cpu().float().numpy()"


def check_action(robot: str, value: Any, size: int) -> None:
    """Reject a robot's action that is not ``size`` finite numbers, with robot and value."""
    try:
        action = floats("action", value, np.float32)
    except ValueError:
        if told := _unreadable(value):
            raise ValueError(f"action of {robot} is {told}") from None
        action = np.empty(0)
    if action.shape != (size,) or not np.isfinite(action).all():
        raise_invalid(f"action of {robot}", value, f"{size} finite numbers, in float32")


def bools(field: str, value: Any, shape: tuple[int, ...] | None, of_what: str) -> NDArray[np.bool_]:
    """Array of bools, of any shape if None is required."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RecursionError):
        array = np.empty(0, dtype=object)
    if (shape is not None and array.shape != shape) or array.dtype != np.bool_:
        is_array = array.dtype != object
        found = f"{array.dtype} of shape {array.shape}" if is_array else short_repr(value)
        count = "the" if shape is None else " × ".join(map(str, shape))
        raise ValueError(f"{field} is {found}; it must be bool, one for each of {count} {of_what}")
    return array


def load(library: str, what: str, extra: str) -> Any:
    """Import a library of an extra; an ImportError gives its purpose and how to install it."""
    try:
        return import_module(library)
    except ImportError as error:
        remedy = f"pip install 'rendezvous-env[{extra}]'"
        raise ImportError(f"{what} needs {library}: {remedy}", name=library) from error


class Registry(dict[str, Any]):
    """Registry of custom functions or models by name.

    It stores their kind, and the public name of its registration function.
    """

    def __init__(self, what: str, register: str) -> None:
        super().__init__()
        self.what, self._register = what, register

    def __missing__(self, name: str) -> Any:
        remedy = f"import the file that calls {self._register}"
        raise ValueError(f"{self.what} {name!r} is not registered here; {remedy}")

    def add(self, name: Any, function: Any) -> Any:
        """Register a function and return it; without a function return a decorator."""
        if not isinstance(name, str) or not name or not name.isprintable():
            raise_invalid(f"name of a {self.what}", name, "a word")
        if function is None:
            return lambda function: self.add(name, function)
        if not callable(function):
            raise_invalid(f"{self.what} {name!r}", function, "a function")
        self[name] = function
        return function

    def check(self, field: str, name: Any) -> None:
        """Reject an unregistered name, with the most similar one or how to register it."""
        if not isinstance(name, str) or name not in self:
            hint = closest_match(name, self) or f"register it with {self._register}"
            raise ValueError(f"{field}: {short_repr(name)} is unknown; {hint}")
