"""Robots as the slots of a stable-baselines3 VecEnv: one network, every robot a sample."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from ..engine.state_checks import check_entries, check_keys
from ..gymnasium_env import make_vec
from ..simulator import Simulator
from ..team_readings import STANDING
from .slots import last_moments, of_one_robot, team_options

if TYPE_CHECKING:
    from ..experiment.scenarios import ScenarioLike

Indices = int | Iterable[int] | None


def make_robots(scenario: ScenarioLike, num_teams: int, **arguments: Any) -> RobotVecEnv:
    """The robots of many teams as slots; arguments as ``rendezvous_env.make_vec``."""
    return RobotVecEnv(
        make_vec(scenario, num_teams, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
    )


class RobotVecEnv(VecEnv):
    """B teams of n robots as B·n slots; slot = team · n + robot.

    A team begins anew in the step in which it ends. Rendezvous is a true end. A time-out and a
    merge are none: the slot's info has ``TimeLimit.truncated`` True, and
    ``terminal_observation`` is the robot's own last observation at a time-out and its survivor's
    at a merge, so that meeting early is not punished. The slot of a merged-away robot observes
    zeros until its team begins anew; ``acted`` leaves these slots out, and so does
    ``RobotRolloutBuffer``.

    The info of robot 0, which outlives all others, carries the statistics of its team at the end of
    an episode: ``episode`` with "r" (sum of team rewards), "l" (steps), "t" (s since the start of
    this object) and the summary, and ``is_success``.

    ``seed(s)`` gives team b the seed s + b at the next reset; ``set_options`` gives start options,
    one dict for all, or one for each slot, of which a team takes that of its robot 0.

    Args:
        teams: a vector environment of teams with SAME_STEP autoreset, wrapped or not.

    Raises:
        ValueError: for another autoreset mode.
    """

    acted: NDArray[np.bool_]
    """(slots,), whose robot took part in the last step; what is added to a buffer after it."""
    ended: NDArray[np.bool_]
    """(slots,), whose episode the last step ended, in whatever way."""
    bootstrapped: NDArray[np.int64]
    """(k,), slots that the last step cut off at a time-out or a merge."""
    survivors: NDArray[np.int64]
    """(k,), slots of the robots that each of them is now part of; its own at a time-out."""
    bootstrap_observations: NDArray[np.float32]
    """(k, rows, d), or as the teams' space is; what the value of these slots' future is estimated
    from."""
    tell_bootstraps: bool
    """Whether infos carry ``terminal_observation`` and ``TimeLimit.truncated``."""

    def __init__(self, teams: VectorEnv[Any, Any, Any]) -> None:
        mode = teams.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; robots need AutoresetMode.SAME_STEP")
        self.teams: Any = teams  # wrapped or not: the state is not of Gymnasium's interface
        self.tell_bootstraps = True
        spaces: tuple[Any, ...] = teams.single_observation_space, teams.single_action_space
        self._observed: tuple[int, ...] = (teams.num_envs, *spaces[0].shape)
        self._acting: tuple[int, ...] = (teams.num_envs, *spaces[1].shape)
        batch, n = self._observed[:2]
        self._started = time.time()
        self._active = np.zeros((batch, n), dtype=np.bool_)
        self._returns, self._lengths = np.zeros(batch), np.zeros(batch, dtype=np.int64)
        self._forget_step()
        super().__init__(batch * n, *map(of_one_robot, spaces))

    @property
    def n_robots(self) -> int:
        """Robots in a team, n."""
        return int(self._observed[1])

    @property
    def simulator(self) -> Simulator:
        """The teams' simulator, for analysis."""
        return self.teams.unwrapped.simulator

    # ---- episodes -----------------------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        """Begin a new episode in all teams; observations (slots, rows, d)."""
        seeds = self._seeds[:: self.n_robots]
        given = None if all(seed is None for seed in seeds) else seeds
        options = team_options(self._options[:: self.n_robots])
        observations, infos = self.teams.reset(seed=given, options=options)
        self._active = infos["active"].copy()
        self._returns[:], self._lengths[:] = 0.0, 0
        self._forget_step()
        self._reset_seeds()
        self._reset_options()
        return self._by_slot(observations)

    def _forget_step(self) -> None:
        self.acted = self._active.reshape(-1).copy()
        self.ended = np.zeros(self._active.size, dtype=np.bool_)
        self.bootstrapped = self.survivors = np.empty(0, dtype=np.int64)
        self.bootstrap_observations = np.empty((0, *self._observed[2:]), dtype=np.float32)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions (slots, a) of the next step."""
        self._actions = np.array(actions, dtype=self.action_space.dtype).reshape(self._acting)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance every team; observations, rewards, dones and infos of the slots."""
        observations, rewards, met, cut, infos = self.teams.step(self._actions)
        over = met | cut
        last, active, into = last_moments(observations, infos, over)
        merged = self._active & ~active
        truncated = (merged | (active & cut[:, None])) & ~met[:, None]
        self._note_bootstraps(truncated, into, last)
        self.acted = self._active.reshape(-1).copy()
        self._active = infos["active"].copy()
        self._returns += rewards
        self._lengths += 1
        told = self._infos(over, last, infos)
        self.ended = (merged | over[:, None]).reshape(-1)
        earned = infos["robot_rewards"].astype(np.float32).reshape(-1)
        return self._by_slot(observations), earned, self.ended.copy(), told

    def _note_bootstraps(
        self,
        truncated: NDArray[np.bool_],
        into: NDArray[np.int64],
        last: NDArray[np.float32],
    ) -> None:
        """Keep what the cut-off slots are valued by: the last observation of their survivors."""
        team, robot = np.nonzero(truncated)
        survivor = into[team, robot]
        self.bootstrapped = team * self.n_robots + robot
        self.survivors = team * self.n_robots + survivor
        self.bootstrap_observations = last[team, survivor]

    def _infos(
        self, over: NDArray[np.bool_], last: NDArray[np.float32], infos: Mapping[str, Any]
    ) -> list[dict[str, Any]]:
        n = self.n_robots
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for team in np.flatnonzero(over).tolist():
            told[team * n] |= self._statistics(team, infos["final_info"])
            for robot in range(n) if self.tell_bootstraps else ():
                told[team * n + robot]["terminal_observation"] = last[team, robot].copy()
                told[team * n + robot]["TimeLimit.truncated"] = False
        if self.tell_bootstraps:
            seen = self.bootstrap_observations
            for slot, observation in zip(self.bootstrapped.tolist(), seen, strict=True):
                told[slot]["terminal_observation"] = observation.copy()
                told[slot]["TimeLimit.truncated"] = True
        return told

    def _statistics(self, team: int, final: Mapping[str, Any]) -> dict[str, Any]:
        """What a monitor would say of a team's episode; the next one starts to count."""
        summary = {key: final[key][team].item() for key in STANDING}
        episode = {
            "r": float(self._returns[team]),
            "l": int(self._lengths[team]),
            "t": round(time.time() - self._started, 6),
            **summary,
        }
        self._returns[team], self._lengths[team] = 0.0, 0
        return {"episode": episode, "is_success": summary["success"]}

    def _by_slot(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        return observations.reshape(-1, *self._observed[2:])

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed team b with ``seed`` + b at the next reset; None draws a seed.

        Returns:
            The seed of each slot's team.
        """
        if seed is None:
            seed = int(np.random.randint(2**31))
        self._seeds = [seed + slot // self.n_robots for slot in range(self.num_envs)]
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Give start options for the next reset, for all teams or for each slot."""
        listed = [options or {}] * self.num_envs if not isinstance(options, list) else options
        self._options = deepcopy(listed)

    def get_state(self) -> dict[str, Any]:
        """The running episodes, as copies: nested arrays."""
        return {
            "teams": self.teams.get_state(),
            "active": self._active.copy(),
            "returns": self._returns.copy(),
            "lengths": self._lengths.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out of robots of the same scenario and batch.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        own = {"active": self._active, "returns": self._returns, "lengths": self._lengths}
        check_keys(state, ("teams",))
        checked = check_entries(own, state)
        self.teams.set_state(state["teams"])
        for name, array in own.items():
            array[...] = checked[name]
        self._forget_step()

    def close(self) -> None:
        """Close the teams."""
        self.teams.close()

    # ---- attributes ---------------------------------------------------------------------------

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the vector environment, its wrappers or its simulator, for each slot.

        Of a simulator's array with leading axis B a slot gets the entry of its team.

        Raises:
            AttributeError: if none of them has it.
        """
        owner = self._owner(attr_name)
        value = getattr(owner, attr_name)
        slots = self._get_indices(indices)
        if owner is self.simulator and isinstance(value, np.ndarray):
            return [value[slot // self.n_robots] for slot in slots]
        return [value for _ in slots]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute where it is; all slots share it.

        Raises:
            ValueError: if only some of the slots are named.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(f"set_attr: all slots share {attr_name!r}; leave indices out")
        setattr(self._owner(attr_name, self.teams), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once, since all slots share it; its result for each slot.

        Raises:
            AttributeError: if there is no such method.
        """
        method = getattr(self._owner(method_name), method_name)
        result = method(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Whether the teams are wrapped by this class, for each slot."""
        wrapped = any(isinstance(layer, wrapper_class) for layer in self._layers())
        return [wrapped for _ in self._get_indices(indices)]

    def _layers(self) -> Iterator[Any]:
        """Wrappers from the outermost, the vector environment, its simulator."""
        layer: Any = self.teams
        while layer is not self.teams.unwrapped:
            yield layer
            layer = layer.env
        yield layer
        yield self.simulator

    def _owner(self, name: str, default: Any = None) -> Any:
        for layer in self._layers():
            if hasattr(layer, name):
                return layer
        if default is None:
            raise AttributeError(f"neither the teams nor their simulator have {name!r}")
        return default
