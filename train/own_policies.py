"""Policies that a user names as ``module:function``; the function takes a scenario."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from baselines.policy import file_of
from rendezvous_env.experiment.checks import nearest_word, shown
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Policy, begin

from .errors import UserError


def is_own(name: str) -> bool:
    """Whether a name is meant as ``module:function``."""
    return ":" in name and not name.startswith("learned:")


def find(name: str) -> Callable[[Scenario], Policy | None]:
    """The function of a name; its module may lie in the current folder.

    Raises:
        UserError: naming the module or the function that there is not, or what importing it raised.
    """
    module_name, _, function_name = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), function_name)):
        raise UserError(f"policy {name!r}: write MODULE:FUNCTION, as in my_policies:make")
    module = _imported(name, module_name)
    function = getattr(module, function_name, None)
    place = getattr(module, "__file__", None) or "built in"
    if function is None:
        near = nearest_word(function_name, [key for key in vars(module) if key[0] != "_"])
        hint = f"; did you mean {near!r}?" if near else ""
        raise UserError(f"policy {name!r}: {module_name} ({place}) has no {function_name!r}{hint}")
    if not callable(function):
        raise UserError(
            f"policy {name!r}: {function_name} in {module_name} is {shown(function)}; it must be a "
            "function of a scenario that gives a policy"
        )
    return function


def make(name: str, scenario: Scenario) -> Policy | None:
    """What the function gives for a scenario; None if that does not fit it.

    Raises:
        UserError: for an unknown name, what the function raised, or something that is no policy.
    """
    function = find(name)
    try:
        policy = function(scenario)
    except Exception as error:  # whatever a user's code may raise
        raise UserError(
            f"policy {name!r} for scenario {scenario.name!r}: {type(error).__name__}: {error}"
        ) from error
    if policy is not None and (not callable(policy) or inspect.isclass(policy)):
        raise UserError(
            f"policy {name!r} gave {shown(policy)} for scenario {scenario.name!r}; it must give a "
            "function of observations (..., n, rows, d) and time, or None where it does not fit"
        )
    return policy


def fits(name: str, scenario: Scenario) -> bool:
    """Whether it steers the robots of a scenario, for which it is tried for one step.

    Raises:
        UserError: as ``make``; also for what it raised, or actions that no robot can execute.
    """
    if (policy := make(name, scenario)) is None:
        return False
    simulator = Simulator(scenario, 1)
    observations = simulator.reset(0)
    try:
        begin(policy, simulator)
        simulator.step(np.asarray(policy(observations, simulator.time)))
    except Exception as error:  # whatever a user's code may raise
        raise UserError(
            f"policy {name!r} in the first step of scenario {scenario.name!r}: "
            f"{type(error).__name__}: {error}"
        ) from error
    return True


def source_file(name: str) -> Path | None:
    """The file in which the function is written, or its module if that cannot be told."""
    if found := file_of(find(name)):
        return found
    module = sys.modules[name.partition(":")[0]]
    return Path(module.__file__) if getattr(module, "__file__", None) else None


def _imported(name: str, module: str) -> Any:
    here = os.getcwd()
    if here not in sys.path:  # at the end: no file there may stand in for a module of others
        sys.path.append(here)
        importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{module}.".startswith(f"{error.name}."):
            raise UserError(
                f"policy {name!r}: there is no module {error.name!r}, neither installed nor as "
                f"{error.name.replace('.', '/')}.py in {here}"
            ) from error
        raise UserError(f"policy {name!r}: importing {module} failed: {error}") from error
    except Exception as error:  # whatever a user's module may raise
        raise UserError(
            f"policy {name!r}: importing {module} failed: {type(error).__name__}: {error}"
        ) from error
