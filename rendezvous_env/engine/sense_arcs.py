"""What the robots of a team see along arcs, which can be one-way."""

from ..compilation import inlined_kernel
from ..equations.bearings import observed, sighting
from .memory import read, write


@inlined_kernel
def sense_arcs(block, layout, constants, teams, links, results, buffers, hand):
    """Every pair of one team in index order, and of its two arcs those that are there."""
    n, width, axes = hand.lengths.shape[0], layout.width, layout.axes
    buffers.rows[:] = 0.0
    hand.counts[:] = 0
    for i in range(n):
        for j in range(i + 1, n):
            both = links.weights[block, i, j] + links.weights[block, j, i]
            if both > 0.0:
                _, square, distance, _ = sighting(
                    read(teams.positions[block, i], 0, width, axes),
                    read(teams.positions[block, j], 0, width, axes),
                    both,
                )
                buffers.pair[0] += 0.5 * both * distance
                buffers.pair[1] = min(buffers.pair[1], square)
                _look(i, j, block, layout, constants, teams, links, results, buffers, hand)
                _look(j, i, block, layout, constants, teams, links, results, buffers, hand)


@inlined_kernel
def _look(i, j, block, layout, constants, teams, links, results, buffers, hand):
    """Write the row of robot j in the observation of robot i, if that sees it."""
    gain = links.weights[block, i, j]
    if gain > 0.0:
        width, n, slots = layout.width, hand.lengths.shape[0], constants.neighbour_slots
        # with a row for each other robot it has its own; with fewer those present stand first
        slot = j - (j > i) if slots == n - 1 else hand.counts[i]
        hand.counts[i] += 1
        if slot < slots:
            offset, _, _, factor = sighting(
                read(teams.positions[block, i], 0, width, layout.axes),
                read(teams.positions[block, j], 0, width, layout.axes),
                gain,
            )
            frame = read(teams.frames[block, i], 0, width, layout.entries)
            row = i * (buffers.rows.shape[0] // n) + slot
            write(observed(frame, offset, factor), buffers.rows[row], 0, 0, width)
        else:
            results.crowded[block] = i
