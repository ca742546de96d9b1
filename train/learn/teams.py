"""The teams that a run trains in: all alike, or groups whose sensors are resampled."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray
from rendezvous_env.baselines.learned.training_environment import FeatureVectorEnv

from rendezvous_env import make_vec
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.engine.state_checks import check_entries, check_keys
from rendezvous_env.envs.vector_env import Info, Transition
from rendezvous_env.sensors.sensing import Sensing
from rendezvous_env.simulator import Simulator

from .networks import GlobalStateLayout
from .sensing_ranges import draw
from .settings import Config


class SensingGroups(VectorEnv[Any, Any, Any]):
    """Groups of ``FeatureVectorEnv`` as one vector environment of all their teams.

    The sensor of group g follows from its generation, which grows by one every ``period`` updates,
    for one group after the other. A group with a new sensor begins the next episodes of its teams'
    seeds. A robot that is shown nothing makes choice 0, as it does when the policy is served.
    ``make`` gives a group from its number and its generation, ``sizes`` are numbers of teams.
    """

    def __init__(
        self, make: Callable[[int, int], FeatureVectorEnv], sizes: Sequence[int], period: int
    ) -> None:
        self._make, self._sizes, self._period = make, list(sizes), period
        self._bounds = np.cumsum(sizes)[:-1]
        self.generations = np.zeros(len(sizes), dtype=np.int64)
        self.groups: list[Any] = [make(group, 0) for group in range(len(sizes))]
        first = self.groups[0]
        self.num_envs = sum(sizes)
        self.metadata, self.render_mode = first.metadata, None
        self.single_observation_space = first.single_observation_space
        self.single_action_space = first.single_action_space
        self.layout, self.global_state = first.layout, first.global_state
        self._blind = np.zeros((self.num_envs, self.simulator.scenario.n_robots), dtype=np.bool_)

    @property
    def simulator(self) -> Simulator:
        """That of the first group; each has its own."""
        simulator: Simulator = self.groups[0].env.simulator
        return simulator

    @property
    def alignment(self) -> NDArray[np.float64]:
        """(B, n), as ``FeatureVectorEnv.alignment``."""
        return np.concatenate([teams.alignment for teams in self.groups])

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[NDArray[np.float32], Info]:
        """Begin a new episode in all teams, with a seed for each of them; there are no options."""
        parts = np.split(np.array(seed), self._bounds)
        begun = [
            teams.reset(seed=own.tolist()) for teams, own in zip(self.groups, parts, strict=True)
        ]
        observations = np.concatenate([seen for seen, _ in begun])
        self._note_blind(slice(None), observations)
        return observations, self._joined([infos for _, infos in begun])

    def step(self, actions: ArrayLike) -> Transition:
        """As ``FeatureVectorEnv.step``."""
        parts = np.split(np.where(self._blind, 0, np.asarray(actions)), self._bounds)
        steps = [teams.step(own) for teams, own in zip(self.groups, parts, strict=True)]
        *arrays, infos = zip(*steps, strict=True)
        seen, rewards, ends, cuts = (np.concatenate(parts) for parts in arrays)
        self._note_blind(slice(None), seen)
        return seen, rewards, ends, cuts, self._joined(infos)

    def renew(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Give the groups whose time has come before this update their next sensor.

        Returns:
            Which teams have begun new episodes, (B,), and their observations, one after the other.
        """
        groups = len(self.groups)
        due = (update + self._period * np.arange(groups) // groups) // self._period
        which = np.repeat(due != self.generations, self._sizes)
        shape: Any = self.single_observation_space.shape
        begun = [np.empty((0, *shape), dtype=np.float32)]
        for group in np.flatnonzero(due != self.generations).tolist():
            renewed: Any = self._make(group, int(due[group]))
            drawn, simulator = self.groups[group].env.simulator.get_state(), renewed.env.simulator
            simulator.reset(drawn["seed"].tolist())
            simulator.set_state(simulator.get_state() | {"episode": drawn["episode"]})
            begun.append(renewed.reset()[0])
            self.groups[group], self.generations[group] = renewed, due[group]
        observations = np.concatenate(begun)
        self._note_blind(which, observations)
        return which, observations

    def _note_blind(self, which: Any, observations: NDArray[np.float32]) -> None:
        self._blind[which] = ~observations[..., : self.layout.size].any(axis=-1)

    def _joined(self, parts: Sequence[Info]) -> Info:
        """Infos of all groups as of one; zeros or None for a group that lacks a key."""
        joined: Info = {}
        for key in dict.fromkeys(key for part in parts for key in part):
            told = next(part[key] for part in parts if key in part)
            if isinstance(told, dict):
                joined[key] = self._joined([part.get(key, {}) for part in parts])
                continue
            nothing = None if told.dtype == object else told.dtype.type(0)
            joined[key] = np.concatenate(
                [
                    part[key] if key in part else np.full((size, *told.shape[1:]), nothing)
                    for part, size in zip(parts, self._sizes, strict=True)
                ]
            )
        return joined

    def get_state(self) -> dict[str, Any]:
        """The generations, running episodes and memory of all groups, as copies."""
        groups = {str(g): teams.get_state() for g, teams in enumerate(self.groups)}
        return groups | {"generations": self.generations.copy(), "blind": self._blind.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out, with the sensors that belong to it; a ValueError
        names what does not fit, and nothing has changed then.
        """
        memory = {"generations": self.generations, "blind": self._blind}
        check_keys(state, (*map(str, range(len(self.groups))), *memory), exactly=True)
        own = check_entries(memory, state)
        groups = [self._make(g, int(k)) for g, k in enumerate(own["generations"])]
        for g, teams in enumerate(groups):
            teams.set_state(state[str(g)])
        self.groups = groups
        self.generations, self._blind = own["generations"].copy(), own["blind"].copy()


def make_teams(config: Config, stage: int) -> FeatureVectorEnv | SensingGroups:
    """The teams of a stage of the curriculum. A robot that merges while its choice is held earns
    with its team to the end of that decision: its future is valued from there on.
    """
    scenario = config.stage_scenario(stage).replace(on_merge="follow")
    ranges = config.sensing_ranges()
    slots, settings = config.obstacle_slots(), config.policy_settings()
    state = GlobalStateLayout(scenario.n_robots, slots) if config.critic == "global" else None

    def make(sensing: Sensing, size: int) -> FeatureVectorEnv:
        sensed, mode = scenario.replace(sensing=sensing), AutoresetMode.SAME_STEP
        return FeatureVectorEnv(
            make_vec(sensed, size, autoreset_mode=mode, num_threads=config.num_threads),
            settings,
            touch_penalty=config.touch_penalty,
            obstacle_slots=slots,
            global_state=state,
        )

    if not ranges:
        return make(scenario.sensing, config.num_teams)
    sizes = [len(p) for p in np.array_split(np.arange(config.num_teams), config.sensing_groups)]

    def make_group(group: int, generation: int) -> FeatureVectorEnv:
        key = config.seed, group, generation
        return make(draw(scenario.sensing, ranges, config.sensing_chance, key), sizes[group])

    return SensingGroups(make_group, sizes, config.sensing_updates)


class WatchedRobots(RobotVecEnv):
    """Robots with sums over their steps: time in the environment, s; alignment and its terms."""

    seconds, alignment, aligned = 0.0, 0.0, 0

    def step_wait(self) -> Any:
        """As RobotVecEnv, and take the time."""
        began = time.perf_counter()
        result = super().step_wait()
        alignment = self.teams.alignment
        known = ~np.isnan(alignment)
        self.alignment += float(alignment[known].sum())
        self.aligned += int(known.sum())
        self.seconds += time.perf_counter() - began
        return result

    def renew_sensors(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """As ``SensingGroups.renew``, for slots: (slots,) and (k, size)."""
        if not isinstance(self.teams, SensingGroups):
            return np.zeros(self.num_envs, dtype=np.bool_), self.bootstrap_observations[:0]
        which, observations = self.teams.renew(update)
        self.slots.begin(which)
        return np.repeat(which, self.n_robots), self.slots.by_slot(observations)
