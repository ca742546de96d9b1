"""Observations in frames with x along f: a policy does not notice how the world is turned."""

from ..compilation import inlined_kernel, kernel, unfolded_kernel
from ..engine.pool.sharing import each_block
from ..equations.rows import net_bearing_of
from ..equations.vectors import cross, load, split, store, without
from .teams import teams_of_block

_NEARLY_ALONG = 1e-6
"""A row whose part across f is shorter than this cannot give a frame its second axis, m/s."""
_CLEARLY_LONGER = 1.001
"""Rounding must not choose among equal rows: two neighbours' parts across f always are."""


@kernel
def look_along_net_bearing(share, observations, constants, visible_rows, frames, seen):
    """Turn observations into frames with x along f, for the teams that this thread takes.

        row ← Fᵀ row,   F = (f/‖f‖, …)                              (theory 7)

    Where ‖f‖ < δ the last frame is kept.

    Args:
        share: this thread's part, as sharing.py says.
        observations: (B, n, rows, d) float32, in the robots' own frames; neighbour rows in m/s.
        constants: the number of neighbour rows, and δ, m/s, see action_filter.py.
        visible_rows: how many rows, from the first, may give a frame its second axis.
        frames: F, (B, n, d, d), columns are unit vectors; brought up to date.
        seen: rows along f, of the shape and units of ``observations``; filled in.

    Returns:
        Whether all blocks are done, see ``each_block``.
    """
    arguments = observations, constants, visible_rows, frames, seen
    return each_block(share, _look_from_teams, arguments)


@unfolded_kernel
def _look_from_teams(block, arguments):
    observations, constants, visible_rows, frames, seen = arguments
    first, last = teams_of_block(block, len(observations))
    n, n_rows, d = observations.shape[1:]
    for team in range(first, last):
        for i in range(n):
            rows, frame = observations[team, i], frames[team, i]
            f = net_bearing_of(rows, constants.neighbour_slots)
            strength, towards = split(f)
            if strength >= constants.dead_zone:
                _aim_frame(towards, rows, visible_rows, frame)
            for row in range(n_rows):
                for axis in range(d):
                    along = 0.0
                    for k in range(d):
                        along += frame[k, axis] * rows[row, k]
                    seen[team, i, row, axis] = along


@inlined_kernel
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
