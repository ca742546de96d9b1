"""Layout of observation rows, the single definition for all modules."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import floats
from ..deprecation import renamed_attribute
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes

ROWS_PER_OBSTACLE = {2: 2, 3: 8}
"""Rows per obstacle by dimension: both edges in the plane, eight boundary rays of its cone in
3-D."""
_TYPES = (np.dtype(np.float32), np.dtype(np.float64))  # of the arrays that compiled policies accept


class ObservedRows(NamedTuple):
    """Parts of an observation, as views."""

    neighbours: NDArray[Any]
    """a_ij g_ij, (..., K, d), m/s; the sum over K is the net bearing f_i."""
    obstacles: NDArray[Any]
    """Unit bearings to obstacle edges, (..., M, S, d)."""
    gravity: NDArray[Any] | None
    """Unit direction of gravity, (..., d); None if the robots do not sense it."""
    velocity: NDArray[Any] | None = None
    """The robot's own velocity, (..., d), m/s; None if the robots do not sense it."""


@lists_fields
@dataclass(frozen=True)
class ObservationLayout:
    """Rows of an observation ``(..., rows, d)``: neighbours, obstacles, then gravity or velocity.

    An absent row is zero. In mixed teams the last row is that of each robot's model.
    """

    dim: int
    """Dimension d, 2 or 3."""
    neighbour_slots: int
    """K, the maximum number of neighbours of a robot. With n − 1 each other robot has its own row,
    in index order; with fewer rows, present neighbours come first."""
    obstacle_slots: int = 0
    """M, the number of obstacles in an observation."""
    senses_gravity: bool = False
    """True if the last row is the direction of gravity (3-D nonholonomic robots)."""
    senses_velocity: bool = False
    """True if the last row is the robot's own velocity (double integrators)."""

    __repr__ = repr_of_changes

    silhouette_points = renamed_attribute("silhouette_points", "rows_per_obstacle")

    @property
    def rows_per_obstacle(self) -> int:
        """S, number of rows per obstacle."""
        return ROWS_PER_OBSTACLE[self.dim]

    @property
    def neighbours(self) -> slice:
        """Slice of the neighbour rows."""
        return slice(0, self.neighbour_slots)

    @property
    def obstacles(self) -> slice:
        """Slice of the obstacle rows, which reshape to (M, S, d)."""
        start = self.neighbour_slots
        return slice(start, start + self.obstacle_slots * self.rows_per_obstacle)

    @property
    def gravity(self) -> slice:
        """Slice of the gravity row; empty if the robots do not sense it."""
        start = self.obstacles.stop
        return slice(start, start + int(self.senses_gravity))

    @property
    def velocity(self) -> slice:
        """Slice of the velocity row; empty if the robots do not sense it."""
        start = self.obstacles.stop
        return slice(start, start + int(self.senses_velocity))

    @property
    def rows(self) -> int:
        """Total number of rows."""
        return max(self.gravity.stop, self.velocity.stop)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (rows, d) of one robot's observation."""
        return self.rows, self.dim

    def split(self, observations: NDArray[Any]) -> ObservedRows:
        """Split observations, (..., rows, d) or flat (..., rows·d), into their parts.

        With a single row, (..., 1, d) is not flat.

        Raises:
            ValueError: for another shape.
        """
        observations = self.checked(self.unflattened(observations))
        leading = observations.shape[:-2]
        points = (self.obstacle_slots, self.rows_per_obstacle, self.dim)
        return ObservedRows(
            neighbours=observations[..., self.neighbours, :],
            obstacles=observations[..., self.obstacles, :].reshape(*leading, *points),
            gravity=observations[..., -1, :] if self.senses_gravity else None,
            velocity=observations[..., -1, :] if self.senses_velocity else None,
        )

    def unflattened(self, observations: NDArray[Any]) -> NDArray[Any]:
        """View of flat observations (..., rows·d) as (..., rows, d); others unchanged."""
        shape = tuple(getattr(observations, "shape", ()))
        if shape[-2:] != self.shape and shape[-1:] == (self.rows * self.dim,):
            return np.reshape(observations, (*shape[:-1], *self.shape))
        return observations

    def checked(self, observations: Any) -> NDArray[Any]:
        """Observations as an array (..., rows, d); a ValueError for another shape."""
        if not isinstance(observations, np.ndarray) or observations.dtype not in _TYPES:
            observations = floats("observations", observations)
        if observations.shape[-2:] != self.shape:
            wanted = f"(..., {self.rows}, {self.dim}); ``unflattened`` converts flat ones"
            raise ValueError(
                f"observations have shape {observations.shape}; this layout needs {wanted}"
            )
        return observations

    def net_bearing(self, observations: NDArray[Any]) -> NDArray[Any]:
        """Net bearing f_i = Σ_j a_ij g_ij: the sum of the neighbour rows, (..., d), m/s."""
        rows = self.checked(observations)[..., self.neighbours, :]
        return np.asarray(np.sum(rows, axis=-2, dtype=np.float64))

    def degree(self, observations: NDArray[Any]) -> NDArray[Any]:
        """Degree D_i = Σ_j a_ij: the sum of the neighbour rows' lengths, (...), m/s, float64."""
        rows = self.checked(observations)[..., self.neighbours, :]
        return np.asarray(np.linalg.norm(rows, axis=-1).sum(axis=-1, dtype=np.float64))
