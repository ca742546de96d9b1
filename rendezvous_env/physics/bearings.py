"""What two neighbours are to each other: bearing, gain, row of an observation (paper, section II).

g_ij = (p_j − p_i)/‖p_j − p_i‖,    f_i = Σ_j a_ij g_ij
"""

import math

from ..compilation import kernel
from .vectors import difference, scaled, square, to_local


@kernel(inline="code")
def sighting(position_i, position_j, gain):
    """What robot i sees of its neighbour j: p_j − p_i (m), ‖p_j − p_i‖² (m²), ‖p_j − p_i‖ (m), and
    the factor (1/s) with a_ij g_ij = factor · (p_j − p_i).

    Positions are pairs or triples, m; the gain is a_ij, m/s, 0 without an edge.
    """
    offset = difference(position_i, position_j)
    distance_squared = square(offset)
    distance = math.sqrt(distance_squared)
    return offset, distance_squared, distance, bearing_factor(gain, distance)


@kernel(inline="code")
def bearing_factor(gain, distance):
    """a_ij/‖p_j − p_i‖, a number, 1/s; 0 where both stand in one place, without direction."""
    return gain / distance if distance > 0.0 else 0.0


@kernel(inline="code")
def observed(frame, offset, factor):
    """One row of an observation: factor · Rᵀ offset, a pair or triple of the robot's frame, m/s.

    Of a frame R, see ``to_local``, an offset in the global frame, m, and a factor, 1/s.
    """
    return scaled(to_local(frame, offset), factor)
