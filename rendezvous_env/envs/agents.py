"""Agents of one environment by name, for PettingZoo."""

from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.env import ParallelEnv

from ..checks import check_action, floats, raise_invalid, short_repr
from ..deprecation import renamed_arguments
from ..engine.step import first_not_finite
from ..render.renderer import RENDER_MODES
from ..simulator import Simulator
from ..state_view import STANDING
from .guarantee import component_mask
from .spaces import of_one_robot
from .vector_env import SingleEnvMixin

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]
StepReturn = tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]
"""Observations, rewards, terminations, truncations and infos by agent name."""
_Space = TypeVar("_Space")


class RobotInfo(dict[str, Any]):
    """Infos of one robot, under the same keys in every step.

    ``info["summary"]`` returns the values of STANDING but is not a key, because libraries that
    stack infos need equal keys in every step. ``"summary" in info`` is True after the last step of
    an episode. Both are as in earlier versions.
    """

    __slots__ = ()

    def __missing__(self, key: str) -> dict[str, Any]:
        if key != "summary":
            raise KeyError(key)
        return {name: self[name] for name in STANDING}


class LastRobotInfo(RobotInfo):
    """Infos of one robot after the last step of an episode."""

    __slots__ = ()

    def __contains__(self, key: object) -> bool:
        return key == "summary" or super().__contains__(key)


class SpacesByName(Generic[_Space]):
    """Spaces by agent; the same object on every call, so that spaces can be seeded."""

    observation_spaces: dict[str, _Space]
    action_spaces: dict[str, _Space]

    def observation_space(self, agent: str) -> _Space:
        """Observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> _Space:
        """Action space of an agent."""
        return self.action_spaces[agent]


class BaseParallelEnv(
    SingleEnvMixin, SpacesByName[_Space], ParallelEnv[str, NDArray[np.float32], Any]
):
    """Base class of parallel environments, with agents by name."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo reads a plain class attribute
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }
    _left_out: tuple[str, ...] = ("robot_rewards",)
    """Infos of the vector environment that agents do not receive."""

    @renamed_arguments(teams="vector_env")
    def __init__(self, vector_env: Any) -> None:
        self._hold(vector_env)
        self.possible_agents = names_of(self.scenario.n_robots)
        self.agents: list[str] = []
        sees: Any = vector_env.single_observation_space
        does: Any = vector_env.single_action_space
        robots = dict(enumerate(self.possible_agents))
        self.observation_spaces = {name: of_one_robot(sees, i) for i, name in robots.items()}
        parts = self._parts = component_mask(vector_env)
        self.action_spaces = {
            name: of_one_robot(does, i, None if parts is None else parts[i])
            for i, name in robots.items()
        }
        self.state_space = vector_env.unwrapped.single_state_space

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start an episode: the first of a seed, or the next without one.

        Options are those of ``RendezvousParallelEnv``.

        Raises:
            ValueError: for an invalid option or seed; the state is unchanged.
        """
        observations, infos = self._reset(seed, options)
        self.agents = self.possible_agents.copy()
        return dict(zip(self.agents, observations[0], strict=True)), self._by_name(infos)

    @property
    def np_random(self) -> np.random.Generator:
        """Random generator for wrappers, seeded with the environment's seed, as in Gymnasium."""
        if self._np_random is None:
            self._np_random = np.random.default_rng()
        return self._np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._np_random, self._np_random_seed = value, -1

    @property
    def np_random_seed(self) -> int | None:
        """Seed of the environment and of ``np_random``; None before the first reset."""
        return self._np_random_seed

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``SingleEnvMixin.set_state``; updates ``agents`` to the robots that take actions."""
        super().set_state(state)
        simulator, follow = self.simulator, self.scenario.on_merge == "follow"
        robots = zip(self.possible_agents, simulator.active[0].tolist(), strict=True)
        over = bool(simulator.ended[0]) or not simulator.begun
        self.agents = [] if over else [name for name, active in robots if active or follow]

    def _by_name(self, infos: Mapping[str, Any]) -> Infos:
        """Infos by agent: values of the robot and of the environment."""
        kept = {
            key: values[0]
            for key, values in infos.items()
            if key[0] != "_" and key not in (*self._left_out, "summary")
        }
        return {
            name: RobotInfo(
                {key: (value[i] if value.ndim else value).item() for key, value in kept.items()}
            )
            for i, name in enumerate(self.possible_agents)
        }

    def _is_over(self, actions: Any) -> bool:
        """True if there are no agents and no actions; a RuntimeError before the first reset."""
        if not self.simulator.begun:
            raise RuntimeError("call reset() before step()")
        return not self.agents and isinstance(actions, Mapping) and not actions


def names_of(n_robots: int) -> list[str]:
    """Agent names of n robots."""
    return [f"robot_{i}" for i in range(n_robots)]


def check_robots(actions: Any, alive: Sequence[str], merged_into: NDArray[np.int64]) -> None:
    """Raise a KeyError unless the actions are for exactly the live agents.

    It names a missing, unknown or merged agent, and the survivor of a merged one.
    """
    if not isinstance(actions, Mapping):
        raise_invalid("actions", actions, f"a dict with an action for each of {alive}")
    names = names_of(len(merged_into))
    for name in actions:
        if name not in names:
            raise KeyError(f"{short_repr(name)} is no robot of this environment: {names}")
        if name not in alive:
            survivor = names[merged_into[names.index(name)]]
            why = "has ended" if survivor == name else f"has merged into {survivor}"
            raise KeyError(f"{name} {why} and takes no action; alive are {alive}")
    for name in alive:
        if name not in actions:
            raise KeyError(f"{name} is alive but has no action; alive are {alive}")


def table_of(
    actions: Mapping[str, Any], alive: Sequence[str], simulator: Simulator
) -> NDArray[np.float32]:
    """Actions by name as (1, n, a) float32, zero for merged robots; errors name the agent.

    Those of robots with fewer components than others are padded with zeros.
    """
    n, size = simulator.scenario.n_robots, simulator.scenario.action_size
    if simulator.scenario.pads_actions:
        return _padded_table(actions, alive, simulator)
    try:  # all at once; individually only to locate an error
        listed = np.array([actions[name] for name in alive])
        if listed.dtype != np.float32:
            listed = floats("actions", listed, np.float32)
        fits = listed.shape == (len(alive), size) and first_not_finite(listed.reshape(-1)) < 0
    except (LookupError, TypeError, ValueError, RuntimeError, ArithmeticError):
        fits = False
    if not fits or len(actions) != len(alive):
        check_robots(actions, alive, simulator.merged_into[0])
        for name in alive:
            check_action(name, actions[name], size)
        listed = np.array([floats("action", actions[name], np.float32) for name in alive])
    if len(alive) == n:
        return listed[None]
    table = np.zeros((1, n, size), np.float32)
    table[0, [name in alive for name in names_of(n)]] = listed
    return table


def _padded_table(
    actions: Mapping[str, Any], alive: Sequence[str], simulator: Simulator
) -> NDArray[np.float32]:
    """``table_of`` for robots with different numbers of action components."""
    check_robots(actions, alive, simulator.merged_into[0])
    mask = simulator.scenario.action_mask
    table = np.zeros((1, *mask.shape), np.float32)
    for robot, name in enumerate(names_of(len(mask))):
        if name in actions:
            check_action(name, actions[name], int(mask[robot].sum()))
            table[0, robot, mask[robot]] = floats("action", actions[name], np.float32)
    return table


class RendezvousAECEnv(parallel_to_aec_wrapper):
    """AEC form of a parallel environment.

    It validates each action at once, whereas PettingZoo's wrapper would fail after the last agent.
    """

    def step(self, action: Any) -> None:
        """Take the action of the selected agent, None if it has terminated.

        Raises:
            ValueError: for an invalid action, naming the agent; the state is unchanged.
        """
        robot = self.agent_selection
        if not (self.terminations[robot] or self.truncations[robot]):
            check_action(robot, action, self.action_space(robot).shape[0])
        elif action is not None:
            raise_invalid(f"action of {robot}, which has ended,", action, "None")
        super().step(action)
