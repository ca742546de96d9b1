"""What a team has done so far, as far as a picture shows it; kept only where one is drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..simulator import Simulator
from .scene import Bools, Floats


class Moment(NamedTuple):
    """A team after some step."""

    steps: int
    time: float  # s
    positions: Floats  # (n, d), m; a merged-away robot is where its survivor is
    headings: Floats  # (n, k), rad: none, yaw, or yaw and pitch
    merged_into: NDArray[np.int64]  # (n,)
    contact: Bools  # (n,), in the step
    lyapunov: float  # V, m²/s

    @property
    def active(self) -> Bools:
        """(n,), whether the robot still exists on its own."""
        return self.merged_into == np.arange(len(self.merged_into))


@dataclass(eq=False)
class History:
    """One team's episode since the renderer first saw it."""

    obstacles: Floats  # (M, width), a table of ``obstacles.obstacle_set``
    initial_lyapunov: float  # V at the start of the episode, m²/s
    moments: list[Moment] = field(default_factory=list)


def look(
    simulator: Simulator, histories: list[History], teams: int, contact: Bools | None
) -> list[History]:
    """Histories of the first ``teams`` with the present moment added; another episode begins
    another history. ``contact`` (B, n) says who touched an obstacle in the step, if it is known.
    """
    if contact is None:
        contact = np.zeros(simulator.merged_into.shape, dtype=np.bool_)
    columns = (
        simulator.steps[:teams].tolist(),
        simulator.time[:teams].tolist(),
        simulator.positions[:teams].copy(),
        simulator.headings[:teams],
        simulator.merged_into[:teams],
        contact[:teams].copy(),
        simulator.lyapunov()[:teams].tolist(),
    )
    all_obstacles, initially = simulator.obstacles, simulator.initial_lyapunov.tolist()
    looked = []
    for team, moment in enumerate(map(Moment, *columns)):
        obstacles, initial = all_obstacles[team], initially[team]
        history = histories[team] if histories else History(obstacles.copy(), initial)
        last = history.moments[-1] if history.moments else None
        seen_already = (
            last is not None
            and moment.steps == last.steps
            and np.array_equal(moment.positions, last.positions)
            and np.array_equal(obstacles, history.obstacles)
        )
        if not seen_already:
            goes_on = last is None or moment.steps == last.steps + 1
            if not (goes_on and initial == history.initial_lyapunov):
                history = History(obstacles.copy(), initial)
            history.moments.append(moment)
        looked.append(history)
    return looked
