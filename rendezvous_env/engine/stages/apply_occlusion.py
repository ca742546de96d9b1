"""Stages for the observations of one environment at a time.

Occlusion, adversarial errors, sectors, compact rows, and delay.
"""

from ...compilation import kernel
from ...graphs.edges import load_links
from ...physics.vectors import exactly
from ...physics.worst_bias import outward_directions
from ...sensors.imperfections import errors_of, neighbour_seen
from ..memory import (
    load_fields,
    load_positions,
    obstacles_of,
    read_row,
    sensed_step,
    write_row,
)
from .apply_noise import end_of


@kernel
def apply_occlusion(
    axes,
    entries,
    lanes,
    first,
    last,
    errors,
    radii,
    slots,
    packed,
    links,
    robots,
    merged_into,
    obstacles,
    vectors,
    listed,
    weights,
    counts,
    observations,
):
    """Apply occlusion to both ends of every link, in row order; of an arc to one end.

    ``errors`` is a table of ``Imperfections``. ``radii``, (n,), are those of occluding robots, m.
    Working memory: vectors (3, n, d), listed (2, E), weights (E,), counts (n,).
    """
    n, positions, outward, misled = robots.shape[1], vectors[0], vectors[1], False
    for i in range(n):
        misled = misled or errors_of(errors, i).error > 0.0
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b = block * lanes + lane
            load_positions(robots[block], lane, lanes, positions)
            if misled:
                outward_directions(positions, merged_into[b], outward)
            world = obstacles_of(obstacles, b)
            scene, places = (world, merged_into[b], radii), (positions, outward)
            found = load_links(links, block, lane, n, listed[0], listed[1], weights)
            counts[:] = 0
            for end in range(2 * found):
                ends = listed[0, end // 2], listed[1, end // 2]
                i, j, slot = end_of(links, block, n, ends, end % 2, slots, packed, counts)
                if slot >= 0:
                    own, row = errors_of(errors, i), observations[b, i, slot]
                    frame = load_fields(robots[block, i], len(axes), lane, lanes, entries)
                    seen = exactly(read_row(row, 0, axes))
                    seen = neighbour_seen((i, j), seen, frame, own, places, scene)
                    write_row(seen, row, 0)


@kernel
def close_rows(first, last, slots, observations):
    """Move the rows of visible neighbours to the front, environment by environment."""
    for b in range(first, last):
        for i in range(observations.shape[1]):
            rows, filled = observations[b, i], 0
            for slot in range(slots):
                present = False
                for k in range(rows.shape[1]):
                    present = present or rows[slot, k] != 0.0
                if present:
                    for k in range(rows.shape[1]):
                        value = rows[slot, k]
                        rows[slot, k] = 0.0
                        rows[filled, k] = value
                    filled += 1


@kernel
def delay_observations(
    lanes, first, last, moves, delays, merged_into, environments, past, observations
):
    """Store the rows of this step, and replace them by those of an earlier step.

    ``delays`` (n,) are those of the robots, steps. Inactive robots observe nothing. ``past`` is
    (B, D + 1, n, K + M·S, d) for the longest delay D: step t is at t mod (D + 1).
    """
    length, n, sensed, d = past.shape[1:]
    kept = past.reshape(past.shape[0], length, n, sensed * d)
    shown = observations.reshape(observations.shape[0], n, observations.shape[2] * d)
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b, step = block * lanes + lane, sensed_step(environments[block], lane, lanes, moves)
            for i in range(n):
                rows, now = shown[b, i], kept[b, step % length, i]
                for k in range(len(now)):
                    now[k] = rows[k]
                for t in range(length if step == 0 else 0):  # no earlier observation
                    for k in range(len(now)):
                        kept[b, t, i, k] = rows[k]
                due, active = (
                    kept[b, (step + length - delays[i]) % length, i],
                    merged_into[b, i] == i,
                )
                for k in range(len(due)):
                    rows[k] = due[k] if active else 0.0
