"""Bearings, net bearings and V (Zhao & Zheng, sections II, III).

g_ij = (p_j − p_i)/‖p_j − p_i‖,    f_i = Σ_j a_ij g_ij,    V = Σ_i Σ_j a_ij ‖p_i − p_j‖
"""

import math

from ..compilation import inner_kernel, kernel
from .vectors import dot, scaled, subtract, to_local


@inner_kernel(inline="code")
def sighting(position_i, position_j, gain):
    """Offset p_j − p_i (m), its square (m²), distance (m), and bearing factor (1/s) of neighbour j.

    a_ij g_ij = factor · (p_j − p_i). Positions are pairs or triples, m; the gain is a_ij, m/s, 0
    without an edge.
    """
    offset = subtract(position_j, position_i)
    gap = dot(offset, offset)
    distance = math.sqrt(gap)
    return offset, gap, distance, bearing_factor(gain, distance)


@inner_kernel(inline="code")
def bearing_factor(gain, distance):
    """a_ij/‖p_j − p_i‖, a number, 1/s; 0 for coincident robots, which have no direction."""
    return gain / distance if distance > 0.0 else 0.0


@kernel(inline="code")
def observed(frame, offset, factor):
    """Observation row factor · Rᵀ offset, a pair or triple in the robot's frame, m/s.

    R is a frame, see ``to_local``; the offset is in the global frame, m; the factor is in 1/s.
    """
    return scaled(to_local(frame, offset), factor)


@inner_kernel
def distance_squared(positions, i, j):
    """‖p_i − p_j‖² of robots i and j, m²; positions (n, d), m."""
    total = 0.0
    for k in range(positions.shape[1]):
        total += (positions[j, k] - positions[i, k]) ** 2
    return total


@kernel
def lyapunov_of_links(positions, links):
    """V = Σ_i Σ_j a_ij ‖p_i − p_j‖, a number, m²/s, with each edge counted twice.

    Positions are (n, d), m; links are (first, second, weight), (E,) each, m/s, with weight 0 for an
    absent link and (a_ij + a_ji)/2 for a directed pair.
    """
    first, second, weight = links
    total = 0.0
    for e in range(len(first)):
        if weight[e] > 0.0:
            total += weight[e] * math.sqrt(distance_squared(positions, first[e], second[e]))
    return 2.0 * total


@kernel
def net_bearings_of_links(positions, links, out):
    """Write f_i = Σ_j a_ij g_ij of every robot to ``out``, (n, d), m/s, in the global frame.

    Arguments as ``lyapunov_of_links``. With sorted links, terms are added in neighbour order.
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
    """f_i = Σ_j a_ij g_ij of a directed graph with weights a_ij, (n, n), m/s.

    Arguments as ``net_bearings_of_links``.
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
