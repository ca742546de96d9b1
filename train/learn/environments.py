"""Training environments of a run: identical ones, or groups with resampled sensors."""

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
    """Several ``FeatureVectorEnv`` groups as one vector environment.

    The generation of group g determines its sensor and increases every ``period`` updates, with
    one group after the other. A new sensor starts the next episode of each seed. A robot without
    any observed row takes choice 0, as in deployment.

    Args:
        make: (group, generation) → environments of the group.
        sizes: number of environments of each group.
        period: updates per generation.
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
        """Simulator of the first group."""
        simulator: Simulator = self.groups[0].env.simulator
        return simulator

    @property
    def alignment(self) -> NDArray[np.float64]:
        """(B, n), as ``FeatureVectorEnv.alignment``."""
        return np.concatenate([env.alignment for env in self.groups])

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[NDArray[np.float32], Info]:
        """Start a new episode in every environment, one seed each; options are not supported."""
        parts = np.split(np.array(seed), self._bounds)
        begun = [env.reset(seed=own.tolist()) for env, own in zip(self.groups, parts, strict=True)]
        observations = np.concatenate([seen for seen, _ in begun])
        self._note_blind(slice(None), observations)
        return observations, self._joined([infos for _, infos in begun])

    def step(self, actions: ArrayLike) -> Transition:
        """As ``FeatureVectorEnv.step``."""
        parts = np.split(np.where(self._blind, 0, np.asarray(actions)), self._bounds)
        steps = [env.step(own) for env, own in zip(self.groups, parts, strict=True)]
        *arrays, infos = zip(*steps, strict=True)
        seen, rewards, ends, cuts = (np.concatenate(parts) for parts in arrays)
        self._note_blind(slice(None), seen)
        return seen, rewards, ends, cuts, self._joined(infos)

    def renew(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Assign the next sensor to the groups that are due before this update.

        Returns:
            Mask of environments with new episodes, (B,), and the observations of these.
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
        """Concatenated infos of all groups; zeros or None for a group without the key."""
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
        """Copies of the generations, running episodes and memory of all groups."""
        groups = {str(g): env.get_state() for g, env in enumerate(self.groups)}
        return groups | {"generations": self.generations.copy(), "blind": self._blind.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state of ``get_state`` with its sensors; a ValueError leaves all unchanged."""
        memory = {"generations": self.generations, "blind": self._blind}
        check_keys(state, (*map(str, range(len(self.groups))), *memory), exactly=True)
        own = check_entries(memory, state)
        groups = [self._make(g, int(k)) for g, k in enumerate(own["generations"])]
        for g, env in enumerate(groups):
            env.set_state(state[str(g)])
        self.groups = groups
        self.generations, self._blind = own["generations"].copy(), own["blind"].copy()


def make_environments(config: Config, stage: int) -> FeatureVectorEnv | SensingGroups:
    """Environments of a curriculum stage.

    A robot that merges during an action repeat earns the team reward until the decision ends.
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
            contact_penalty=config.contact_penalty,
            own_progress=config.own_progress,
            obstacle_slots=slots,
            global_state=state,
        )

    if not ranges:
        return make(scenario.sensing, config.num_envs)
    sizes = [len(p) for p in np.array_split(np.arange(config.num_envs), config.sensing_groups)]

    def make_group(group: int, generation: int) -> FeatureVectorEnv:
        key = config.seed, group, generation
        return make(draw(scenario.sensing, ranges, config.sensing_chance, key), sizes[group])

    return SensingGroups(make_group, sizes, config.sensing_updates)


class TimedRobotVecEnv(RobotVecEnv):
    """``RobotVecEnv`` that also accumulates environment time (s) and alignment."""

    seconds, alignment, aligned = 0.0, 0.0, 0

    def step_wait(self) -> Any:
        """As ``RobotVecEnv.step_wait``, timed."""
        began = time.perf_counter()
        result = super().step_wait()
        alignment = self.vector_env.alignment
        known = ~np.isnan(alignment)
        self.alignment += float(alignment[known].sum())
        self.aligned += int(known.sum())
        self.seconds += time.perf_counter() - began
        return result

    def renew_sensors(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """As ``SensingGroups.renew``, for slots: (slots,) and (k, size)."""
        if not isinstance(self.vector_env, SensingGroups):
            return np.zeros(self.num_envs, dtype=np.bool_), self.bootstrap_observations[:0]
        which, observations = self.vector_env.renew(update)
        self.slots.begin(which)
        return np.repeat(which, self.n_robots), self.slots.by_slot(observations)
