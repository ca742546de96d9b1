"""Robots as single slots, for single-agent learning libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from ..checks import check_shape, floats
from ..deprecation import renamed_arguments, renamed_attribute
from ..engine.state_checks import (
    check_entries,
    check_finite,
    check_keys,
    check_mask,
    refuse_first,
)
from ..envs.guarantee import layers_of
from ..envs.spaces import batched_space, of_one_robot
from ..envs.vector_env import final_value
from ..obstacles.parsing import parse
from ..scenario.start_options import OPTIONS, as_options
from ..simulator import Simulator
from ..state_view import STANDING
from .reward_shaping import RewardShaping

_TOLD = {"returns": "return", "lengths": "length", "costs": "cost"}
"""Episode infos keys, by state key."""
_COUNTED = {told: kept for kept, told in _TOLD.items()}
"""State keys of sums over an episode, by infos key."""


class SlotStep(NamedTuple):
    """Step of B·n slots."""

    observations: NDArray[np.float32]  # (slots, ...), for the next actions; zeros if inactive
    rewards: NDArray[np.float32]  # (slots,), of the robots
    acted: NDArray[np.bool_]  # (slots,), whose robot took part in the step
    ended: NDArray[np.bool_]  # (slots,), whose episode ended; all slots of an ended environment
    bootstrapped: NDArray[np.int64]  # (k,), slots that the step cut off: time-out or merge
    survivors: NDArray[np.int64]  # (k,), the slots they merged into, or their own
    bootstrap_observations: NDArray[np.float32]  # (k, ...), from which to bootstrap
    last: NDArray[np.float32]  # (B, n, ...), at the end of the step, before any reset
    met: NDArray[np.bool_]  # (B,), environments whose episode ended with a rendezvous
    late: NDArray[np.bool_]  # (B,), environments whose episode ended at the time limit
    finished: dict[int, dict[str, Any]]
    """Results of each ended environment: "return" (sum of team rewards), "length" (steps) and
    STANDING. With ``Scenario.costs`` also "cost", the sum over its robots."""
    costs: dict[str, NDArray[np.float64]]  # (slots,) each, of the step, by key of infos
    conditions: dict[str, NDArray[np.bool_]]  # (slots,) each, see ``Simulator.conditions``


class RobotSlots:
    """B environments of n robots as B·n slots; slot = environment · n + robot.

    An environment is reset in the step in which it ends. Rendezvous is a termination; a time-out
    and a merge are truncations. At a time-out a slot is bootstrapped from its own last observation,
    at a merge from its survivor's, so an early merge is not penalised. With action repeat this
    requires ``on_merge="follow"``: otherwise the robot receives reward 0 in the remaining steps.

    Args:
        vector_env: a vector environment with SAME_STEP autoreset, wrapped or not; a ValueError for
            another mode, a TypeError for another type. A custom wrapper that changes observations
            must change ``infos["final_obs"]`` alike. Otherwise the step in which an episode ends
            raises TypeError.
        values_ends: whether ``last`` is used; False accepts such wrappers.
    """

    active: NDArray[np.bool_]
    """Active (not merged) robots, (B, n)."""
    observation_space = batched_space("single_observation_space")  # of all slots, for RLlib
    action_space = batched_space("single_action_space")

    teams = renamed_attribute("teams", "vector_env")
    num_teams = renamed_attribute("num_teams", "batch_size")

    @renamed_arguments(teams="vector_env")
    def __init__(self, vector_env: VectorEnv[Any, Any, Any], *, values_ends: bool = True) -> None:
        if not (isinstance(vector_env, VectorEnv) and hasattr(vector_env.unwrapped, "simulator")):
            kind, made = type(vector_env).__name__, "rendezvous_env.vector.training_env makes one"
            raise TypeError(f"vector_env is a {kind}; it must be a vector environment, {made}")
        mode = vector_env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; robots need AutoresetMode.SAME_STEP")
        self._shaping, self._values_ends = RewardShaping(vector_env), values_ends
        self.vector_env: Any = vector_env  # wrapped or not; Any, since Gymnasium has no states
        base: Any = vector_env.unwrapped
        self.simulator: Simulator = base.simulator
        given: Any = vector_env
        spaces = given.single_observation_space, given.single_action_space
        self.single_observation_space, self.single_action_space = map(of_one_robot, spaces)
        self.batch_size, self.n_robots = vector_env.num_envs, int(spaces[0].shape[0])
        self._acting: tuple[int, ...] = (vector_env.num_envs, *spaces[1].shape)
        self.num_envs = self.batch_size * self.n_robots
        self.active = np.zeros((self.batch_size, self.n_robots), dtype=np.bool_)
        self._counts: dict[str, NDArray[Any]] = {
            "returns": np.zeros(self.batch_size),
            "lengths": np.zeros(self.batch_size, dtype=np.int64),
        }
        for key in self.simulator.costs:
            self._counts[_COUNTED.get(key, key)] = np.zeros(self.batch_size)

    def reset(
        self,
        seeds: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> NDArray[np.float32]:
        """Start a new episode in all environments, or in those of a mask.

        Arguments are those of the vector environment. Returns observations (slots, ...).
        """
        mask = (given := as_options(options)).get("reset_mask")  # some wrappers remove it
        observations, infos = self.vector_env.reset(seed=seeds, options=given)
        self.begin(np.ones(self.batch_size, np.bool_) if mask is None else mask)
        self.active = infos["active"].copy()
        return self.by_slot(observations)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Register new episodes, (B,), that were started by other means."""
        which = check_mask(which, self.batch_size)
        self.active[which] = True
        for count in self._counts.values():
            count[which] = 0

    def step(self, actions: NDArray[Any]) -> SlotStep:
        """Advance every environment with actions (slots, a), or (slots,) if discrete.

        Errors are those of the vector environment.
        """
        given = actions if isinstance(actions, np.ndarray) else floats("actions", actions)
        by_slot = self.num_envs, *self._acting[2:]
        check_shape("actions", given, by_slot, self._acting)
        observations, rewards, met, late, infos = self.vector_env.step(given.reshape(self._acting))
        over, last = met | late, observations
        if over.any():
            if self._values_ends:
                self._shaping.check_final(observations, infos)
            last = observations.copy()
            last[over] = np.stack(infos["final_obs"][over].tolist())
        active, into = (final_value(infos, over, key) for key in ("active", "merged_into"))
        merged = self.active & ~active
        ended = (merged | over[:, None]).reshape(-1)
        if ended.any():
            team, robot = np.nonzero((merged | (active & late[:, None])) & ~met[:, None])
        else:  # as in most steps
            team = robot = np.empty(0, dtype=np.int64)
        survivor = into[team, robot]
        acted = self.active.reshape(-1)
        robot_rewards = self._shaping.robot_rewards(rewards, infos, self.active)
        costs = {key: infos[key].reshape(-1) for key in self.simulator.costs}
        named = self.simulator.conditions
        conditions = {key: final_value(infos, over, key).reshape(-1) for key in named}
        self.active = infos["active"].copy()
        self._counts["returns"] += rewards
        self._counts["lengths"] += 1
        for key in costs:
            self._counts[_COUNTED.get(key, key)] += infos[key].sum(axis=1)
        return SlotStep(
            observations=self.by_slot(observations),
            rewards=robot_rewards.astype(np.float32).reshape(-1),
            acted=acted,
            ended=ended,
            bootstrapped=team * self.n_robots + robot,
            survivors=team * self.n_robots + survivor,
            bootstrap_observations=last[team, survivor],
            last=last,
            met=met,
            late=late,
            finished=self._finish(over, infos) if over.any() else {},
            costs=costs,
            conditions=conditions,
        )

    def _finish(self, over: NDArray[np.bool_], infos: Mapping[str, Any]) -> dict[int, Any]:
        """Results of ended episodes; their accumulators are reset."""
        finished: dict[int, Any] = {}
        for team in np.flatnonzero(over).tolist():
            counts = {_TOLD.get(name, name): c[team].item() for name, c in self._counts.items()}
            summary = {key: infos["final_info"][key][team].item() for key in STANDING}
            finished[team] = counts | summary
        for count in self._counts.values():
            count[over] = 0
        return finished

    def by_slot(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Reshape observations of environments, (B, n, ...), to slots."""
        return observations.reshape(-1, *observations.shape[2:])

    @property
    def _memory(self) -> dict[str, NDArray[Any]]:
        return {"active": self.active, **self._counts}

    @property
    def _stateful(self) -> Any:
        """Outermost layer with a state; Gymnasium's wrappers have none."""
        return next(layer for layer in layers_of(self.vector_env) if hasattr(layer, "get_state"))

    def get_state(self) -> dict[str, Any]:
        """Copy of the running episodes: nested arrays."""
        return {"teams": self._stateful.get_state(), **deepcopy(self._memory)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``Simulator.set_state``."""
        check_keys(state, ("teams", *self._memory), exactly=True)
        checked = check_entries(self._memory, state)
        check_finite(checked, checked)
        refuse_first("lengths", checked["lengths"] < 0, checked["lengths"], "0 or more")
        self._stateful.set_state(state["teams"])
        for name, array in self._memory.items():
            array[...] = checked[name]

    def close(self) -> None:
        """Close the vector environment."""
        self.vector_env.close()


def team_options(options: Sequence[Mapping[str, Any]], dim: int) -> dict[str, Any]:
    """Stack the reset options of each environment.

    Keys, shapes and obstacles must be equal. A reset mask is not allowed.
    """

    def of_all(own: Mapping[str, Any]) -> tuple[Any, ...]:
        return own.keys(), parse(own.get("obstacles", ()), dim)

    def stacked(key: str) -> NDArray[np.float64]:
        arrays = [floats(key, own[key]) for own in options]
        shape = arrays[0].shape
        for team, array in enumerate(arrays):
            if array.shape != shape:
                raise ValueError(
                    f"set_options: {key} of environment {team} has shape {array.shape}; that of "
                    f"environment 0 has {shape}, and all must have the same"
                )
        return np.stack(arrays)

    def kept(own: Mapping[str, Any]) -> dict[str, Any]:
        return {k: v for k, v in own.items() if v is not None and k != "reset_mask"}

    given = {id(own): kept(own) for own in options}
    options = [given[id(own)] for own in options]
    first = options[0]
    for other in options[1:]:
        if other is not first and of_all(other) != of_all(first):
            raise ValueError(
                f"set_options: all environments need the same keys and obstacles; one has {first}, "
                f"another {other}"
            )
    own_of_each = {*OPTIONS} - {"obstacles"}  # other keys are ignored, or intended
    return {key: stacked(key) if key in own_of_each else first[key] for key in first}
