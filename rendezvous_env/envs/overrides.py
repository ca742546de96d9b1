"""Keyword arguments of factories: of the scenario, of a guarantee's wrapper, and unknown ones."""

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from typing import Any

from ..checks import known_fields
from ..scenario.scenario import Scenario

_FIELDS = sorted(field.name for field in fields(Scenario))


def check_overrides(
    factory: Callable[..., Any], given: Mapping[str, Any], of_wrapper: Collection[str] = ()
) -> None:
    """Refuse a word that is neither an argument of the factory or of its wrapper nor a field of the
    scenario, with the known one that is most like it.
    """
    known = [*of_wrapper, *arguments_of(factory)[:-1], *_FIELDS]
    known_fields(given, known, factory.__name__, "argument")


def sorted_overrides(
    factory: Callable[..., Any], of_wrapper: Collection[str], given: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Overrides that are arguments of a wrapper, and those of the factory and of the scenario;
    others are refused as by ``check_overrides``.

    ``max_turn_rate`` is both: it is the wrapper's, which turns no faster than the scenario allows.
    """
    check_overrides(factory, given, of_wrapper)
    arguments = {key: value for key, value in given.items() if key in of_wrapper}
    return arguments, {key: given[key] for key in given if key not in of_wrapper}


def arguments_of(function: Callable[..., Any]) -> list[str]:
    """Names of its arguments; the one that collects the rest stands last."""
    return list(inspect.signature(function).parameters)
