"""Gymnasium: B teams as arrays, and one team as one agent. Arrays around a Simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .drawing.renderer import RENDER_MODES, Renderer, render_metadata
from .engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from .experiment.checks import choice, floats
from .experiment.scenario import Scenario
from .experiment.scenarios import ScenarioLike, resolve
from .experiment.seeding import seeds_of_teams
from .faces.infos import Info, of_first_team, start_info, step_info, summary_of
from .faces.spaces import team_action_box, team_observation_box
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
        **overrides: fields of the scenario to change.

    Raises:
        ValueError: for an unknown scenario, field or mode, or an impossible value.
    """
    if not isinstance(autoreset_mode, AutoresetMode):
        modes = [mode.value for mode in AutoresetMode]
        autoreset_mode = AutoresetMode(choice("autoreset_mode", autoreset_mode, modes))
    simulator = _simulator(resolve(scenario, **overrides), num_envs, num_threads, max_cycles)
    return RendezvousVectorEnv(simulator, autoreset_mode, render_mode)


def make_env(
    scenario: ScenarioLike = "fig3",
    max_cycles: int | None = None,
    render_mode: str | None = None,
    **overrides: Any,
) -> RendezvousEnv:
    """One team as one agent; arguments as ``make_vec``.

    Raises:
        ValueError: for an unknown scenario or field, or an impossible value.
    """
    simulator = _simulator(resolve(scenario, **overrides), 1, None, max_cycles)
    return RendezvousEnv(simulator, render_mode)


class RendezvousEnv(gymnasium.Env[Any, Any]):
    """One team of n robots as one agent.

    What a robot does, sees and earns is specified in ``rendezvous_v0``. Observations are (n, rows,
    d), actions (n, a), zero or ignored for robots that are gone; the reward is the team's.
    Terminated: all robots have met. Truncated: the time limit. Infos as ``RendezvousVectorEnv``,
    without the axis of teams and without masks. ``simulator`` holds the global state, B = 1.

    Args:
        simulator: a Simulator of one team.
        render_mode: "human", "rgb_array" or None, as in ``rendezvous_v0``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": RENDER_MODES
    }

    def __init__(self, simulator: Simulator, render_mode: str | None = None) -> None:
        self.simulator = simulator
        self.scenario = simulator.scenario
        self.renderer = Renderer(simulator, render_mode)
        self.render_mode = render_mode
        self.metadata = render_metadata(simulator)
        self.observation_space = team_observation_box(self.scenario)
        self.action_space = team_action_box(self.scenario)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin a new episode; without a seed the next one of the last seed.

        Raises:
            ValueError: for a bad option or seed; nothing has changed then.
        """
        seeds = seeds_of_teams(seed, 1)
        observations = self.simulator.reset(seeds, options)
        super().reset(seed=None if seeds is None else seeds[0])
        self.renderer.reset()
        return observations[0], of_first_team(start_info(self.simulator))

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Advance by one step τ.

        Raises:
            ValueError: for an action of the wrong shape, or that is not finite, naming the robot.
            RuntimeError: before the first reset.
        """
        outcome = self.simulator.step(floats("action", action, np.float32)[None])
        self.renderer.see(outcome.contact)
        status = int(outcome.status[0])
        info = of_first_team(step_info(self.simulator, outcome))
        if status != RUNNING:
            summary = summary_of(self.simulator)
            info["summary"] = {key: values[0].item() for key, values in summary.items()}
        reward = float(outcome.rewards[0])
        return outcome.observations[0], reward, status == RENDEZVOUS, status == TIME_OUT, info

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the team depends on, see ``Simulator``."""
        return self.simulator.get_state()

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put back what ``get_state`` took out of an environment of the same scenario.

        Raises:
            ValueError: for a missing, unknown or misshapen entry; nothing has changed then.
        """
        self.simulator.set_state(state)

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


def _simulator(
    scenario: Scenario,
    num_envs: int,
    num_threads: int | None,
    max_cycles: int | None,
) -> Simulator:
    simulator = Simulator(scenario, num_envs, num_threads=num_threads)
    if max_cycles is not None:
        simulator.set_max_steps(max_cycles)
    return simulator
