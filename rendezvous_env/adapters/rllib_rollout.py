"""A rollout of many robots as arrays, cut into RLlib's episodes when it is done."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray
from ray.rllib.core.columns import Columns
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.env.utils.infinite_lookback_buffer import InfiniteLookbackBuffer

from .slots import RobotSlots, SlotStep


class Rollout:
    """Steps of B·n slots that were just reset, sorted into the episodes of robots."""

    observations: NDArray[np.float32]
    """(slots, ...), what the next actions are chosen from."""
    count: int
    """Steps of robots since the last cut."""

    def __init__(self, robots: RobotSlots, observations: NDArray[np.float32]) -> None:
        self._robots, self.observations = robots, observations
        slots = len(observations)
        self._ids = np.array([uuid4().hex for _ in range(slots)], dtype=object)
        self._lengths = np.zeros(slots, dtype=np.int64)
        self._steps: list[tuple[NDArray[np.float32], dict[str, NDArray[Any]], SlotStep]] = []
        self.count = 0

    def add(
        self, slots: NDArray[np.int64], chosen: dict[str, NDArray[Any]], actions: NDArray[Any]
    ) -> SlotStep:
        """Step the robots in these slots (k,), with columns of the module's outputs and actions in
        the teams' units, (k, ...) each.
        """
        total = len(self.observations)
        columns = {name: _spread(values, slots, total) for name, values in chosen.items()}
        step = self._robots.step(_spread(actions, slots, total))
        self._steps.append((self.observations, columns, step))
        self.observations = step.observations
        self.count += len(slots)
        return step

    def cut(self, *, only_ended: bool = False) -> Iterator[SingleAgentEpisode]:
        """Episodes and, unless ``only_ended``, parts of them since the last cut."""
        steps = [step for _, _, step in self._steps]
        seen = np.stack([before for before, _, _ in self._steps] + [self.observations])
        rewards = np.stack([step.rewards for step in steps])
        costs = {key: np.stack([step.costs[key] for step in steps]) for key in steps[0].costs}
        acted, ended = (np.stack([getattr(s, name) for s in steps]) for name in ("acted", "ended"))
        met = np.repeat(np.stack([step.met for step in steps]), self._robots.n_robots, axis=1)
        columns = {
            name: np.stack([chosen[name] for _, chosen, _ in self._steps])
            for name in self._steps[0][1]
        }
        lasts = _last_observations(steps)
        self._steps, self.count = [], 0
        for slot in range(acted.shape[1]):
            times = np.flatnonzero(acted[:, slot])
            for part in np.split(times, np.flatnonzero(ended[times, slot]) + 1):
                if not len(part):
                    continue
                end = int(part[-1])
                over = bool(ended[end, slot])
                if over or not only_ended:
                    last = lasts[end, slot] if over else seen[end + 1, slot]
                    yield self._episode(
                        slot,
                        np.concatenate([seen[part, slot], last[None]]),
                        rewards[part, slot],
                        {key: values[part, slot] for key, values in costs.items()},
                        {name: values[part, slot] for name, values in columns.items()},
                        terminated=bool(over and met[end, slot]),
                        truncated=bool(over and not met[end, slot]),
                    )
                if over:
                    self._ids[slot], self._lengths[slot] = uuid4().hex, 0
                else:
                    self._lengths[slot] += len(part)

    def _episode(
        self,
        slot: int,
        observations: NDArray[np.float32],
        rewards: NDArray[np.float32],
        costs: dict[str, NDArray[np.float64]],
        columns: dict[str, NDArray[Any]],
        **ends: bool,
    ) -> SingleAgentEpisode:
        """A part of one robot's episode, with one observation more than rewards; the costs of a
        step stand in the info of the observation after it.
        """
        actions = columns.pop(Columns.ACTIONS)
        told = ({key: costs[key][t].item() for key in costs} for t in range(len(rewards)))
        return SingleAgentEpisode(
            self._ids[slot],
            observations=InfiniteLookbackBuffer(observations),
            observation_space=self._robots.single_observation_space,
            infos=[{}, *told],
            actions=InfiniteLookbackBuffer(actions),
            action_space=self._robots.single_action_space,
            rewards=InfiniteLookbackBuffer(rewards),
            extra_model_outputs={
                name: InfiniteLookbackBuffer(values) for name, values in columns.items()
            },
            t_started=int(self._lengths[slot]),
            len_lookback_buffer=0,
            **ends,
        )


def _spread(values: NDArray[Any], slots: NDArray[np.int64], total: int) -> NDArray[Any]:
    """Rows (k, ...) of these slots among (total, ...); the others are zero."""
    spread = np.zeros((total, *values.shape[1:]), dtype=values.dtype)
    spread[slots] = values
    return spread


def _last_observations(steps: list[SlotStep]) -> dict[tuple[int, int], NDArray[np.float32]]:
    """Last observations of episodes by step and slot; where they were cut off, those to bootstrap
    from.
    """
    found: dict[tuple[int, int], NDArray[np.float32]] = {}
    for t, step in enumerate(steps):
        n = step.last.shape[1]
        for team in step.finished:
            found |= {(t, team * n + robot): step.last[team, robot] for robot in range(n)}
        cut_off = zip(step.bootstrapped.tolist(), step.bootstrap_observations, strict=True)
        found |= {(t, slot): observation for slot, observation in cut_off}
    return found
