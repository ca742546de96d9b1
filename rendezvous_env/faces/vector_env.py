"""Many teams of one scenario as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..drawing.renderer import Renderer, render_metadata
from ..engine.memory import RENDEZVOUS, TIME_OUT
from ..experiment.checks import flag
from ..experiment.start_options import as_options
from ..outcome import Outcome
from ..simulator import Simulator
from .infos import Info, Transition, masked, of_all, start_info, step_info, summary_of
from .spaces import action_box, as_told, observation_box, state_box, team_box, team_state


class RendezvousVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """B teams of n robots that see only directions and must all meet.

    What a robot does, sees and earns is specified in ``rendezvous_v0``; here it stands in arrays,
    freshly allocated in every step.

    | array | shape | |
    |---|---|---|
    | observations | (B, n, rows, d) float32, or (B, n, rows·d) | zero for robots that are gone |
    | actions | (B, n, a) float32 | ignored for robots that are gone and teams that have ended |
    | rewards | (B,) float64 | of the team; bounds as in ``rendezvous_v0`` |
    | terminations | (B,) bool | all robots have met |
    | truncations | (B,) bool | the time limit |

    Infos, each with its mask ``_key`` (B,):

    | key | shape | |
    |---|---|---|
    | robot_rewards | (B, n) float64 | team reward of robots alive before the step, else 0 |
    | active | (B, n) bool | the robot still exists on its own |
    | merged_into | (B, n) int64 | the robot that each one is now part of; itself while active |
    | contact | (B, n) bool | touched an obstacle in this step |
    | clearance | (B, n) float64 | m to the nearest obstacle, inf without any |
    | success | (B,) bool | all robots of the team have met |
    | time | (B,) float64 | s since the start of the episode |
    | contacts | (B,) int64 | contacts so far, one for each robot and step |
    | path_length | (B,) float64 | way of all robots together so far, m |
    | lyapunov | (B,) float64 | V, m²/s |
    | summary | dict of (B,) | after an episode: the last five once more |

    A team that has ended, by ``autoreset_mode``:

    * NEXT_STEP: begins anew in the next step, which ignores its action and earns nothing;
    * SAME_STEP: begins anew at once; ``final_obs`` and ``final_info`` keep how it ended;
    * DISABLED: stands still, earns nothing and stays ended until ``reset(options={"reset_mask":
      (B,) bool})``.

    ``reset(seed=s)`` gives team i the seed s + i, a list gives each its own; without a seed every
    team goes on to the next episode of its own. Options as in ``rendezvous_v0``, one for all teams
    or with a leading axis B. ``simulator`` holds the global state for analysis.

    ``render()`` gives a picture for each team in "rgb_array" mode, as Gymnasium's ``RecordVideo``
    for vector environments wants it: parts of one picture of (600, 600, 3) uint8, in which the
    first 16 teams stand side by side, and which ``renderer.render()`` gives as a whole. Further
    teams are not drawn and have one blank part together, so that thousands cost no more than 16.

    Args:
        simulator: the teams.
        autoreset_mode: see above.
        render_mode: "human", "rgb_array" or None, as in ``rendezvous_v0``.
        flatten: whether a robot's rows stand one after another, as one vector.
    """

    def __init__(
        self,
        simulator: Simulator,
        autoreset_mode: AutoresetMode,
        render_mode: str | None = None,
        flatten: bool = False,
    ) -> None:
        self.simulator = simulator
        self.autoreset_mode = autoreset_mode
        self.scenario = simulator.scenario
        self.num_envs = simulator.num_envs
        self.renderer = Renderer(simulator, render_mode)
        self.render_mode = render_mode
        self.metadata = render_metadata(simulator) | {"autoreset_mode": autoreset_mode}
        self.flatten, n = flag("flatten", flatten), self.scenario.n_robots
        self.single_observation_space = team_box(observation_box(self.scenario, flatten), n)
        self.single_action_space = team_box(action_box(self.scenario), n)
        self.single_state_space = state_box(self.scenario)

    @cached_property
    def observation_space(self) -> Space[Any]:  # type: ignore[override]
        """Of all teams; made when asked for, since it is larger than the observations."""
        return batch_space(self.single_observation_space, self.num_envs)

    @cached_property
    def action_space(self) -> Space[Any]:  # type: ignore[override]
        """Of all teams."""
        return batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin a new episode in all teams, or in those of ``options["reset_mask"]``.

        Args:
            seed: see the class.
            options: given parts of the start, and "reset_mask" (B,) bool.

        Returns:
            Observations of all teams, and infos masked to those that were reset.

        Raises:
            ValueError: for a bad option, seed or mask; nothing has changed then.
        """
        start = as_options(options)
        mask = start.pop("reset_mask", None)
        observations = self.simulator.reset(seed, start, mask=mask)
        which = np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask)
        self.renderer.reset()
        return as_told(observations, self.flatten), masked(start_info(self.simulator), which)

    def step(self, actions: NDArray[np.float32]) -> Transition:
        """Advance every team by one step τ.

        Args:
            actions: (B, n, a).

        Returns:
            Observations, rewards, terminations, truncations and infos, see the class.

        Raises:
            ValueError: for actions of the wrong shape, or that are not finite, naming the robot;
                nothing has changed then.
            RuntimeError: before the first reset.
        """
        simulator, mode = self.simulator, self.autoreset_mode
        if mode is AutoresetMode.NEXT_STEP and not simulator.all_running:
            actions = simulator.check_actions(actions)  # before anybody begins anew
            simulator.restart(simulator.ended)
        outcome = simulator.step(actions)
        infos = step_info(simulator, outcome)
        if simulator.all_running:  # as after most steps
            terminations = np.zeros(self.num_envs, dtype=np.bool_)
            truncations = np.zeros(self.num_envs, dtype=np.bool_)
            infos = of_all(infos, self.num_envs)
        else:
            terminations, truncations = outcome.status == RENDEZVOUS, outcome.status == TIME_OUT
            ended = terminations | truncations
            if mode is AutoresetMode.SAME_STEP:
                infos = self._begin_anew(outcome, infos, ended)
            else:
                summary = {"summary": summary_of(infos, ended)}
                infos = of_all(infos, self.num_envs) | masked(summary, ended)
        self.renderer.see(outcome.contact)
        observations = as_told(outcome.observations, self.flatten)
        return observations, outcome.rewards, terminations, truncations, infos

    def _begin_anew(self, outcome: Outcome, infos: Info, ended: NDArray[np.bool_]) -> Info:
        """Infos of a step after which some teams have begun their next episode."""
        simulator = self.simulator
        final_obs = np.full(self.num_envs, None, dtype=object)
        for team in np.flatnonzero(ended).tolist():
            final_obs[team] = as_told(outcome.observations[team], self.flatten).copy()
        final_info = {key: values.copy() for key, values in infos.items()}
        final_info["summary"] = summary_of(infos, ended)
        simulator.restart(ended, outcome)
        infos |= {"merged_into": simulator.merged_into, **simulator.standing(outcome)}
        return of_all(infos, self.num_envs) | masked(
            {"final_obs": final_obs, "final_info": masked(final_info, ended)}, ended
        )

    def state(self) -> NDArray[np.float32]:
        """The privileged global state of every team, (B, …) float32, for centralised critics: a
        row of it is what ``rendezvous_v0`` gives, in ``single_state_space``.
        """
        return team_state(self.simulator)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the teams depends on, see ``Simulator``."""
        return self.simulator.get_state()

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put back what ``get_state`` took out of an environment of the same scenario and batch.

        Raises:
            ValueError: for a missing, unknown or misshapen entry; nothing has changed then.
        """
        self.simulator.set_state(state)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture for each team, (height, width, 3) uint8, in "rgb_array" mode; in "human" mode
        they are shown, side by side.

        Raises:
            RuntimeError: before the first reset, or where no window can be opened.
            ImportError: without the extra ``render``.
        """
        return self.renderer.pictures()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        self.renderer.close()
