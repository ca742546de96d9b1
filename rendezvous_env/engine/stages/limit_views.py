"""Stages of range and field of view that differ between robots, ahead of ``apply_noise``."""

from ...compilation import kernel
from ...graphs.edges import edge_weight, list_pairs
from ..memory import lane_count
from .apply_noise import see_in_view, see_within


@kernel
def limit_views(
    width,
    axes,
    entries,
    first,
    last,
    views,
    slots,
    in_order,
    links,
    robots,
    listed,
    weights,
    counts,
    rows,
):
    """Drop rows of neighbours beyond the range or outside the field of view of their observer.

    Rows are as in ``apply_noise``. Working memory: listed (2, E), weights (E,), counts (n,).
    """
    n = robots.shape[1]
    for block in range(first, last):
        found = list_pairs(links, block, n, listed[0], listed[1], weights)
        counts[:] = 0
        for end in range(2 * found):
            one, other = listed[0, end // 2], listed[1, end // 2]
            i, j = (other, one) if end % 2 else (one, other)
            if edge_weight(links, block, n, i, j, 1.0) > 0.0:
                slot = counts[i] if in_order else j - (j > i)
                counts[i] += 1
                if slot < slots or not in_order:
                    reach, half_field = views.reaches[i], views.half_fields[i]
                    pair, row = (robots[block, i], robots[block, j]), rows[block - first, i, slot]
                    see_within(width, axes, entries, reach, half_field, pair[0], pair[1], row)


@kernel
def limit_views_of_silhouettes(width, axes, first, last, views, own, points, batch, rows):
    """Drop obstacles outside the field of view of their observer, in ``batch`` environments.

    Each has ``points`` rows, from the row ``own`` on.
    """
    lanes, slots = lane_count(width), (rows.shape[2] - own) // points
    for block in range(first, last):
        count = min(lanes, batch - block * lanes)
        for i in range(rows.shape[1]):
            for m in range(slots):
                seen = rows[block - first, i, own + m * points : own + (m + 1) * points]
                see_in_view(axes, count, views.half_fields[i], seen)
