"""Validation of arguments; an error gives the field, its value and a remedy."""

import dataclasses
import difflib
import functools
import inspect
import math
import re
import reprlib
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Annotated, Any, Literal, NoReturn, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from .limits import LARGEST, SMALLEST

_LONGEST_WORD = 100
_MAX_DIFFERING = 3
_STEPS = ("max_steps", "max_episode_steps", "horizon", "episode_length")
_SYNONYMS = {
    "n_robots": ("n", "n_agents", "num_agents", "num_robots", "team_size"),
    "dim": ("d", "dimension", "ndim", "n_dims"),
    "robot_model": ("model", "dynamics", "kinematics"),
    "merge_radius": ("r", "rendezvous_radius", "meeting_radius", "capture_radius"),
    "time_step": ("dt", "tau", "timestep", "step_size", "certified_step"),
    "max_cycles": _STEPS,
    "time_limit": _STEPS,
    "max_speed": ("v_max", "speed_limit", "speed_limits", "min_speed_limit", "max_velocity"),
    "max_turn_rate": ("turn_limit", "min_turn_limit", "omega_max", "max_angular_velocity"),
    "max_acceleration": ("a_max", "acceleration_limit"),
    "spawn_size": ("spawn_edges", "spawn_diagonal", "arena_size", "world_size"),
    "obstacle_contact": ("contact_mode", "collision", "collisions"),
    "sensing": ("sensor", "sensors"),
    "graph": ("sensing_graph", "topology", "adjacency"),
    "positions": ("start_positions", "initial_positions"),
    "headings": ("start_headings", "initial_headings"),
    "weights": ("graph", "adjacency", "edge_weights"),
    "cycle": ("ring", "circle", "loop"),
    "path": ("line", "chain"),
    "complete": ("full", "fully_connected", "all", "clique"),
    "erdos_renyi": ("gnp", "er"),
    "proximity": ("disk", "geometric"),
    "error": ("adversarial_error",),
}
"""Names of the same concepts in other packages, and of properties that follow from a field."""
_Made = TypeVar("_Made")
_Function = TypeVar("_Function", bound=Callable[..., Any])


_DERIVED = (property, functools.cached_property)


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
        f"{name} is {short_repr(now)} instead of {short_repr(made)}"
        for name, (made, now) in list(differing.items())[:_MAX_DIFFERING]
    ]
    others = f" and {left} more" if (left := len(differing) - _MAX_DIFFERING) > 0 else ""
    raise ValueError(
        f"policy is {policy}, made for {own!r}; in {here!r} {', '.join(values)}{others}: make the "
        "policy with this scenario"
    )


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


# A check of one value takes the name of a field and its value, and returns what is kept.


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


def one_or_each(field: str, value: Any, check: Callable[[str, Any], Any], unit: str = "") -> Any:
    """One value for all robots, or a list with one for each, by a check of one value.

    A list of equal values is returned as one value.
    """
    if not is_sequence(value):
        return check(field, value)
    if len(value) == 0:
        raise_invalid(
            field, value, "one value, or a list of one for each robot" + f", {unit}" * bool(unit)
        )
    each = tuple(check(f"{field}[{robot}]", entry) for robot, entry in enumerate(value))
    return each[0] if len(each) > 1 and len(set(each)) == 1 else each


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
    if np.can_cast(array.dtype, dtype):  # nothing to overflow, and warnings take longest to silence
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


def nearest_word(
    word: Any, words: Iterable[str], cutoff: float = 0.65, parts: bool = True
) -> str | None:
    """Known word for ``word``: a synonym, a similar word, or one that contains it.

    A similar word has a similarity of at least ``cutoff`` (at most 1). Parts are separated by - and
    _; with ``parts=False`` they do not count.
    """
    if not isinstance(word, str) or len(word) > _LONGEST_WORD:
        return None
    known = list(words)
    if alike := [one for one in known if _plain(one) == _plain(word)]:
        return alike[0]
    if meant := [ours for ours, theirs in _SYNONYMS.items() if word in theirs and ours in known]:
        return meant[0]
    having = [one for one in known if parts and word in re.split("[-_]", one)]
    close = difflib.get_close_matches(word, known, 1, cutoff)
    close = close or difflib.get_close_matches(word, having, 1, 0.0)
    return close[0] if close else None


def _plain(word: str) -> str:
    return word.lower().replace("-", "_")


def closest_match(word: Any, words: Iterable[str], before: str = "", after: str = "") -> str:
    """Question that suggests the ``nearest_word``, between two texts; empty without one."""
    near = nearest_word(word, words)
    return f"{before}did you mean {near!r}?{after}" if near else ""


def known_fields(
    given: Iterable[Any],
    known: Iterable[str],
    what: str,
    noun: str = "field",
    explain: Callable[[Any], str] = lambda key: "",
) -> None:
    """Raise an UnknownFieldError for an unknown field, with the most similar known one.

    ``explain`` may give another hint for a field; empty for none.
    """
    known = list(known)
    for key in given:
        if key not in known:
            hint = (
                explain(key)
                or closest_match(key, known)
                or f"known are {', '.join(known) or 'none'}"
            )
            if key in _STEPS and nearest_word(key, known) == "time_limit":
                hint += " it is in s, not in steps"
            raise UnknownFieldError(f"{what} has no {noun} {short_repr(key)}; {hint}")


def known_arguments(function: _Function) -> _Function:
    """Decorate a function to suggest the most similar argument for unknown keywords."""
    kinds = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    given = inspect.signature(function).parameters.values()
    names = [one.name for one in given if one.kind in kinds and one.name not in ("self", "cls")]

    @functools.wraps(function)
    def checked(*args: Any, **arguments: Any) -> Any:
        known_fields(arguments, names, function.__name__, "argument")
        return function(*args, **arguments)

    return cast(_Function, checked)


def load(library: str, what: str, extra: str) -> Any:
    """Import a library of an extra; an ImportError gives its purpose and how to install it."""
    try:
        return import_module(library)
    except ImportError as error:
        remedy = f"pip install 'rendezvous-env[{extra}]'"
        raise ImportError(f"{what} needs {library}: {remedy}", name=library) from error


Metres = Annotated[float, partial(positive, unit="m")]
Seconds = Annotated[float, partial(positive, unit="s")]


def from_plain(made: type[_Made], plain: Mapping[str, Any], what: str) -> _Made:
    """Dataclass from plain data, with defaults for absent keys; unknown keys are rejected."""
    _known_fields_of(made, plain, what)
    return made(**plain)


def _known_fields_of(made: Any, given: Iterable[Any], what: str) -> None:
    """As ``known_fields`` for a dataclass, with hints on properties and on fields of its parts."""
    names = _names_of(made)

    def explain(key: Any) -> str:
        if nearest_word(key, names, cutoff=1.0, parts=False):
            return ""
        if isinstance(inspect.getattr_static(made, str(key), None), _DERIVED):
            return "it follows from other fields and cannot be set"
        parts = {name: getattr(check, "made", None) for name, check in _checks_of(made).items()}
        having = [name for name, part in parts.items() if part and key in _names_of(part)]
        if not having or nearest_word(key, names):
            return ""
        return f"it is a field of {' and of '.join(having)}; give it there"

    known_fields(given, names, what, explain=explain)


def _names_of(made: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(made)]


def of_class(made: Any) -> Callable[[str, Any], Any]:
    """Check for an instance of a class, or a table of its fields."""

    def check(field: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return from_plain(made, value, field)
        if not isinstance(value, made):
            raise_invalid(field, value, f"a {made.__name__}, or a table of its fields")
        return value

    setattr(check, "made", made)  # noqa: B010 - mypy forbids the plain assignment
    return check


def names_unknown_fields(what: str) -> Callable[[type[_Made]], type[_Made]]:
    """Decorate a dataclass to suggest the most similar field for unknown keywords."""

    def decorate(made: type[_Made]) -> type[_Made]:
        make = made.__init__

        @functools.wraps(make)
        def checked(self: _Made, *args: Any, **fields: Any) -> None:
            _known_fields_of(made, fields, what)
            make(self, *args, **fields)

        setattr(made, "__init__", checked)  # noqa: B010 - mypy forbids the plain assignment
        return made

    return decorate


def check_fields(made: Any, label: str = "{}") -> None:
    """Validate and convert the fields of a frozen dataclass, in its ``__post_init__``.

    NumPy scalars become Python ones, and each value passes the check of its annotation. None is
    kept where it is the default.

    ``Annotated[kind, check]`` gives a function of field and value that returns the stored value.
    bool, Literal, float and str correspond to ``flag``, ``choice``, ``number`` and ``text``.
    Messages name a field by ``label`` of its name.
    """
    checks = _checks_of(cast(Any, type(made)))
    for field in dataclasses.fields(made):
        value, check = getattr(made, field.name), checks[field.name]
        if isinstance(value, np.generic):
            value = value.item()
        if check is not None and not (value is None and field.default is None):
            value = check(label.format(field.name), value)
        object.__setattr__(made, field.name, value)


@functools.cache
def _checks_of(made: type[Any]) -> dict[str, Callable[[str, Any], Any] | None]:
    hints = typing.get_type_hints(made, include_extras=True)
    return {field.name: _check_of(hints[field.name]) for field in dataclasses.fields(made)}


def _check_of(hint: Any) -> Callable[[str, Any], Any] | None:
    kind, parts = typing.get_origin(hint), typing.get_args(hint)
    if kind is Annotated:
        return cast(Callable[[str, Any], Any], hint.__metadata__[0])
    if kind is Literal:
        return partial(choice, choices=parts)
    if type(None) in parts:
        return _check_of(parts[0])
    by_kind: dict[Any, Any] = {bool: flag, float: number, str: text}
    return by_kind.get(hint)


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
