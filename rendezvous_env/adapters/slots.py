"""Robots as single slots, for libraries that know no teams."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from ..checks import check_shape, floats
from ..engine.state_checks import (
    check_entries,
    check_finite,
    check_keys,
    check_mask,
    refuse_first,
)
from ..envs.guarantee import layers_of
from ..envs.spaces import of_all_teams, of_one_robot
from ..envs.training import TrainingTeams
from ..envs.vector_env import Info, RendezvousVectorEnv, Transition, at_the_end
from ..envs.vector_wrappers import GuaranteeWrapper
from ..obstacles.parsing import parse
from ..scenario.start_options import OPTIONS, as_options
from ..simulator import Simulator
from ..state_view import STANDING

_COUNTED = {"cost": "costs"}
"""What states of slots call the sum of a key of infos."""
_TOLD = {"returns": "return", "lengths": "length", "costs": "cost"}
"""What infos of an episode call it."""


class SlotStep(NamedTuple):
    """A step of B·n slots."""

    observations: NDArray[np.float32]  # (slots, ...), for the next actions; zeros if gone
    rewards: NDArray[np.float32]  # (slots,), of the robots
    acted: NDArray[np.bool_]  # (slots,), whose robot took part in the step
    ended: NDArray[np.bool_]  # (slots,), whose episode it ended; all slots of a team that is over
    bootstrapped: NDArray[np.int64]  # (k,), slots that the step cut off: time-out or merge
    survivors: NDArray[np.int64]  # (k,), the slots that these are now part of, or their own
    bootstrap_observations: NDArray[np.float32]  # (k, ...), by which their future is valued
    last: NDArray[np.float32]  # (B, n, ...), at the end of the step, before any team was reset
    met: NDArray[np.bool_]  # (B,), teams whose episode ended with a rendezvous
    late: NDArray[np.bool_]  # (B,), teams whose episode ended at the time limit
    finished: dict[int, dict[str, Any]]
    """Of each team that is over: "return" (sum of team rewards), "length" (steps), STANDING, and
    with ``Scenario.costs`` "cost", the sum over its robots."""
    costs: dict[str, NDArray[np.float64]]  # (slots,) each, of the step, by key of infos


class RobotSlots:
    """B teams of n robots as B·n slots; slot = team · n + robot.

    A team is reset in the step in which it ends. Rendezvous is a true end. A time-out and a merge
    are none: the slot is cut off, and its future is valued by its own last observation at a
    time-out and by its survivor's at a merge, so that meeting early is not punished. Where a
    decision is held for several steps that needs ``on_merge="follow"``: else the robot earns
    nothing in the rest of them.

    Args:
        teams: a vector environment of teams with SAME_STEP autoreset, wrapped or not; a ValueError
            for another mode, a TypeError for what is none.
    """

    active: NDArray[np.bool_]
    """(B, n), robots that exist on their own."""
    observation_space = of_all_teams("single_observation_space")  # of all slots, for RLlib
    action_space = of_all_teams("single_action_space")

    def __init__(self, teams: VectorEnv[Any, Any, Any]) -> None:
        if not (isinstance(teams, VectorEnv) and hasattr(teams.unwrapped, "simulator")):
            kind, made = type(teams).__name__, "rendezvous_env.vector.training_env makes them"
            raise TypeError(f"teams is of type {kind}; it must be teams as {made}")
        mode = teams.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; robots need AutoresetMode.SAME_STEP")
        self._shaping = RewardShaping(teams)
        self.teams: Any = teams  # wrapped or not: the state is not of Gymnasium's interface
        base: Any = teams.unwrapped
        self.simulator: Simulator = base.simulator
        spaces: tuple[Any, ...] = teams.single_observation_space, teams.single_action_space
        self.single_observation_space, self.single_action_space = map(of_one_robot, spaces)
        self.num_teams, self.n_robots = teams.num_envs, int(spaces[0].shape[0])
        self._acting: tuple[int, ...] = (teams.num_envs, *spaces[1].shape)
        self.num_envs = self.num_teams * self.n_robots
        self.active = np.zeros((self.num_teams, self.n_robots), dtype=np.bool_)
        self._counts: dict[str, NDArray[Any]] = {
            "returns": np.zeros(self.num_teams),
            "lengths": np.zeros(self.num_teams, dtype=np.int64),
        }
        for key in self.simulator.costs:
            self._counts[_COUNTED.get(key, key)] = np.zeros(self.num_teams)

    def reset(
        self,
        seeds: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> NDArray[np.float32]:
        """Begin a new episode in all teams, or in those of a mask, with their arguments;
        observations (slots, ...).
        """
        mask = (given := as_options(options)).get("reset_mask")  # some wrappers take it out
        observations, infos = self.teams.reset(seed=seeds, options=given)
        self.begin(np.ones(self.num_teams, np.bool_) if mask is None else mask)
        self.active = infos["active"].copy()
        return self.by_slot(observations)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Take note of new episodes of these teams, (B,), that began by other means."""
        which = check_mask(which, self.num_teams)
        self.active[which] = True
        for count in self._counts.values():
            count[which] = 0

    def step(self, actions: NDArray[Any]) -> SlotStep:
        """Advance every team with actions (slots, a), or (slots,) where they are discrete; errors
        as the teams.
        """
        given = actions if isinstance(actions, np.ndarray) else floats("actions", actions)
        by_slot = self.num_envs, *self._acting[2:]
        check_shape("actions", given, by_slot, self._acting)
        observations, rewards, met, late, infos = self.teams.step(given.reshape(self._acting))
        over, last = met | late, observations
        if over.any():
            last = observations.copy()
            last[over] = np.stack(infos["final_obs"][over].tolist())
        active, into = (at_the_end(infos, over, key) for key in ("active", "merged_into"))
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
        )

    def _finish(self, over: NDArray[np.bool_], infos: Mapping[str, Any]) -> dict[int, Any]:
        """How the episodes of these teams went; their counts start again."""
        finished: dict[int, Any] = {}
        for team in np.flatnonzero(over).tolist():
            counts = {_TOLD.get(name, name): c[team].item() for name, c in self._counts.items()}
            summary = {key: infos["final_info"][key][team].item() for key in STANDING}
            finished[team] = counts | summary
        for count in self._counts.values():
            count[over] = 0
        return finished

    def by_slot(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observations of teams, (B, n, ...), as those of slots."""
        return observations.reshape(-1, *observations.shape[2:])

    @property
    def _memory(self) -> dict[str, NDArray[Any]]:
        return {"active": self.active, **self._counts}

    @property
    def _stateful(self) -> Any:
        """The outermost layer that has a state, as wrappers of Gymnasium's have not."""
        return next(layer for layer in layers_of(self.teams) if hasattr(layer, "get_state"))

    def get_state(self) -> dict[str, Any]:
        """The running episodes, as copies: nested arrays."""
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
        """Close the teams."""
        self.teams.close()


def team_options(options: Sequence[Mapping[str, Any]], dim: int) -> dict[str, Any]:
    """Options of all teams, stacked, from those of each; keys, shapes and obstacles must be the
    same. A mask of teams is none of them.
    """

    def of_all(own: Mapping[str, Any]) -> tuple[Any, ...]:
        return own.keys(), parse(own.get("obstacles", ()), dim)

    def stacked(key: str) -> NDArray[np.float64]:
        arrays = [floats(key, own[key]) for own in options]
        shape = arrays[0].shape
        for team, array in enumerate(arrays):
            if array.shape != shape:
                raise ValueError(
                    f"set_options: {key} of team {team} has shape {array.shape}; that of team 0 "
                    f"has {shape}, and all must have the same"
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
                f"set_options: all teams need the same keys and obstacles; one has {first}, "
                f"another {other}"
            )
    own_of_each = {*OPTIONS} - {"obstacles"}  # keys that are not ours are ignored, or meant
    return {key: stacked(key) if key in own_of_each else first[key] for key in first}


class RewardShaping:
    """Rewards of single robots where wrappers of a user's own have changed those of their teams.

    What a wrapper adds to the reward of a team is added to that of each of its robots. A wrapper
    that changes ``infos["robot_rewards"]`` itself has the last word. A recorder is put under the
    innermost wrapper that is not of this package.
    """

    def __init__(self, teams: VectorEnv[Any, Any, Any]) -> None:
        self._recorder: _Recorder | None = None
        self._follow = teams.unwrapped.simulator.scenario.on_merge == "follow"  # type: ignore[attr-defined]
        for layer, beneath in pairwise(layers_of(teams)):
            if not isinstance(layer, _OURS) and isinstance(beneath, _OURS):
                if not isinstance(beneath, _Recorder):
                    layer.env = beneath = _Recorder(beneath)
                self._recorder = beneath

    def robot_rewards(
        self, rewards: NDArray[np.float64], infos: Mapping[str, Any], acted: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Of the last step, (B, n), from what the outermost wrapper gave and who (B, n) acted."""
        given: NDArray[np.float64] = infos["robot_rewards"]
        if self._recorder is None:
            return given
        base, robots = self._recorder.taken()
        if not np.array_equal(given, robots):
            return given
        added = (np.asarray(rewards, np.float64) - base)[:, np.newaxis]
        return given + (added if self._follow else np.where(acted, added, 0.0))


class _Recorder(VectorWrapper):
    """Sums rewards of teams (B,) and robots (B, n), as they were below, until they are taken."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        self._sums: tuple[Any, Any] = (0.0, 0.0)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, actions: Any) -> Transition:
        """As the teams."""
        seen, rewards, ends, cuts, infos = self.env.step(actions)
        teams, robots = self._sums
        self._sums = teams + rewards, robots + infos["robot_rewards"]
        return seen, rewards, ends, cuts, infos

    def reset(self, **arguments: Any) -> tuple[Any, Info]:
        """As the teams."""
        self.taken()
        return self.env.reset(**arguments)

    def taken(self) -> tuple[Any, Any]:
        """The sums since this was last called."""
        sums, self._sums = self._sums, (0.0, 0.0)
        return sums


_OURS = (RendezvousVectorEnv, GuaranteeWrapper, TrainingTeams, _Recorder)
