"""Gymnasium: B teams as arrays, and one team as one agent, made from a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from ..checks import choice, floats
from ..render.renderer import RENDER_MODES
from ..scenario.scenario import Scenario
from ..scenario.scenarios import ScenarioLike, resolve
from ..scenario.start_options import seeds_of_teams
from ..simulator import Simulator
from .overrides import check_overrides, sorted_overrides
from .vector_env import Info, RendezvousVectorEnv, of_first_team
from .vector_wrappers import HeadingVectorWrapper

__all__ = [
    "RendezvousEnv",
    "RendezvousVectorEnv",
    "make_env",
    "make_heading_env",
    "make_heading_vec",
    "make_vec",
]


class RendezvousEnv(gymnasium.Env[Any, Any]):
    """One team of n robots as one agent.

    What a robot does, sees and earns is specified in ``rendezvous_v0``. Observations are (n, rows,
    d), actions (n, a), zero or ignored for robots that are gone; the reward is the team's, its
    bounds stand there. Terminated: all robots have met. Truncated: the time limit. Infos as
    ``RendezvousVectorEnv``, without the axis of teams and without masks. ``simulator`` holds the
    global state, B = 1. Where the vector environment is wrapped, all is as the wrapper has it.

    Args:
        teams: a vector environment of one team that does not begin anew by itself.

    Raises:
        ValueError: for more teams, or another autoreset mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": RENDER_MODES
    }

    def __init__(self, teams: VectorEnv[Any, Any, Any]) -> None:
        mode = teams.metadata.get("autoreset_mode")
        if teams.num_envs != 1 or mode is not AutoresetMode.DISABLED:
            raise ValueError(
                f"teams are {teams.num_envs} with autoreset_mode {mode}; it must be one team, and "
                "AutoresetMode.DISABLED"
            )
        self.teams: Any = teams  # wrapped or not: the state is not of Gymnasium's interface
        base: Any = teams.unwrapped
        self.simulator: Simulator = base.simulator
        self.scenario, self.renderer = self.simulator.scenario, base.renderer
        self.render_mode = base.render_mode
        self.metadata = {k: v for k, v in teams.metadata.items() if k != "autoreset_mode"}
        self.observation_space = teams.single_observation_space
        self.action_space = teams.single_action_space

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin a new episode; without a seed the next one of the last seed.

        Raises:
            ValueError: for a bad option or seed; nothing has changed then.
        """
        seeds = seeds_of_teams(seed, 1)
        observations, infos = self.teams.reset(seed=seeds, options=options)
        super().reset(seed=None if seeds is None else seeds[0])
        return observations[0], of_first_team(infos)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Advance by one step τ.

        Raises:
            ValueError: for an action of the wrong shape, or that is not finite, naming the robot.
            RuntimeError: before the first reset.
        """
        table = floats("action", action, np.float32)[None]
        observations, rewards, ends, cuts, infos = self.teams.step(table)
        ended = bool(ends[0]), bool(cuts[0])
        return observations[0], float(rewards[0]), *ended, of_first_team(infos)

    def state(self) -> NDArray[np.float32]:
        """The privileged global state, one float32 vector, as ``rendezvous_v0`` gives it."""
        state: NDArray[np.float32] = self.teams.state()[0]
        return state

    def get_state(self) -> dict[str, Any]:
        """Everything that the future of the team depends on, as copies."""
        state: dict[str, Any] = self.teams.get_state()
        return state

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out of an environment of the same scenario.

        Raises:
            ValueError: for a missing, unknown or misshapen entry; nothing has changed then.
        """
        self.teams.set_state(state)

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, (600, 600, 3) uint8, in "rgb_array" mode; in "human" mode it is shown.

        Raises:
            RuntimeError: before the first reset, or where no window can be opened.
            ImportError: without the extra ``render``.
        """
        return self.renderer.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


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
    mode = _autoreset_mode(autoreset_mode)
    simulator = Simulator(resolve(scenario, **overrides), num_envs, num_threads=num_threads)
    if max_cycles is not None:
        simulator.set_max_steps(max_cycles)
    return RendezvousVectorEnv(simulator, mode, render_mode, flatten)


def _autoreset_mode(given: AutoresetMode | str) -> AutoresetMode:
    """The mode of this name or value, as Gymnasium spells them: "SAME_STEP", "same_step",
    "SameStep".
    """
    if isinstance(given, AutoresetMode):
        return given
    spelled = given.replace("_", "").lower() if isinstance(given, str) else ""
    for mode in AutoresetMode:
        if spelled == mode.name.replace("_", "").lower():
            return mode
    choice("autoreset_mode", given, [mode.value for mode in AutoresetMode])
    raise AssertionError(given)


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


def register() -> None:
    """Register ``rendezvous/Rendezvous-v0`` and, with certified headings,
    ``rendezvous/RendezvousHeading-v0`` in Gymnasium, once; time is ours, so without
    ``max_episode_steps``.
    """
    module = __name__
    for name, one, many in (
        ("rendezvous/Rendezvous-v0", "make_env", "make_vec"),
        ("rendezvous/RendezvousHeading-v0", "make_heading_env", "make_heading_vec"),
    ):
        if name not in gymnasium.registry:
            gymnasium.register(
                name, entry_point=f"{module}:{one}", vector_entry_point=f"{module}:{many}"
            )
