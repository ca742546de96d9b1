"""HeadingVectorWrapper for PettingZoo: under it any policy keeps Theorem 2's guarantee."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from pettingzoo.utils.env import ParallelEnv
from pettingzoo.utils.wrappers import BaseParallelWrapper

from .experiment.checks import check_action
from .guarantee.steering import Steering
from .holding import check_period, restore
from .rendezvous_v0 import RendezvousParallelEnv
from .roster import Infos, Observations, StepReturn
from .spaces import heading_box, heading_observation_box


class HeadingVectorWrapper(BaseParallelWrapper):
    """Robots choose a heading vector h_i instead of an action; law (4) moves them.

        ṗ_i = h_i h_iᵀ f_i                                              (Zhao & Zheng, eq. 4)

    The raw vector of any policy becomes h_i by ``certified_heading`` (theorem C), so that without
    obstacles all robots meet within the certificate's time bound whatever the policy does.
    Velocities are scaled by r/(2 D_i τ) where the step is longer than certified (theory 4).
    Nonholonomic robots choose turn rates through the gate of theory 3 and drive with v = mᵀf.

    ## Action space

    ``Box(−1, 1, (d,))``, a raw vector in the frame that is observed; its length does not count. For
    nonholonomic robots ``Box(−1, 1, (1,))`` or ``(2,)``: turn rates in units of ``max_turn_rate``.

    ## Observation space

    The rows of the base environment. With ``frame="net_bearing"`` (single integrators) in a frame
    whose x axis is along f_i, so that any network is rotation-equivariant: exactly in 2-D; in 3-D
    the second axis comes from the row with the longest part across f_i. While ‖f_i‖ < δ the last
    frame is kept.

    ## Infos

    Those of the base environment, and ``alignment`` = |h_iᵀf_i|/‖f_i‖ (NaN where f_i = 0) and
    ``lyapunov_rate`` = −2 (h_iᵀf_i)², both of the last base step.

    Args:
        env: a rendezvous parallel environment.
        min_alignment: ε, in (0, 1).
        max_turn_rate: ω_max, rad/s; for nonholonomic robots the scenario's limit holds too.
        frame: "net_bearing" or "local".
        decision_period: base steps for which a raw vector is held; the certified heading follows
            f_i in each. Rewards are summed, and a robot that merges on the way ends with its
            last observation.
        certified: False lets the raw vector through as h_i, without any guarantee.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
    ) -> None:
        ours = isinstance(env, ParallelEnv) and isinstance(env.unwrapped, RendezvousParallelEnv)
        if not ours:
            raise TypeError(
                f"env is a {type(env).__name__}; it must be a PettingZoo parallel environment "
                "that parallel_env has made (for a vector environment take "
                "rendezvous_env.vector.HeadingVectorWrapper)"
            )
        super().__init__(env)
        self.decision_period = check_period(decision_period)
        self._base: RendezvousParallelEnv = env.unwrapped
        scenario = self._base.scenario
        self.steering = Steering(
            scenario,
            1,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
        )
        names = self._base.possible_agents
        self.observation_spaces = {
            name: heading_observation_box(scenario, self.steering) for name in names
        }
        self.action_spaces = {name: heading_box(self.steering) for name in names}
        shape = (1, scenario.n_robots, *scenario.observation_layout.shape)
        self._observed = np.zeros(shape, dtype=np.float32)

    @property
    def max_cycles(self) -> int:
        """Time limit in steps of the base environment; may be set at any time."""
        return self._base.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self._base.max_cycles = value

    def observation_space(self, agent: str) -> Box:
        """The space of one robot's observations; the same object each time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The space of one robot's raw vectors; the same object each time."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode; headings of the last one are forgotten."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.steering.forget()
        self._remember(observations)
        return self._view(observations), infos

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Hold the raw vectors for ``decision_period`` base steps.

        Args:
            actions: one raw vector for each robot in ``agents``.

        Returns:
            As the base environment, for the robots that were alive at the start.

        Raises:
            KeyError: for a missing, unknown or merged-away robot; nothing has changed then.
            ValueError: for a vector of the wrong shape, or one that is not finite; likewise.
        """
        if not self.agents and isinstance(actions, Mapping) and not actions:
            return {}, {}, {}, {}, {}
        self._base.check_robots(actions)
        size = self.steering.action_size
        for name, action in actions.items():
            check_action(name, action, size)
        raw = np.zeros((1, self._base.scenario.n_robots, size))
        for name, action in actions.items():
            raw[0, self._base.index(name)] = action
        self.steering.hold(raw)
        return self._drive()

    def _drive(self) -> StepReturn:
        """Base steps under the held vectors, gathered into one."""
        observations: Observations = {}
        rewards: dict[str, float] = dict.fromkeys(self.agents, 0.0)
        terminations: dict[str, bool] = {}
        truncations: dict[str, bool] = {}
        infos: Infos = {}
        for _ in range(self.decision_period):
            actions = self.steering.act(self._observed)[0]
            table = {name: actions[self._base.index(name)] for name in self.agents}
            seen, earned, ended, cut, told = self.env.step(table)
            for name, info in told.items():
                i = self._base.index(name)
                info["alignment"] = float(self.steering.alignment[0, i])
                info["lyapunov_rate"] = float(self.steering.lyapunov_rate[0, i])
                rewards[name] += earned[name]
            infos |= told
            terminations |= ended
            truncations |= cut
            observations |= seen
            self._remember(seen)
            if not self.agents:
                break
        return self._view(observations), rewards, terminations, truncations, infos

    def _remember(self, observations: Observations) -> None:
        """Note what the robots see now; those that are gone see nothing."""
        self._observed = np.zeros(self._observed.shape, dtype=np.float32)
        for name, rows in observations.items():
            self._observed[0, self._base.index(name)] = rows

    def _view(self, observations: Observations) -> Observations:
        """What the robots see, as the policy is shown it."""
        seen = self.steering.view(self._observed)[0]
        return {name: seen[self._base.index(name)].copy() for name in observations}

    def get_state(self) -> dict[str, Any]:
        """The running episode and the wrapper's memory, as copies."""
        return {
            "env": self._base.get_state(),
            "steering": self.steering.get_state(),
            "observed": self._observed.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        self._observed = restore(self._base, self.steering, self._observed.shape, state)
