"""The numbers that a learned policy is shown: which are there, and which is what."""

from __future__ import annotations

from typing import Any, NamedTuple

VERSION = 2
"""Of what the columns mean; a network trained with another one cannot read the tables."""
NEIGHBOUR_COLUMNS = 3
"""Unit bearing x, y; gain a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s."""
CONTEXT_COLUMNS = 22
"""‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours; time since the start, min, and how fresh it
is; own velocity and direction of f, averaged over a short and a long time, x, y each; how fast f
turns, rad/s; the carried heading, x, y; of the silhouettes joined before f whether they leave
nothing free, whether any is seen, both edges and the gaps beyond them, rad."""
BLOCKED = slice(16, 18)
"""Of the context: whether the joined silhouettes leave nothing free, whether any is seen."""
LEVEL_COLUMNS = 1
"""After the context, with a tank: log(1 + A/(r D̄))."""
WALL_COLUMNS = 12
"""After that, with a memory of walls: see ``tank_perception``."""


class Perceived(NamedTuple):
    """What one robot is shown, taken apart; every part is a view."""

    neighbours: Any
    """(..., K, NEIGHBOUR_COLUMNS); zero rows are absent."""
    obstacles: Any
    """(..., M, OBSTACLE_COLUMNS); zero rows are absent."""
    context: Any
    """(..., CONTEXT_COLUMNS and what a tank adds)."""


class PerceptionLayout(NamedTuple):
    """Which part of a flat row of numbers is what. Nobody else counts columns."""

    neighbour_slots: int
    """K."""
    obstacle_slots: int
    """M."""
    tank_columns: int = 0
    """What a tank adds to the context."""

    @property
    def context_columns(self) -> int:
        """Numbers that belong to no set."""
        return CONTEXT_COLUMNS + self.tank_columns

    @property
    def size(self) -> int:
        """Numbers for each robot."""
        sets = self.neighbour_slots * NEIGHBOUR_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return sets + self.context_columns

    def split(self, shown: Any) -> Perceived:
        """Take (..., size) apart, an array or a tensor."""
        leading, K, M = shown.shape[:-1], self.neighbour_slots, self.obstacle_slots
        stop, context = K * NEIGHBOUR_COLUMNS, shown.shape[-1] - self.context_columns
        return Perceived(
            shown[..., :stop].reshape(*leading, K, NEIGHBOUR_COLUMNS),
            shown[..., stop:context].reshape(*leading, M, OBSTACLE_COLUMNS),
            shown[..., context:],
        )
