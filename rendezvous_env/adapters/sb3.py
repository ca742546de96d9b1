"""stable-baselines3: robots as slots of a VecEnv with one shared network."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from ..checks import check_int, check_shape, counted, floats, mapping
from ..deprecation import renamed_arguments, renamed_attribute
from ..engine.state_checks import check_entries, check_keys, refuse_first
from ..envs.guarantee import component_mask, layers_of
from ..envs.gymnasium_env import make_vec
from ..rewards.terms import earned_in_episode
from ..scenario.start_options import check_seed
from .slots import RobotSlots, SlotStep, team_options

if TYPE_CHECKING:
    from ..scenario.scenarios import ScenarioLike

Indices = int | Iterable[int] | None
_LEAST_REST = 1e-6
"""Smallest fraction of a return that is not rounding error."""


@renamed_arguments(num_teams="num_envs")
def make_robots(scenario: ScenarioLike, num_envs: int, **arguments: Any) -> RobotVecEnv:
    """Create the robots of many environments as slots; arguments as ``rendezvous_env.make_vec``."""
    mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
    return RobotVecEnv(make_vec(scenario, num_envs, **mode | arguments))


class RobotVecEnv(VecEnv):
    """B environments of n robots as B·n slots; slot = environment · n + robot.

    ``RobotSlots`` defines the slots. When a time-out or a merge cuts a slot off, its info has
    ``TimeLimit.truncated`` True, and ``terminal_observation`` is the observation to bootstrap from.
    The slot of a merged robot observes zeros until its environment is reset. ``acted`` and, in
    every step, ``info["acted"]`` exclude these slots; so does ``RobotRolloutBuffer``.
    ``adapters.sb3_wrappers`` replaces wrappers and buffers of stable-baselines3 that count every
    slot.

    With ``Scenario.costs``, the info of every slot has ``cost`` and ``cost_NAME``, and ``costs``
    holds them as arrays (slots,). ``episode`` has their sums over an episode and its robots.

    At the end of an episode, the info of one slot of the environment has ``is_success`` and
    ``episode``. The latter contains "r" (sum of team rewards), "l" (steps), "t" (s since creation
    of this object) and the summary. It also contains ``cost_NAME`` of each cost and ``reward_NAME``
    of each reward term. ``reward_other`` is the rest, such as the cost of first contacts.
    ``EpisodeLog`` logs the means.

    The reporting slot of an environment changes from episode to episode, from the last slot on.
    Slots count as monitored. ``evaluate_policy``, which waits for an episode of every slot it has a
    share for, counts each episode once.

    ``seed(s)`` gives environment b the seed s + b at the next reset. ``set_options`` sets reset
    options: one dict for all, or one per slot; an environment uses the dict of its robot 0. A reset
    that rejects its options starts nothing and discards them; seeds stay for the next one.

    Args:
        vector_env: as of ``RobotSlots``. A wrapper that changes team rewards also changes robot
            rewards, see ``RewardShaping``.
    """

    acted: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    bootstrapped: NDArray[np.int64]
    survivors: NDArray[np.int64]
    bootstrap_observations: NDArray[np.float32]
    costs: dict[str, NDArray[np.float64]]
    """Costs of the last step, as in ``SlotStep``."""
    tell_bootstraps = True
    """True if infos contain ``terminal_observation`` and ``TimeLimit.truncated``."""

    teams = renamed_attribute("teams", "vector_env")

    @renamed_arguments(teams="vector_env")
    def __init__(self, vector_env: VectorEnv[Any, Any, Any]) -> None:
        self.slots = slots = RobotSlots(vector_env)
        self.vector_env, self.n_robots = slots.vector_env, slots.n_robots
        self.simulator = slots.simulator
        self._started = time.time()
        self._told = np.zeros(slots.batch_size, dtype=np.int64)
        self._forget_step()
        super().__init__(
            slots.active.size, slots.single_observation_space, slots.single_action_space
        )
        self.metadata["render_fps"] = self.vector_env.metadata["render_fps"]

    @property
    def action_mask(self) -> NDArray[np.bool_]:
        """True for action components of each slot that its robot has, (slots, a)."""
        mask, width = component_mask(self.vector_env), self.action_space.shape or (1,)
        mask = np.ones((self.n_robots, *width), np.bool_) if mask is None else mask
        return np.tile(mask, (self.slots.batch_size, 1))

    def reset(self) -> NDArray[np.float32]:
        """Start a new episode in all environments; returns observations (slots, rows, d)."""
        seeds = self._seeds[:: self.n_robots]
        given = None if all(seed is None for seed in seeds) else seeds
        try:
            options = team_options(self._options[:: self.n_robots], self.simulator.scenario.dim)
            observations = self.slots.reset(given, options)
        except (TypeError, ValueError):
            self._reset_options()
            raise
        self._told[:] = 0
        self._forget_step()
        self._reset_seeds()
        self._reset_options()
        return observations

    def _forget_step(self) -> None:
        self.acted = self.slots.active.reshape(-1).copy()
        self.ended, self.costs = np.zeros(self.acted.size, dtype=np.bool_), {}
        self._initial = self.simulator.initial_lyapunov  # of the episodes, m²/s
        self.bootstrapped = self.survivors = np.empty(0, dtype=np.int64)
        seen = self.slots.single_observation_space.shape or ()
        self.bootstrap_observations = np.empty((0, *seen), dtype=np.float32)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (slots, a) of the next step; ValueError for invalid shape or values."""
        is_box = isinstance(self.action_space, Box)
        given = floats("actions", actions, np.float32 if is_box else np.float64)
        check_shape("actions", given, (self.num_envs, *(self.action_space.shape or ())))
        self._actions = given if is_box else np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments; returns observations, rewards, dones and infos."""
        step = self.slots.step(self._actions)
        self.acted, self.ended, self.costs = step.acted, step.ended, step.costs
        self.bootstrapped, self.survivors = step.bootstrapped, step.survivors
        self.bootstrap_observations = step.bootstrap_observations
        return step.observations, step.rewards, step.ended.copy(), self._infos(step)

    def _infos(self, step: SlotStep) -> list[dict[str, Any]]:
        n = self.n_robots
        infos: list[dict[str, Any]] = [{"acted": acted} for acted in step.acted.tolist()]
        for key, values in (step.costs | step.conditions).items():
            for info, value in zip(infos, values.tolist(), strict=True):
                info[key] = value
        for team, episode in step.finished.items():
            passed = round(time.time() - self._started, 6)
            monitored = {"r": episode.pop("return"), "l": episode.pop("length"), "t": passed}
            terms = self._reward_terms(team, episode, monitored["r"])
            infos[team * n + n - 1 - self._told[team] % n] |= {
                "episode": monitored | episode | terms,
                "is_success": episode["success"],
            }
            self._told[team] += 1
            for robot in range(n) if self.tell_bootstraps else ():
                infos[team * n + robot]["terminal_observation"] = step.last[team, robot].copy()
                infos[team * n + robot]["TimeLimit.truncated"] = False
        if step.finished:
            self._initial = self.simulator.initial_lyapunov
        if self.tell_bootstraps:
            seen = step.bootstrap_observations
            for slot, observation in zip(step.bootstrapped.tolist(), seen, strict=True):
                infos[slot]["terminal_observation"] = observation.copy()
                infos[slot]["TimeLimit.truncated"] = True
        return infos

    def _reward_terms(self, team: int, episode: dict[str, Any], earned: float) -> dict[str, float]:
        """Sum of each reward term over an episode that has ended."""
        simulator, start = self.simulator, float(self._initial[team])
        weights, limit = simulator.scenario.reward, simulator.max_steps * simulator.scenario.tau
        progress = (start - episode["lyapunov"]) / start if start > 0.0 else 0.0
        share = episode["time"] / limit
        terms = earned_in_episode(weights, progress, share, episode["contacts"], episode["success"])
        terms |= {name: float(one[team]) for name, one in simulator.earned_before.items()}
        if abs(rest := earned - sum(terms.values())) > _LEAST_REST:
            terms["other"] = rest
        return {f"reward_{name}": value for name, value in terms.items()}

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed environment b with ``seed`` + b at the next reset; None samples one.

        Returns the seed of each slot.
        """
        if seed is None:  # from NumPy's global generator, as the base class does
            seed = int(np.random.randint(2**31))
        first = check_seed(seed)
        self._seeds = [first + slot // self.n_robots for slot in range(self.num_envs)]
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set options of the next reset, for all environments or, as a list, for each slot."""
        listed = [options or {}] * self.num_envs if not isinstance(options, list) else options
        if len(listed) != self.num_envs:
            raise ValueError(
                f"set_options: {counted(len(listed), 'entry')}; give one dict, or one for each of "
                f"{self.num_envs} slots"
            )
        for each in listed:
            mapping("options", each, "a dict of start options")
        self._options = deepcopy(listed)

    def get_images(self) -> Sequence[NDArray[np.uint8]]:
        """Image of each environment, with ``render_mode="rgb_array"``."""
        return list(self.vector_env.render() or ())

    def get_state(self) -> dict[str, Any]:
        """Copy of the running episodes: nested arrays."""
        return self.slots.get_state() | {"told": self._told.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``Simulator.set_state``."""
        check_keys(state, ())
        slots = dict(state)
        checked = check_entries({"told": self._told}, state)["told"]
        del slots["told"]
        refuse_first("told", checked < 0, checked, "0 or more")
        self.slots.set_state(slots)
        self._told[...] = checked
        self._forget_step()

    def close(self) -> None:
        """Close the vector environment."""
        self.slots.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the vector environment, its wrappers or its simulator, per slot.

        For a simulator array with leading axis B, a slot gets the entry of its environment.
        """
        owner = self._owner(attr_name)
        value, slots = getattr(owner, attr_name), self._get_indices(indices)
        if owner is self.simulator and isinstance(value, np.ndarray):
            return [value[slot // self.n_robots] for slot in slots]
        return [value] * len(slots)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute on the object that has it; a subset of slots is rejected."""
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(f"set_attr: all slots share {attr_name!r}; leave indices out")
        setattr(self._owner(attr_name, self.vector_env), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once, since all slots share it; returns its result for each slot."""
        slots = self._get_indices(indices)
        method = getattr(self._owner(method_name), method_name)
        return [method(*method_args, **method_kwargs)] * len(slots)

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """True if this class wraps the environment, for each slot; True for ``Monitor``."""
        layers = layers_of(self.vector_env)
        wrapped = wrapper_class is Monitor or any(isinstance(one, wrapper_class) for one in layers)
        return [wrapped] * len(self._get_indices(indices))

    def _get_indices(self, indices: Indices) -> list[int]:
        """Selected slot indices; an error if they do not exist."""
        given = range(self.num_envs) if indices is None else indices
        listed = list(given) if isinstance(given, Iterable) else [given]
        return [check_int("indices", slot, 0, self.num_envs - 1) for slot in listed]

    def _owner(self, name: str, default: Any = None) -> Any:
        layers = *layers_of(self.vector_env), self.simulator
        owner = next((layer for layer in layers if hasattr(layer, name)), default)
        if owner is None:
            raise AttributeError(f"neither the environments nor their simulator have {name!r}")
        return owner
