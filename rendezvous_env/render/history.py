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
    """Done in the episode."""
    time: float
    """s."""
    positions: Floats
    """(n, d), m; a merged-away robot is where its survivor is."""
    headings: Floats
    """(n, k), rad: none, yaw, or yaw and pitch."""
    merged_into: NDArray[np.int64]
    """(n,), the robot that each one is now part of."""
    contact: Bools
    """(n,), whether the robot touched an obstacle in the step."""
    lyapunov: float
    """V, m²/s."""

    @property
    def active(self) -> Bools:
        """(n,), whether the robot still exists on its own."""
        return self.merged_into == np.arange(len(self.merged_into))


@dataclass(eq=False)
class History:
    """One team's episode since it was first looked at."""

    obstacles: Floats
    """(M, width), a table of ``obstacles.obstacle_set``."""
    initial_lyapunov: float
    """V at the start of the episode, m²/s."""
    moments: list[Moment] = field(default_factory=list)
    """In order of time."""

    def goes_on_with(self, moment: Moment, initial_lyapunov: float) -> bool:
        """Whether a moment is the next one of this episode."""
        follows = moment.steps == self.moments[-1].steps + 1
        return follows and initial_lyapunov == self.initial_lyapunov

    def ends_with(self, moment: Moment, obstacles: Floats) -> bool:
        """Whether a moment among these obstacles has been seen already."""
        last = self.moments[-1]
        same = np.array_equal(moment.positions, last.positions)
        return same and moment.steps == last.steps and np.array_equal(obstacles, self.obstacles)


def look(
    simulator: Simulator, histories: list[History], teams: int, contact: Bools | None
) -> list[History]:
    """Histories with the present moment added; an episode that is not the last one begins anew.

    Args:
        simulator: the teams.
        histories: of the first of them, or none yet.
        teams: how many to look at.
        contact: (B, n), who touched an obstacle in the step, if it is known.
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
        history = histories[team] if histories else None
        obstacles, initial = all_obstacles[team], initially[team]
        if history is None or not history.ends_with(moment, obstacles):
            if history is None or not history.goes_on_with(moment, initial):
                history = History(obstacles.copy(), initial)
            history.moments.append(moment)
        looked.append(history)
    return looked
