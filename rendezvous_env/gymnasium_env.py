"""Gymnasium: B teams as arrays, and one team as one agent. Arrays around a Simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .drawing.renderer import RENDER_MODES, Renderer, render_metadata
from .engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from .experiment.checks import choice, floats
from .experiment.scenario import Scenario
from .experiment.scenarios import resolve
from .experiment.seeding import seeds_of_teams
from .experiment.start_options import as_options
from .outcome import Outcome
from .rendezvous_v0 import ScenarioLike
from .simulator import Simulator
from .spaces import team_action_box, team_observation_box

Info = dict[str, Any]
Transition = tuple[
    NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info
]


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


class RendezvousVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """B teams of n robots that see only directions and must all meet.

    What a robot does, sees and earns is specified in ``rendezvous_v0``; here it stands in arrays,
    freshly allocated in every step.

    | array | shape | |
    |---|---|---|
    | observations | (B, n, rows, d) float32 | zero for robots that are gone |
    | actions | (B, n, a) float32 | ignored for robots that are gone and teams that have ended |
    | rewards | (B,) float64 | of the team |
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
    | summary | dict of (B,) | after an episode: success, time, contacts, path_length, lyapunov |

    A team that has ended, by ``autoreset_mode``:

    * NEXT_STEP: begins anew in the next step, which ignores its action and earns nothing;
    * SAME_STEP: begins anew at once; ``final_obs`` and ``final_info`` keep how it ended;
    * DISABLED: stands still, earns nothing and stays ended until ``reset(options={"reset_mask":
      (B,) bool})``.

    ``reset(seed=s)`` gives team i the seed s + i, a list gives each its own; without a seed every
    team goes on to the next episode of its own. Options as in ``rendezvous_v0``, one for all teams
    or with a leading axis B. ``simulator`` holds the global state for analysis.

    ``render()`` draws the first 16 teams side by side in one picture, in "rgb_array" mode an array
    (600, 600, 3) uint8. It is one picture and no tuple with one for each team, as Gymnasium's own
    vector environments give: thousands of teams are drawn at the cost of one.

    Args:
        simulator: the teams.
        autoreset_mode: see above.
        render_mode: "human", "rgb_array" or None, as in ``rendezvous_v0``.
    """

    def __init__(
        self,
        simulator: Simulator,
        autoreset_mode: AutoresetMode,
        render_mode: str | None = None,
    ) -> None:
        self.simulator = simulator
        self.autoreset_mode = autoreset_mode
        self.scenario = simulator.scenario
        self.num_envs = simulator.num_envs
        self.renderer = Renderer(simulator, render_mode)
        self.render_mode = render_mode
        self.metadata = render_metadata(simulator) | {"autoreset_mode": autoreset_mode}
        self.single_observation_space = team_observation_box(self.scenario)
        self.single_action_space = team_action_box(self.scenario)

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
        return observations, masked(_start_info(self.simulator), which)

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
            terminations, truncations = np.zeros((2, self.num_envs), dtype=np.bool_)
            infos = of_all(infos, self.num_envs)
        else:
            terminations, truncations = outcome.status == RENDEZVOUS, outcome.status == TIME_OUT
            ended = terminations | truncations
            if mode is AutoresetMode.SAME_STEP:
                infos = self._begin_anew(outcome, infos, ended)
            else:
                infos = of_all(infos, self.num_envs)
                infos |= masked({"summary": masked(summary_of(simulator), ended)}, ended)
        self.renderer.see(outcome.contact)
        return outcome.observations, outcome.rewards, terminations, truncations, infos

    def _begin_anew(self, outcome: Outcome, infos: Info, ended: NDArray[np.bool_]) -> Info:
        """Infos of a step after which some teams have begun their next episode."""
        simulator = self.simulator
        final_obs = np.full(self.num_envs, None, dtype=object)
        for team in np.flatnonzero(ended).tolist():
            final_obs[team] = outcome.observations[team].copy()
        final_info = {key: values.copy() for key, values in infos.items()}
        final_info["summary"] = masked(summary_of(simulator), ended)
        simulator.restart(ended, outcome)
        infos["merged_into"] = simulator.merged_into
        return of_all(infos, self.num_envs) | masked(
            {"final_obs": final_obs, "final_info": masked(final_info, ended)}, ended
        )

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the teams depends on, see ``Simulator``."""
        return self.simulator.get_state()

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put back what ``get_state`` took out of an environment of the same scenario and batch.

        Raises:
            ValueError: for a missing, unknown or misshapen entry; nothing has changed then.
        """
        self.simulator.set_state(state)

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """One picture of the first teams, (600, 600, 3) uint8, in "rgb_array" mode; in "human"
        mode it is shown.

        Raises:
            RuntimeError: before the first reset, or where no window can be opened.
            ImportError: without the extra ``render``.
        """
        return self.renderer.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


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
            TypeError: for a seed that is no whole number; likewise.
        """
        seeds = seeds_of_teams(seed, 1)
        observations = self.simulator.reset(seeds, options)
        super().reset(seed=None if seeds is None else seeds[0])
        self.renderer.reset()
        return observations[0], _of_first_team(_start_info(self.simulator))

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
        info = _of_first_team(step_info(self.simulator, outcome))
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


def _start_info(simulator: Simulator) -> Info:
    """Infos of all teams at the start of an episode, without masks."""
    active = simulator.active
    return {
        "robot_rewards": np.zeros(active.shape),
        "active": active,
        "merged_into": simulator.merged_into,
        "contact": np.zeros(active.shape, dtype=np.bool_),
        "clearance": simulator.clearance,
    }


def step_info(simulator: Simulator, outcome: Outcome) -> Info:
    """Infos of all teams after a step, without masks."""
    return {
        "robot_rewards": outcome.robot_rewards,
        "active": outcome.active,
        "merged_into": simulator.merged_into,
        "contact": outcome.contact,
        "clearance": outcome.clearance,
    }


def summary_of(simulator: Simulator) -> Info:
    """How the teams stand at the end of an episode, (B,) each: s, m, m²/s."""
    return {
        "success": simulator.status == RENDEZVOUS,
        "time": simulator.time,
        "contacts": simulator.contacts,
        "path_length": simulator.path_length,
        "lyapunov": simulator.lyapunov(),
    }


def of_all(infos: Info, num_envs: int) -> Info:
    """Infos that every team has, in Gymnasium's form."""
    return _with_masks(infos, np.ones((len(infos), num_envs), dtype=np.bool_))


def masked(infos: Info, mask: NDArray[np.bool_]) -> Info:
    """Infos of the teams of a mask, in Gymnasium's form."""
    return _with_masks(infos, np.repeat(mask[None], len(infos), axis=0))


def _with_masks(infos: Info, masks: NDArray[np.bool_]) -> Info:
    """To every key a mask ``_key`` of its own."""
    return infos | {f"_{key}": own for key, own in zip(infos, masks, strict=True)}


def _of_first_team(infos: Info) -> Info:
    return {key: values[0] for key, values in infos.items()}
