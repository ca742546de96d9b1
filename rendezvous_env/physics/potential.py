"""What neighbours are to each other: bearing, gain, net bearing, and V (paper, sections II, III).

g_ij = (p_j − p_i)/‖p_j − p_i‖,    f_i = Σ_j a_ij g_ij,    V = Σ_i Σ_j a_ij ‖p_i − p_j‖
"""

import math

from ..compilation import inner_kernel, kernel
from .vectors import dot, scaled, subtract, to_local


@inner_kernel(inline="code")
def sighting(position_i, position_j, gain):
    """What robot i sees of its neighbour j: p_j − p_i (m), ‖p_j − p_i‖² (m²), ‖p_j − p_i‖ (m), and
    the factor (1/s) with a_ij g_ij = factor · (p_j − p_i).

    Positions are pairs or triples, m; the gain is a_ij, m/s, 0 without an edge.
    """
    offset = subtract(position_j, position_i)
    gap = dot(offset, offset)
    distance = math.sqrt(gap)
    return offset, gap, distance, bearing_factor(gain, distance)


@inner_kernel(inline="code")
def bearing_factor(gain, distance):
    """a_ij/‖p_j − p_i‖, a number, 1/s; 0 where both stand in one place, without direction."""
    return gain / distance if distance > 0.0 else 0.0


@kernel(inline="code")
def observed(frame, offset, factor):
    """One row of an observation: factor · Rᵀ offset, a pair or triple of the robot's frame, m/s.

    Of a frame R, see ``to_local``, an offset in the global frame, m, and a factor, 1/s.
    """
    return scaled(to_local(frame, offset), factor)


@inner_kernel
def distance_squared(positions, i, j):
    """‖p_i − p_j‖² of the robots with indices i and j of one team, m²; positions (n, d), m."""
    total = 0.0
    for k in range(positions.shape[1]):
        total += (positions[j, k] - positions[i, k]) ** 2
    return total


@kernel
def lyapunov_of_links(positions, links):
    """V = Σ_i Σ_j a_ij ‖p_i − p_j‖ of one team, a number, m²/s: each edge counts twice.

    Of positions (n, d), m, and links (first, second, weight), (E,) each, m/s: 0 where there is no
    link, (a_ij + a_ji)/2 where the two differ.
    """
    first, second, weight = links
    total = 0.0
    for e in range(len(first)):
        if weight[e] > 0.0:
            total += weight[e] * math.sqrt(distance_squared(positions, first[e], second[e]))
    return 2.0 * total


@kernel
def net_bearings_of_links(positions, links, out):
    """f_i = Σ_j a_ij g_ij of every robot into ``out``, (n, d), m/s, in the global frame; arguments
    as ``lyapunov_of_links``. Sorted links add up in the order of the neighbours.
    """
    first, second, weight = links
    out[:] = 0.0
    for e in range(len(first)):
        if weight[e] > 0.0:
            i, j = first[e], second[e]
            gap = distance_squared(positions, i, j)
            if gap > 0.0:
                gain = weight[e] / math.sqrt(gap)
                for k in range(positions.shape[1]):
                    pull = gain * (positions[j, k] - positions[i, k])
                    out[i, k] += pull
                    out[j, k] -= pull


@kernel
def net_bearings_of_arcs(positions, arcs, out):
    """The same of arcs a_ij, (n, n), m/s, 0 where robot i does not see robot j: a_ij need not be
    a_ji. Arguments as ``net_bearings_of_links``.
    """
    out[:] = 0.0
    for i in range(arcs.shape[0]):
        for j in range(arcs.shape[0]):
            if arcs[i, j] > 0.0:
                gap = distance_squared(positions, i, j)
                if gap > 0.0:
                    gain = arcs[i, j] / math.sqrt(gap)
                    for k in range(positions.shape[1]):
                        out[i, k] += gain * (positions[j, k] - positions[i, k])
