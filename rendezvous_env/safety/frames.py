"""Frames that robots look along: x along the net bearing f, so that what is seen does not turn with
the robot (theory 7).
"""

from typing import NamedTuple

from ..compilation import inner_kernel, kernel
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import cross, dot, load, split, store, without

FRAMES = ("net_bearing", "local")
_NEARLY_ALONG = 1e-6
"""A row whose part across f is shorter than this cannot give a frame its second axis, m/s."""
_CLEARLY_LONGER = 1.001
"""Rounding must not choose among equal rows: two neighbours' parts across f always are."""


class Sight(NamedTuple):
    """What looking along f takes to know."""

    neighbour_slots: int
    dead_zone: float


@kernel
def look_along_net_bearing(teams, arguments):
    """Turn observations (B, n, rows, d), m/s, into frames with x along f: row ← Fᵀ row, F = (f/‖f‖,
    …) (theory 7). Where ‖f‖ < δ the last frame is kept; the first ``visible_rows`` give it y.
    """
    if arguments[0].shape[3] == 2:  # the same; behind this question the compiler leaves out z
        _look_from(teams, arguments)
    else:
        _look_from(teams, arguments)


@inner_kernel(inline="code")
def _look_from(teams, arguments):
    observations, constants, visible_rows, frames, seen = arguments
    n, n_rows, d = observations.shape[1:]
    for team in range(teams[0], teams[1]):
        for i in range(n):
            rows, frame = observations[team, i], frames[team, i]
            f = net_bearing_of(rows, constants.neighbour_slots)
            strength, towards = split(f)
            if strength >= constants.dead_zone:
                _aim_frame(towards, rows, visible_rows, frame)
            x, y, z = load(frame[:, 0]), load(frame[:, 1]), load(frame[:, d - 1])  # d = 2: no z
            for row in range(n_rows):
                v = load(rows[row])
                along = (0.0 + dot(x, v), 0.0 + dot(y, v), 0.0 + dot(z, v))  # 0.0: never −0.0
                store(along, seen[team, i, row])


@inner_kernel(inline="code")
def _aim_frame(towards, rows, visible_rows, frame):
    """A right-handed frame with x = ``towards``; columns are its axes in the local frame.

    In the plane this is unique. In space y is the part across x of the row for which that part is
    longest, the first one of equals, or of the first local axis that is not along x.
    """
    store(towards, frame[:, 0])
    if frame.shape[0] == 2:
        frame[0, 1], frame[1, 1] = -towards[1], towards[0]
        return
    longest, across = _NEARLY_ALONG, (0.0, 0.0, 0.0)
    for k in range(visible_rows):
        part = without(load(rows[k]), towards)
        length, direction = split(part)
        if length > _CLEARLY_LONGER * longest + _NEARLY_ALONG:
            longest, across = length, direction
    if longest == _NEARLY_ALONG:
        axis = (1.0, 0.0, 0.0) if abs(towards[0]) < 0.9 else (0.0, 1.0, 0.0)
        _, across = split(without(axis, towards))
    store(across, frame[:, 1])
    store(cross(towards, across), frame[:, 2])
