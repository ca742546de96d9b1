"""Keyword arguments of factories: scenario fields, wrapper arguments, unknown ones."""

import inspect
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from enum import Enum
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from .. import graphs
from ..field_checks import known_fields
from ..obstacles import parsing as obstacles
from ..obstacles.fields import Field
from ..obstacles.obstacle_set import Obstacle
from ..scenario.scenario import Scenario

_FIELDS = sorted(field.name for field in fields(Scenario))


def check_overrides(
    factory: Callable[..., Any], given: Mapping[str, Any], of_wrapper: Collection[str] = ()
) -> None:
    """Raise a TypeError for an unknown keyword, with the closest known one."""
    known = [*of_wrapper, *arguments_of(factory)[:-1], *_FIELDS]
    known_fields(given, known, factory.__name__, "argument")


def sorted_overrides(
    factory: Callable[..., Any], of_wrapper: Collection[str], given: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split overrides into wrapper arguments and others; raises as ``check_overrides``.

    ``max_turn_rate`` is passed to the wrapper, which also respects the scenario's limit.
    """
    check_overrides(factory, given, of_wrapper)
    arguments = {key: value for key, value in given.items() if key in of_wrapper}
    return arguments, {key: given[key] for key in given if key not in of_wrapper}


def as_plain(value: Any) -> Any:
    """Argument of a factory as plain data that the factory accepts; other values unchanged.

    Scenarios and their parts, arrays, paths and enumerations become JSON values.
    """
    if callable(getattr(value, "to_plain", None)):
        return value.to_plain()
    if isinstance(value, Obstacle):
        return obstacles.to_plain((value,))[0]  # type: ignore[index]
    if isinstance(value, Field):
        return obstacles.to_plain(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {key: as_plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(each) for each in value]
    return value


class PlainSpec:
    """Mixin that stores the arguments in ``spec`` as plain data, for JSON."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Specification from which Gymnasium created the environment, or None."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            plain = as_plain(spec.kwargs)
            if not isinstance(plain.get("graph", ""), str | list | dict):
                plain["graph"] = graphs.parse(plain["graph"]).to_plain()
            spec = replace(spec, kwargs=plain)
        self._spec = spec


def arguments_of(function: Callable[..., Any]) -> list[str]:
    """Argument names of a function, with the variadic one last."""
    return list(inspect.signature(function).parameters)
