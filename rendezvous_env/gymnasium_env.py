"""Gymnasium: the doors to B teams as arrays, and to one team as one agent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from .experiment.checks import choice
from .experiment.scenario import Scenario
from .experiment.scenarios import ScenarioLike, resolve
from .faces.one_team import RendezvousEnv
from .faces.overrides import check_overrides, sorted_overrides
from .faces.vector_env import RendezvousVectorEnv
from .faces.vector_wrappers import HeadingVectorWrapper
from .simulator import Simulator

__all__ = [
    "RendezvousEnv",
    "RendezvousVectorEnv",
    "make_env",
    "make_heading_env",
    "make_heading_vec",
    "make_vec",
]


def make_vec(
    scenario: ScenarioLike = "fig3",
    num_envs: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    num_threads: int | None = None,
    max_cycles: int | None = None,
    render_mode: str | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> RendezvousVectorEnv:
    """Many teams of one scenario as one vector environment.

    Args:
        scenario: a Scenario, the name of one (``scenarios.names()``) or the path of a TOML file.
        num_envs: B, number of teams.
        autoreset_mode: when a team that has ended begins anew; see ``RendezvousVectorEnv``.
        num_threads: most threads a step may use; None is one for each core.
        max_cycles: time limit in steps, instead of the scenario's.
        render_mode: "human" for a window, "rgb_array" for pictures, None for neither.
        flatten: whether observations are (B, n, rows·d), row by row, for libraries that take no
            tables; ``scenario.observation_layout.split`` reads both.
        **overrides: fields of the scenario to change.

    Raises:
        TypeError: for an unknown argument or field, with the nearest known one.
        ValueError: for an unknown scenario or mode, or an impossible value.
    """
    check_overrides(make_vec, overrides)
    if not isinstance(autoreset_mode, AutoresetMode):
        modes = [mode.value for mode in AutoresetMode]
        autoreset_mode = AutoresetMode(choice("autoreset_mode", autoreset_mode, modes))
    simulator = Simulator(resolve(scenario, **overrides), num_envs, num_threads=num_threads)
    if max_cycles is not None:
        simulator.set_max_steps(max_cycles)
    return RendezvousVectorEnv(simulator, autoreset_mode, render_mode, flatten)


def make_env(
    scenario: ScenarioLike = "fig3",
    max_cycles: int | None = None,
    render_mode: str | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> RendezvousEnv:
    """One team as one agent; arguments as ``make_vec``.

    Raises:
        TypeError: for an unknown argument or field, with the nearest known one.
        ValueError: for an unknown scenario, or an impossible value.
    """
    check_overrides(make_env, overrides)
    mode = AutoresetMode.DISABLED
    return RendezvousEnv(
        make_vec(scenario, 1, mode, None, max_cycles, render_mode, flatten, **overrides)
    )


def env_from_plain(scenario: Mapping[str, Any], render_mode: str | None = None) -> RendezvousEnv:
    """One team of a scenario in plain data, as specs of environments hold it.

    Args:
        scenario: what ``Scenario.to_plain`` gave.
        render_mode: as ``make_vec``.

    Raises:
        ValueError: for an unknown key or an impossible value.
    """
    return make_env(Scenario.from_plain(scenario), render_mode=render_mode)


def make_heading_vec(
    scenario: ScenarioLike = "fig3",
    num_envs: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    num_threads: int | None = None,
    max_cycles: int | None = None,
    render_mode: str | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> HeadingVectorWrapper:
    """Many teams that choose heading vectors: ``make_vec`` in the vector HeadingVectorWrapper.

    Args:
        scenario: this and the next six as in ``make_vec``.
        num_envs: B.
        autoreset_mode: when a team that has ended begins anew.
        num_threads: most threads a step may use.
        max_cycles: time limit in base steps.
        render_mode: "human", "rgb_array" or None.
        flatten: whether observations are (B, n, rows·d).
        **overrides: arguments of the wrapper, and fields of the scenario; ``max_turn_rate`` is the
            wrapper's.

    Raises:
        TypeError: for an unknown argument or field, with the nearest known one.
        ValueError: naming an argument, its value and what would be right.
    """
    arguments, changes = sorted_overrides(make_heading_vec, HeadingVectorWrapper, overrides)
    teams = make_vec(
        scenario,
        num_envs,
        autoreset_mode,
        num_threads,
        max_cycles,
        render_mode,
        flatten,
        **changes,
    )
    return HeadingVectorWrapper(teams, **arguments)


def make_heading_env(
    scenario: ScenarioLike = "fig3",
    max_cycles: int | None = None,
    render_mode: str | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> RendezvousEnv:
    """One team as one agent that chooses all heading vectors; arguments as ``make_heading_vec``.

    Raises:
        TypeError: for an unknown argument or field, with the nearest known one.
        ValueError: naming an argument, its value and what would be right.
    """
    mode = AutoresetMode.DISABLED
    return RendezvousEnv(
        make_heading_vec(scenario, 1, mode, None, max_cycles, render_mode, flatten, **overrides)
    )
