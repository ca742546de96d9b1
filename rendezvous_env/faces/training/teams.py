"""Teams for generic learners: robots that stay to the end, and numbers that are always there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from ...engine.state_checks import check_entries, check_keys
from ...experiment.scenario import Scenario
from ...experiment.start_options import as_options
from ...simulator import Simulator
from ..infos import Info, Transition
from ..vector_env import RendezvousVectorEnv
from ..vector_filter_wrapper import VectorFilterWrapper
from .touches import FirstTouches


class TrainingTeams(gymnasium.vector.VectorWrapper):
    """B teams whose robots all act, earn and are told something until their episode ends.

    ``training_env`` says what they see and do. Robots that have merged away observe zeros; what
    they are told to do is ignored, and they earn with their team.

    | array | shape | |
    |---|---|---|
    | rewards | (B,) float64 | mean of what the team's robots earn |
    | infos["robot_rewards"] | (B, n) float64 | the team's, less ``touch_penalty`` once touched |
    | infos["active"] | (B, n) bool | the robot still exists on its own |

    A reward is bounded as in ``rendezvous_v0``, less ``touch_penalty`` in one step of an episode.

    The other infos are those of ``RendezvousVectorEnv`` and of the guarantee's wrapper: the same
    keys in every step, numbers all of them. ``final_obs`` and ``final_info`` come only with
    SAME_STEP.

    Args:
        teams: whose scenario has ``on_merge="follow"``.
        touch_penalty: taken from ``robot_rewards``, once in an episode.
    """

    env: RendezvousVectorEnv | VectorFilterWrapper

    def __init__(
        self, teams: RendezvousVectorEnv | VectorFilterWrapper, touch_penalty: float = 0.0
    ) -> None:
        super().__init__(teams)
        self.touch_penalty = touch_penalty
        self._touches = FirstTouches(teams.num_envs, self.scenario.n_robots)

    @property
    def simulator(self) -> Simulator:
        """The global state of the teams, for analysis."""
        return self.teams.simulator

    @property
    def scenario(self) -> Scenario:
        """What is simulated."""
        return self.teams.scenario

    @property
    def layout(self) -> Any:
        """What takes observations apart (``split``): of the scenario, or of ``Perception``."""
        return getattr(self.env, "layout", self.scenario.observation_layout)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When a team that has ended begins anew."""
        return self.env.autoreset_mode

    @property
    def teams(self) -> RendezvousVectorEnv:
        """The vector environment itself."""
        base = self.env.unwrapped
        assert isinstance(base, RendezvousVectorEnv)
        return base

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin anew, as ``RendezvousVectorEnv.reset``."""
        observations, infos = self.env.reset(seed=seed, options=options)
        which = as_options(options).get("reset_mask")
        self._touches.forget(None if which is None else np.asarray(which))
        return observations, infos

    def step(self, actions: ArrayLike) -> Transition:
        """Let all robots act, as the wrapper of the guarantee has it.

        Raises:
            ValueError: for actions of another shape, or naming the robot whose action is none;
                nothing has changed then.
            RuntimeError: before the first reset.
        """
        seen, rewards, ends, cuts, infos = self.env.step(actions)  # type: ignore[arg-type]
        first = self._touches.note(infos, ends | cuts)
        if first.any():
            infos["robot_rewards"] -= self.touch_penalty * first
            rewards = infos["robot_rewards"].mean(axis=1)
        if "final_info" in infos:
            infos["final_info"]["robot_rewards"] = infos["robot_rewards"].copy()
            _leave_out_summary(infos["final_info"])
        _leave_out_summary(infos)
        return seen, rewards, ends, cuts, infos

    def state(self) -> NDArray[np.float32]:
        """The privileged global state of every team, (B, …), as ``RendezvousVectorEnv.state``."""
        return self.teams.state()

    def get_state(self) -> dict[str, Any]:
        """The running episodes and all memory, as copies."""
        return {"env": self.env.get_state(), "touched": self._touches.touched.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        check_keys(state, ("env", "touched"))
        touched = check_entries({"touched": self._touches.touched}, state)["touched"]
        self.env.set_state(state["env"])
        self._touches.touched[...] = touched


def _leave_out_summary(infos: Info) -> None:
    """It is there at the end only, and its numbers stand among the others."""
    infos.pop("summary", None)
    infos.pop("_summary", None)
