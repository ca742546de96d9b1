"""Rollout of many robots as arrays, split into RLlib episodes at the end."""

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
    """Steps of B·n slots after a reset, split into robot episodes."""

    observations: NDArray[np.float32]
    """Current observations, (slots, ...), for the next actions."""
    count: int
    """Robot steps since the last cut."""

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
        """Step the robots of these slots, (k,).

        Module output columns and actions, (k, ...) each, are in the units of the environment.
        """
        total = len(self.observations)
        columns = {name: _spread(values, slots, total) for name, values in chosen.items()}
        step = self._robots.step(_spread(actions, slots, total))
        self._steps.append((self.observations, columns, step))
        self.observations = step.observations
        self.count += len(slots)
        return step

    def cut(self, *, only_ended: bool = False) -> Iterator[SingleAgentEpisode]:
        """Episodes since the last cut, and partial ones unless ``only_ended``."""
        before, chosen, steps = zip(*self._steps, strict=True)
        n, seen = self._robots.n_robots, np.stack([*before, self.observations])
        rewards, acted, ended = (
            np.stack([getattr(step, name) for step in steps])
            for name in ("rewards", "acted", "ended")
        )
        reports = [step.costs | step.conditions for step in steps]
        infos = {key: np.stack([report[key] for report in reports]) for key in reports[0]}
        columns = {name: np.stack([each[name] for each in chosen]) for name in chosen[0]}
        after = seen[1:].copy()  # next observations; at an end, those to bootstrap from
        for t, step in enumerate(steps):
            for team in step.finished:
                after[t, team * n : (team + 1) * n] = step.last[team]
            after[t, step.bootstrapped] = step.bootstrap_observations
        self._steps, self.count = [], 0
        for slot in range(acted.shape[1]):
            times = np.flatnonzero(acted[:, slot])
            for part in np.split(times, np.flatnonzero(ended[times, slot]) + 1):
                if not len(part):
                    continue
                end = int(part[-1])
                over, met = bool(ended[end, slot]), bool(steps[end].met[slot // n])
                if over or not only_ended:
                    yield self._episode(
                        slot,
                        np.concatenate([seen[part, slot], after[end, slot, None]]),
                        rewards[part, slot],
                        {key: values[part, slot] for key, values in infos.items()},
                        {name: values[part, slot] for name, values in columns.items()},
                        terminated=over and met,
                        truncated=over and not met,
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
        infos: dict[str, NDArray[Any]],
        columns: dict[str, NDArray[Any]],
        **ends: bool,
    ) -> SingleAgentEpisode:
        """Part of one robot's episode, with one more observation than rewards.

        Costs and conditions of a step are in the info of the next observation.
        """
        actions = columns.pop(Columns.ACTIONS)
        told = ({key: infos[key][t].item() for key in infos} for t in range(len(rewards)))
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
    """Scatter rows (k, ...) of these slots into zeros (total, ...)."""
    spread = np.zeros((total, *values.shape[1:]), dtype=values.dtype)
    spread[slots] = values
    return spread
