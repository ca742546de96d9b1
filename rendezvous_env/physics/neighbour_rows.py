"""Net bearing and degree from the neighbour rows a_ij g_ij of an observation."""

from ..compilation import inner_kernel, kernel
from .vectors import ORIGIN, combine, load, norm


@inner_kernel(inline="code")
def net_bearing_of(rows, neighbour_slots):
    """f_i = Σ_j a_ij g_ij, a triple, m/s: the sum of the first K rows of one robot, (rows, d)."""
    f = ORIGIN
    for k in range(neighbour_slots):
        f = combine(1.0, f, 1.0, load(rows[k]))
    return f


@kernel(inline="code")
def degree_of(rows, neighbour_slots):
    """D_i = Σ_j a_ij, a number, m/s: the sum of their lengths; arguments as ``net_bearing_of``."""
    total = 0.0
    for k in range(neighbour_slots):
        total += norm(load(rows[k]))
    return total
