"""Robots as single slots, for single-agent learning libraries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy, deepcopy
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Env, Space
from gymnasium.vector import AutoresetMode, VectorEnv, VectorRewardWrapper, VectorWrapper
from gymnasium.wrappers.vector import NormalizeReward
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
from ..envs.spaces import batched_space, of_one_robot
from ..envs.training import TrainingTeams
from ..envs.vector_env import RendezvousVectorEnv, Transition, final_value
from ..envs.vector_wrappers import GuaranteeWrapper
from ..obstacles.parsing import parse
from ..scenario.start_options import OPTIONS, as_options
from ..simulator import Simulator
from ..state_view import STANDING

_ROUNDING = 1e-6  # of a ratio of rewards, in float32
_COUNTED = {"cost": "costs"}
"""State keys of sums over an episode, by infos key."""
_TOLD = {"returns": "return", "lengths": "length", "costs": "cost"}
"""Episode infos keys, by state key."""


class SlotStep(NamedTuple):
    """Step of B·n slots."""

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
    """Results of each ended environment: "return" (sum of team rewards), "length" (steps) and
    STANDING. With ``Scenario.costs`` also "cost", the sum over its robots."""
    costs: dict[str, NDArray[np.float64]]  # (slots,) each, of the step, by key of infos


class RobotSlots:
    """B environments of n robots as B·n slots; slot = environment · n + robot.

    An environment is reset in the step in which it ends. Rendezvous is a termination; a time-out
    and a merge are truncations. Such a slot is bootstrapped from its own last observation at a
    time-out and from its survivor's at a merge, so an early merge is not penalised. With action
    repeat this requires ``on_merge="follow"``: otherwise the robot earns nothing in the remaining
    steps.

    Args:
        teams: a vector environment with SAME_STEP autoreset, wrapped or not; a ValueError for
            another mode, a TypeError for another type. A custom wrapper that changes observations
            must change ``infos["final_obs"]`` alike. Otherwise the step in which an episode ends
            raises TypeError.
        values_ends: whether ``last`` is used; False accepts such wrappers.
    """

    active: NDArray[np.bool_]
    """Active (not merged) robots, (B, n)."""
    observation_space = batched_space("single_observation_space")  # of all slots, for RLlib
    action_space = batched_space("single_action_space")

    def __init__(self, teams: VectorEnv[Any, Any, Any], *, values_ends: bool = True) -> None:
        if not (isinstance(teams, VectorEnv) and hasattr(teams.unwrapped, "simulator")):
            kind, made = type(teams).__name__, "rendezvous_env.vector.training_env makes them"
            raise TypeError(f"teams is of type {kind}; it must be teams as {made}")
        mode = teams.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; robots need AutoresetMode.SAME_STEP")
        self._shaping, self._values_ends = RewardShaping(teams), values_ends
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
        """Start a new episode in all environments, or in those of a mask.

        Arguments are those of the vector environment. Returns observations (slots, ...).
        """
        mask = (given := as_options(options)).get("reset_mask")  # some wrappers take it out
        observations, infos = self.teams.reset(seed=seeds, options=given)
        self.begin(np.ones(self.num_teams, np.bool_) if mask is None else mask)
        self.active = infos["active"].copy()
        return self.by_slot(observations)

    def begin(self, which: NDArray[np.bool_]) -> None:
        """Register new episodes, (B,), that were started by other means."""
        which = check_mask(which, self.num_teams)
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
        observations, rewards, met, late, infos = self.teams.step(given.reshape(self._acting))
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
        return next(layer for layer in layers_of(self.teams) if hasattr(layer, "get_state"))

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
        self.teams.close()


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
    """Robot rewards under custom wrappers that change the team reward.

    | wrapper | robot rewards |
    |---|---|
    | Gymnasium's ``NormalizeReward`` | divided by the same number |
    | ``VectorRewardWrapper``, as ``TransformReward`` | its ``rewards``, applied to each robot |
    | any other | plus the change of the team reward, or times a common factor |

    The last row uses a factor if different rewards are multiplied by the same number. A wrapper
    that changes ``infos["robot_rewards"]`` itself takes precedence. A wrapper that scales the
    environments by different factors should do so. With ``on_merge="remove"`` inactive robots earn
    nothing. A recorder is inserted beneath each external wrapper to detect its changes. A wrapper
    that changes observations must also change ``infos["final_obs"]``.
    """

    def __init__(self, teams: VectorEnv[Any, Any, Any]) -> None:
        self._top: _Changes | None = None
        above: Any = None
        for layer in [*layers_of(teams)]:
            if not isinstance(layer, _OURS) and hasattr(layer, "env"):
                if type(layer.env) is not _Recorder:
                    layer.env = _Recorder(layer.env)
                changes = _Changes(layer, layer.env)
                if above is None:
                    self._top = changes
                elif not isinstance(above, _Shaper):
                    above.env = _Shaper(layer, changes)
                above = layer.env
            else:
                above = layer

    def robot_rewards(
        self, rewards: NDArray[np.float64], infos: Mapping[str, Any], acted: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Robot rewards of the last step, (B, n).

        They follow from the result of the outermost wrapper and the robots (B, n) that acted.
        """
        given: NDArray[np.float64] = infos["robot_rewards"]
        return given if self._top is None else self._top.rewards(rewards, given, acted)

    def check_final(self, observations: NDArray[np.float32], infos: Mapping[str, Any]) -> None:
        """Reject an outermost wrapper that changes observations, but not the final ones."""
        if self._top is not None:
            self._top.check_final(observations, infos)


class _Given(NamedTuple):
    """Result of a step, passed to the wrapper above."""

    rewards: NDArray[np.float64]  # (B,)
    robot_rewards: NDArray[np.float64]  # (B, n)
    acted: NDArray[np.bool_]  # (B, n)
    observations: NDArray[np.float32] | None  # (B, n, ...), if teams ended in it
    final: list[NDArray[np.float32]]  # (n, ...) each, of those that did


class _Recorder(VectorWrapper):
    """Wrapper that records the result of the last step for the wrapper above."""

    given: _Given

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, actions: Any) -> Transition:
        """As the vector environment."""
        simulator = self.env.unwrapped.simulator  # type: ignore[attr-defined]
        acted = simulator.active | (simulator.scenario.on_merge == "follow")
        seen, rewards, ends, cuts, infos = self.env.step(actions)
        final = _final_of(infos)
        self.given = _Given(
            np.array(rewards, np.float64),
            infos["robot_rewards"].copy(),
            acted,
            seen.copy() if final else None,
            [each.copy() for each in final],
        )
        return seen, rewards, ends, cuts, infos


class _Shaper(_Recorder):
    """Wrapper that passes on robot rewards, as changed by the wrapper beneath."""

    def __init__(self, env: VectorEnv[Any, Any, Any], changes: _Changes) -> None:
        super().__init__(env)
        self._changes = changes

    def step(self, actions: Any) -> Transition:
        """As the vector environment, with consistent ``robot_rewards``."""
        seen, rewards, ends, cuts, infos = self.env.step(actions)
        self._changes.check_final(seen, infos)
        given = infos["robot_rewards"]
        infos["robot_rewards"] = self._changes.rewards(rewards, given)
        return seen, rewards, ends, cuts, infos


class _Changes:
    """Changes by one wrapper in the last step."""

    def __init__(self, layer: Any, recorder: _Recorder) -> None:
        self._layer, self._recorder, self._factor = layer, recorder, _Factor()
        self._applies = (
            isinstance(layer, VectorRewardWrapper) and type(layer).step is VectorRewardWrapper.step
        )

    def rewards(
        self,
        rewards: NDArray[np.float64],
        given: NDArray[np.float64],
        acted: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """Robot rewards, (B, n), from the wrapper's result and the robots (B, n) that acted.

        None means the same robots as recorded.
        """
        layer, below = self._layer, self._recorder.given
        if not np.array_equal(given, below.robot_rewards):
            return given
        if isinstance(layer, NormalizeReward):
            changed = given / np.sqrt(layer.return_rms.var + layer.epsilon)
        elif self._applies:
            twin, columns = _twin(layer), given.T
            changed = np.stack([np.asarray(twin.rewards(each.copy())) for each in columns], axis=1)
        else:
            rewards = np.asarray(rewards, np.float64)
            factor = self._factor.between(below.rewards, rewards)
            added = (rewards - below.rewards)[:, np.newaxis]
            changed = given + added if factor is None else given * factor
        follows = self._recorder.unwrapped.simulator.scenario.on_merge == "follow"  # type: ignore[attr-defined]
        acted = below.acted if acted is None or follows else acted
        return np.where(acted, changed, given)

    def check_final(self, observations: NDArray[np.float32], infos: Mapping[str, Any]) -> None:
        """Reject a wrapper that changes observations, but not the final ones."""
        below = self._recorder.given
        if below.observations is None or np.array_equal(below.observations, observations):
            return
        pairs = zip(below.final, _final_of(infos), strict=True)
        if all(np.array_equal(before, now) for before, now in pairs if before.any()) and any(
            before.any() for before in below.final
        ):
            raise TypeError(
                f"teams are under {type(self._layer).__name__}, which changes observations but not "
                "infos['final_obs'], the last ones of episodes, by which time-outs are valued; it "
                "must change both alike"
            )


class _Factor:
    """Detector of wrappers that multiply rewards rather than add to them.

    A factor is the same ratio for different rewards, of a batch or of two steps.
    """

    def __init__(self) -> None:
        self._multiplies, self._reward, self._ratio = False, 0.0, 0.0

    def between(self, before: NDArray[np.float64], after: NDArray[np.float64]) -> float | None:
        """Factor applied to the rewards (B,) of a step; None if there is none."""
        counts = before != 0.0
        if not counts.any():
            return None
        ratios, rewards = after[counts] / before[counts], before[counts]
        if after[~counts].any() or np.ptp(ratios) > _ROUNDING * np.abs(ratios).max():
            self._multiplies = False
            return None
        ratio, reward = float(ratios[0]), float(rewards[0])
        again = abs(ratio - self._ratio) <= _ROUNDING * abs(ratio)
        if np.ptp(rewards) > 0.0 or (self._reward not in (0.0, reward) and again):
            self._multiplies = True
        self._reward, self._ratio = reward, ratio
        return ratio if self._multiplies else None


def _final_of(infos: Mapping[str, Any]) -> list[Any]:
    """Final observations of environments that ended in a step, (n, ...) each."""
    return [each for each in infos.get("final_obs", ()) if each is not None]


def _twin(layer: Any) -> Any:
    """Copy of a wrapper with separate memory, for side-effect-free evaluation."""
    twin = copy(layer)
    for name, value in vars(layer).items():
        if not (callable(value) or isinstance(value, Env | VectorEnv | Space)):
            setattr(twin, name, deepcopy(value))
    return twin


_OURS = (RendezvousVectorEnv, GuaranteeWrapper, TrainingTeams, _Recorder)
