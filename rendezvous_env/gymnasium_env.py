"""Gymnasium: the doors to B teams as arrays, and to one team as one agent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from .experiment.checks import choice
from .experiment.scenario import Scenario
from .experiment.scenarios import ScenarioLike, resolve
from .faces.one_team import RendezvousEnv
from .faces.vector_env import RendezvousVectorEnv
from .simulator import Simulator

__all__ = ["RendezvousEnv", "RendezvousVectorEnv", "make_env", "make_vec"]


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
        ValueError: for an unknown scenario, field or mode, or an impossible value.
    """
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
        ValueError: for an unknown scenario or field, or an impossible value.
    """
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
