"""Validation of dataclass fields and of keywords; unknown ones get a suggestion."""

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Annotated, Any, Literal, TypeVar, cast

import numpy as np

from .checks import (
    UnknownFieldError,
    choice,
    flag,
    number,
    positive,
    raise_invalid,
    short_repr,
    text,
)
from .suggestions import STEPS, closest_match, nearest_word

_Made = TypeVar("_Made")
_Function = TypeVar("_Function", bound=Callable[..., Any])


_DERIVED = (property, functools.cached_property)

Metres = Annotated[float, partial(positive, unit="m")]
Seconds = Annotated[float, partial(positive, unit="s")]


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
            if key in STEPS and nearest_word(key, known) == "time_limit":
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
