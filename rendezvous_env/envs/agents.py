"""The robots of one team by name: who is alive, who may act, and what each is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from ..checks import check_action, floats, refuse, shown
from ..engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from ..outcome import StepOutput
from ..simulator import Simulator

_FLOAT32 = np.dtype(np.float32)
Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]
StepReturn = tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]
"""Observations, rewards, terminations, truncations and infos, by name."""
_Space = TypeVar("_Space")


class SpacesByName(Generic[_Space]):
    """Spaces of single robots; the same object each time, so that each can be seeded."""

    observation_spaces: dict[str, _Space]
    action_spaces: dict[str, _Space]

    def observation_space(self, agent: str) -> _Space:
        """The space of one robot's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> _Space:
        """The space of one robot's actions."""
        return self.action_spaces[agent]


def names_of(n_robots: int) -> list[str]:
    """What the robots of a team are called."""
    return [f"robot_{i}" for i in range(n_robots)]


def alive_in(teams: Mapping[str, NDArray[Any]], on_merge: str) -> list[str]:
    """Who takes actions in a state of a simulator of one team."""
    into = teams["merged_into"][0].tolist()
    names = names_of(len(into))
    if teams["episode"][0] < 0 or teams["status"][0] in (RENDEZVOUS, TIME_OUT):
        return []
    if on_merge == "follow":
        return names
    return [name for i, name in enumerate(names) if into[i] == i]


def check_robots(actions: Any, alive: Sequence[str], merged_into: NDArray[np.int64]) -> None:
    """Refuse actions, by name, that are not for exactly the robots alive.

    Raises:
        KeyError: naming the robot that is missing, unknown or gone, and what it is now part of.
        ValueError: if the actions are no dict.
    """
    if not isinstance(actions, Mapping):
        refuse("actions", actions, f"a dict with an action for each of {alive}")
    names = names_of(len(merged_into))
    for name in actions:
        if name not in names:
            raise KeyError(f"{shown(name)} is no robot of this team: {names}")
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
    """Actions by name as (1, n, a) float32, refused by name; zero for robots that are gone."""
    n, size = simulator.scenario.n_robots, simulator.scenario.action_size
    try:
        listed = np.array([actions[name] for name in alive])
        if listed.dtype is not _FLOAT32:
            listed = floats("actions", listed, np.float32)
            if not np.isfinite(listed).all():
                _explain(actions, alive, simulator)
    except (
        KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, RuntimeError,
    ):  # fmt: skip
        listed = np.empty(0, np.float32)
    if listed.shape != (len(alive), size) or len(actions) != len(alive):
        _explain(actions, alive, simulator)
    if len(alive) == n:
        return listed[None]
    names, living = names_of(n), set(alive)
    table = np.zeros((1, n, size), np.float32)
    table[0, [name in living for name in names]] = listed
    return table


def _explain(actions: Any, alive: Sequence[str], simulator: Simulator) -> None:
    """Raise what is wrong with these actions, naming the robot."""
    check_robots(actions, alive, simulator.merged_into[0])
    for name in alive:
        check_action(name, actions[name], simulator.scenario.action_size)


def infos_of_start(names: Sequence[str], simulator: Simulator) -> Infos:
    """What the robots are told at the start of an episode."""
    clearances, statistics = simulator.clearance[0].tolist(), simulator.first_episode_statistics()
    statistics |= dict.fromkeys(simulator.costs, 0.0)
    return {
        name: {"merged_into": i, "contact": False, "clearance": clearances[i], **statistics}
        for i, name in enumerate(names)
    }


def step_results(
    observations: NDArray[np.float32],
    outcome: StepOutput,
    simulator: Simulator,
    names: Sequence[str],
    alive: list[str],
) -> tuple[StepReturn, list[str]]:
    """What the robots that were alive are told of a step, and who still is."""
    status = outcome.status.item(0)
    over, met = status != RUNNING, status == RENDEZVOUS
    seen = dict(zip(names, observations, strict=True))
    rewards = dict(zip(names, outcome.robot_rewards[0].tolist(), strict=True))
    statistics = simulator.first_episode_statistics(outcome)
    into = simulator.merged_into_of_first()
    (contacts,), (clearances,) = outcome.contact.tolist(), outcome.clearance.tolist()
    infos: Infos = {}
    for name, survivor, contact, clearance in zip(names, into, contacts, clearances, strict=True):
        infos[name] = info = statistics.copy()  # then item by item: half as long as at once
        info["merged_into"], info["contact"], info["clearance"] = survivor, contact, clearance
    for key, (costs,) in ((key, table.tolist()) for key, table in simulator.costs.items()):
        for info, cost in zip(infos.values(), costs, strict=True):
            info[key] = cost
    if len(alive) < len(names):
        seen = {name: seen[name] for name in alive}
        infos = {name: infos[name] for name in alive}
        rewards = {name: rewards[name] for name in alive}
    ends, truncations = dict.fromkeys(alive, met), dict.fromkeys(alive, over and not met)
    left, (active,) = alive, outcome.active.tolist()
    if active.count(True) < len(alive):
        if not met and simulator.scenario.on_merge == "remove":
            lives = dict(zip(names, active, strict=True))
            ends = {name: not lives[name] for name in alive}
            truncations = {name: over and not ended for name, ended in ends.items()}
            left = [name for name in alive if not ends[name]]
    if over:
        left = []
        for info in infos.values():
            info["summary"] = statistics.copy()
    return (seen, rewards, ends, truncations, infos), left


class OneAfterAnother(parallel_to_aec_wrapper):
    """PettingZoo's AEC form of a parallel environment of ours.

    PettingZoo keeps the actions until the last robot has chosen; one that is wrong would be found
    only then, when its robot can take it back no more.
    """

    def step(self, action: Any) -> None:
        """Take the action of the robot whose turn it is; None of one that has ended.

        Raises:
            ValueError: for anything else, naming the robot; nothing has changed then.
        """
        robot = self.agent_selection
        if not (self.terminations[robot] or self.truncations[robot]):
            check_action(robot, action, self.action_space(robot).shape[0])
        elif action is not None:
            refuse(f"action of {robot}, which has ended,", action, "None")
        super().step(action)
