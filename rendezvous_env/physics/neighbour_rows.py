"""The neighbour rows of an observation: what a robot makes of them without knowing a distance.

A row is a_ij g_ij; a row that is absent is zero.
"""

import math

from ..compilation import kernel
from .vectors import combine, dot, load


@kernel(inline="code")
def net_bearing_of(rows, neighbour_slots):
    """f_i = Σ_j a_ij g_ij, the sum of the neighbour rows.

    Args:
        rows: of one robot, (rows, d), m/s.
        neighbour_slots: K, how many of them, from the first, are neighbours.

    Returns:
        f_i, a triple, m/s, in the frame of the rows.
    """
    f = (0.0, 0.0, 0.0)
    for k in range(neighbour_slots):
        f = combine(1.0, f, 1.0, load(rows[k]))
    return f


@kernel(inline="code")
def degree_of(rows, neighbour_slots):
    """D_i = Σ_j a_ij, the sum of the lengths of the neighbour rows, a number, m/s.

    Arguments as ``net_bearing_of``.
    """
    total = 0.0
    for k in range(neighbour_slots):
        row = load(rows[k])
        total += math.sqrt(dot(row, row))
    return total
