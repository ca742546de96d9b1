"""Keyword arguments of factories: which go to the scenario, which to the wrapper of a guarantee,
and what nobody knows.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any

from ..checks import UnknownFieldError, nearest_word, shown
from ..scenario.scenario import Scenario

_FIELDS = frozenset(field.name for field in fields(Scenario))


def check_overrides(factory: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Refuse a word that is no field of the scenario but looks like an argument of the factory.

    What looks like neither, the scenario refuses, with its own nearest field.

    Args:
        factory: which collects overrides.
        given: the overrides.

    Raises:
        UnknownFieldError: a TypeError and ValueError, naming the word and the argument.
    """
    unknown = [key for key in given if key not in _FIELDS]
    if unknown:
        own = arguments_of(factory)[:-1]
        for key in unknown:
            near = nearest_word(key, [*own, *sorted(_FIELDS)])
            if near in own:
                raise UnknownFieldError(
                    f"{factory.__name__} has no argument {shown(key)}; did you mean {near!r}?"
                )


def sorted_overrides(
    factory: Callable[..., Any], wrapper: Callable[..., Any] | None, given: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Overrides that are arguments of a wrapper, and those that are fields of the scenario.

    ``max_turn_rate`` is both: it is the wrapper's, which turns no faster than the scenario allows.

    Args:
        factory: which collects overrides.
        wrapper: of a guarantee, None if there is none; its first argument is the environment.
        given: the overrides.

    Raises:
        UnknownFieldError: a TypeError and ValueError, naming a word that is neither, and the known
            one that is most like it.
    """
    of_wrapper = arguments_of(wrapper)[1:] if wrapper is not None else []
    known = [*of_wrapper, *arguments_of(factory)[:-1], *sorted(_FIELDS)]
    strange = [key for key in given if key not in of_wrapper and key not in _FIELDS]
    _refuse(factory.__name__, strange, known)
    arguments = {key: value for key, value in given.items() if key in of_wrapper}
    return arguments, {key: given[key] for key in given if key not in of_wrapper}


class NamesUnknownArguments:
    """To inherit from: constructors of subclasses refuse an unknown keyword with a TypeError that
    names the nearest argument. One that collects keywords passes on what it likes.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Wrap the constructor, if the subclass has one of its own."""
        super().__init_subclass__(**options)
        make = vars(cls).get("__init__")
        if make is None or inspect.getfullargspec(make).varkw:
            return
        known = arguments_of(make)[1:]

        @functools.wraps(make)
        def checked(self: Any, *arguments: Any, **given: Any) -> None:
            ours = [c for c in type(self).__mro__ if c.__module__.startswith(__package__)]
            _refuse(ours[0].__name__, [key for key in given if key not in known], known)
            make(self, *arguments, **given)

        setattr(cls, "__init__", checked)  # noqa: B010 - mypy forbids the plain assignment


def _refuse(what: str, strange: Iterable[str], known: Iterable[str]) -> None:
    """Refuse the first of strange words, with the known one that is most like it."""
    for key in strange:
        near = nearest_word(key, known)
        hint = f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"
        raise UnknownFieldError(f"{what} has no argument {shown(key)}; {hint}")


def arguments_of(function: Callable[..., Any]) -> list[str]:
    """Names of its arguments; that which collects the rest stands last."""
    return list(inspect.signature(function).parameters)
