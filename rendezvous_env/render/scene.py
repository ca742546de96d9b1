"""Scene elements shared by all renderers: pygame, Matplotlib and the report page.

Obstacle shapes, paths, marks and extents, in metres; colours are in ``palette``.
"""

import numpy as np
from numpy.typing import NDArray

from ..checks import counted
from ..obstacles.obstacle_set import outlines

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def outermost(positions: Floats, obstacles: Floats) -> Floats:
    """Points (m, d) that must be visible: positions (..., d) and extents of all shapes."""
    d = positions.shape[-1]
    arms = np.concatenate([np.eye(d), -np.eye(d)])
    ends = [
        vertices if len(vertices) else centre + radius * arms
        for centre, radius, vertices in outlines(obstacles, d)
    ]
    return np.concatenate([positions.reshape(-1, d), *ends])


def facing(headings: Floats, dim: int) -> Floats:
    """Unit body axes (..., d) from headings (..., k), rad: yaw, or yaw and pitch."""
    yaw, pitch = headings[..., 0], headings[..., 1:].sum(axis=-1)
    flat = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch)], axis=-1)
    return flat if dim == 2 else np.concatenate([flat, np.sin(pitch)[..., None]], axis=-1)


def ways(positions: Floats, active: Bools) -> list[Floats]:
    """Path of each robot up to its merge, (T', d), from positions (T, n, d)."""
    last = active.sum(axis=0) + 1  # one more frame: the position of the merge
    return [positions[: last[robot], robot] for robot in range(positions.shape[1])]


def ended(flags: Bools) -> NDArray[np.int64]:
    """Frame and robot, (m, 2), of falling edges of flags (T, n): merges, for ``active``."""
    return np.argwhere(flags[:-1] & ~flags[1:]) + np.array([1, 0])


def sights(rows: Floats, positions: Floats, linked: Bools, in_order: bool) -> Bools:
    """True if robot i sees robot j, (n, n).

    Args:
        rows: neighbour rows, (n, K, d), in the global frame; zero where no robot is visible.
        positions: (n, d), m.
        linked: whether i has a link to j, (n, n).
        in_order: whether row k of robot i is of robot k, or k + 1 from i on; else a row is taken
            for the linked robot whose direction is the nearest.
    """
    n, present = len(positions), np.asarray(rows.any(axis=-1))
    seen = np.zeros((n, n), dtype=np.bool_)
    if in_order:
        i, k = np.nonzero(present[:, : n - 1])
        seen[i, k + (k >= i)] = True
        return seen & linked
    for robot in np.flatnonzero(present.any(axis=1)).tolist():
        others = np.flatnonzero(linked[robot])
        offsets = positions[others] - positions[robot]
        lengths = np.linalg.norm(offsets, axis=-1, keepdims=True)
        along = offsets / np.where(lengths > 0.0, lengths, 1.0)
        alike = rows[robot][present[robot]] @ along.T
        for _ in range(min(alike.shape)):
            row, other = np.unravel_index(np.argmax(alike), alike.shape)
            seen[robot, others[other]] = True
            alike[row], alike[:, other] = -np.inf, -np.inf
    return seen


def in_contact(count: int) -> str:
    """Contacts as text, counted once per robot and step."""
    return f"{counted(count, 'robot-step')} in contact"
