"""Arguments that a door passes on: to the scenario, and to the wrapper of a guarantee."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from ..experiment.checks import UnknownFieldError, nearest_word, shown
from ..experiment.scenario import Scenario

_FIELDS = frozenset(field.name for field in fields(Scenario))


def check_overrides(door: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Refuse a word that is no field of the scenario but looks like an argument of the door.

    What looks like neither, the scenario refuses, with its own nearest field.

    Args:
        door: which collects overrides.
        given: the overrides.

    Raises:
        UnknownFieldError: a TypeError and ValueError, naming the word and the argument.
    """
    unknown = [key for key in given if key not in _FIELDS]
    if unknown:
        own = _arguments(door)[:-1]
        for key in unknown:
            near = nearest_word(key, [*own, *sorted(_FIELDS)])
            if near in own:
                raise UnknownFieldError(
                    f"{door.__name__} has no argument {shown(key)}; did you mean {near!r}?"
                )


def sorted_overrides(
    door: Callable[..., Any], wrapper: Callable[..., Any] | None, given: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Overrides that are arguments of a wrapper, and those that are fields of the scenario.

    ``max_turn_rate`` is both: it is the wrapper's, which turns no faster than the scenario allows.

    Args:
        door: which collects overrides.
        wrapper: of a guarantee, None if there is none; its first argument is the environment.
        given: the overrides.

    Raises:
        UnknownFieldError: a TypeError and ValueError, naming a word that is neither, and the known
            one that is most like it.
    """
    of_wrapper = _arguments(wrapper)[1:] if wrapper is not None else []
    known = [*of_wrapper, *_arguments(door)[:-1], *sorted(_FIELDS)]
    for key in given:
        if key not in of_wrapper and key not in _FIELDS:
            near = nearest_word(key, known)
            hint = f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"
            raise UnknownFieldError(f"{door.__name__} has no argument {shown(key)}; {hint}")
    arguments = {key: value for key, value in given.items() if key in of_wrapper}
    return arguments, {key: given[key] for key in given if key not in of_wrapper}


def _arguments(function: Callable[..., Any]) -> list[str]:
    """Names of its arguments; that which collects the rest stands last."""
    return list(inspect.signature(function).parameters)
