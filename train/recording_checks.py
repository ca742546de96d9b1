"""Whether recorded arrays are what a page can be made of: names, types, shapes, finite numbers."""

from __future__ import annotations

import numpy as np

from rendezvous_env.equations.shapes.obstacles import ABSENT, BALL, CAPSULE, POLYGON
from rendezvous_env.experiment.packing import CORNERS, DETAILS, KIND
from rendezvous_env.experiment.scenario import Scenario

from .recording import Recording

Shape = tuple[int | None, ...]
_MAY_BE_NAN = ("lyapunov_before_merge", "lyapunov_after_merge", "alignment")


def fault_of(recording: Recording, scenario: Scenario) -> str | None:
    """What is wrong with a recording of a scenario, in words; None if nothing is."""
    for name, shape in _shapes(recording, scenario).items():
        if name not in recording:
            return f"has no {name!r}"
        array = recording[name]
        if array.dtype.kind not in "bif":
            return f"{name} holds {array.dtype}, no numbers"
        if not _fits(array.shape, shape):
            wanted = tuple("any" if size is None else size for size in shape)
            return f"{name} has shape {array.shape}; it must be {wanted}"
        if np.isinf(array).any() or (name not in _MAY_BE_NAN and np.isnan(array).any()):
            return f"{name} holds a number that is not finite"
    return _fault_of_obstacles(recording["obstacles"])


def _shapes(recording: Recording, scenario: Scenario) -> dict[str, Shape]:
    """Of the arrays that a page shows."""
    n, d = scenario.n_robots, scenario.dim
    rows = scenario.observation_layout.shape[0]
    frames = max(1, len(np.atleast_1d(recording.get("times", np.zeros(1)))))
    times: Shape = (frames,)
    model = scenario.model
    seen: dict[str, Shape] = {"observations": (frames, n, rows, d)}
    if scenario.sensing.exact:
        velocities = d if model.keeps_velocity else 0
        seen = {
            "headings": (frames, n, model.n_angles),
            "velocities": (frames, n, velocities),
            "merged_into": (frames, n),
            "weights": (None, None),
        }
    return {
        "times": times,
        "positions": (frames, n, d),
        "frames": (frames, n, d, d),
        "active": (frames, n),
        "lyapunov": times,
        "lyapunov_before_merge": times,
        "lyapunov_after_merge": times,
        "contacts": (frames, n),
        "alignment": (frames, n),
        **seen,
        "obstacles": (None, None),
    }


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    return len(shape) == len(wanted) and all(
        size is None or size == own for own, size in zip(shape, wanted, strict=True)
    )


def _fault_of_obstacles(table: np.ndarray) -> str | None:
    """A table as ``experiment.packing`` says: kinds that are known, in rows with room for them."""
    width = table.shape[1]
    if len(table) and width < DETAILS:
        return f"obstacles: rows have {width} columns; they must have {DETAILS} or more"
    room = width - DETAILS
    for kind, corners in table[:, [KIND, CORNERS]] if len(table) else ():
        if kind not in (ABSENT, BALL, POLYGON, CAPSULE):
            return f"obstacles: a row has kind {kind}; known are {ABSENT} to {CAPSULE}"
        if kind == POLYGON and not (corners == int(corners) and 3 <= corners <= room // 2):
            return f"obstacles: a polygon has {corners} corners; it has room for {room // 2}"
        if kind == CAPSULE and room < 4:
            return f"obstacles: a capsule has {room} columns for its axis and radius; it needs 4"
    return None
