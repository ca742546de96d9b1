"""What two neighbours are to each other: bearing, gain, row of an observation (paper, section II).

g_ij = (p_j − p_i)/‖p_j − p_i‖,    f_i = Σ_j a_ij g_ij
"""

import math

from ..compilation import kernel
from .vectors import difference, scaled, square, to_local


@kernel(inline="code")
def sighting(position_i, position_j, gain):
    """What robot i sees of its neighbour j: offset, square distance, distance and factor.

        a_ij g_ij = factor · offset,   factor = a_ij/‖p_j − p_i‖

    Args:
        position_i: p_i, a pair or triple, m.
        position_j: p_j, likewise.
        gain: a_ij, m/s; 0 without an edge.

    Returns:
        p_j − p_i (m), ‖p_j − p_i‖² (m²), ‖p_j − p_i‖ (m), and the factor (1/s), which is 0 where
        both stand in one place: there is no direction then.
    """
    offset = difference(position_i, position_j)
    distance_squared = square(offset)
    distance = math.sqrt(distance_squared)
    factor = gain / distance if distance_squared > 0.0 else 0.0
    return offset, distance_squared, distance, factor


@kernel(inline="code")
def observed(frame, offset, factor):
    """One row of an observation: factor · Rᵀ offset, never the negative zero.

    Args:
        frame: R, local → global, row by row, 4 or 9 numbers.
        offset: a pair or triple of the global frame, m.
        factor: what it is multiplied by, 1/s.

    Returns:
        The row in the robot's own frame, a pair or triple, m/s.
    """
    row = scaled(to_local(frame, offset), factor)
    if len(offset) == 2:
        return row[0] + 0.0, row[1] + 0.0
    return row[0] + 0.0, row[1] + 0.0, row[2] + 0.0
