"""One team of a vector environment as an environment of Gymnasium: one agent moves all robots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from ..drawing.renderer import RENDER_MODES
from ..experiment.checks import floats
from ..experiment.seeding import seeds_of_teams
from ..simulator import Simulator
from .infos import Info, of_first_team


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
