"""V and the net bearings f of one team, from its places and links (paper, section III).

V = Σ_i Σ_j a_ij ‖p_i − p_j‖,    f_i = Σ_j a_ij g_ij
"""

import math

from ..compilation import kernel


@kernel
def distance_squared(positions, i, j):
    """‖p_i − p_j‖² of the robots with indices i and j of one team, m²; positions (n, d), m."""
    square = 0.0
    for k in range(positions.shape[1]):
        square += (positions[j, k] - positions[i, k]) ** 2
    return square


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
            square = distance_squared(positions, i, j)
            if square > 0.0:
                gain = weight[e] / math.sqrt(square)
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
                square = distance_squared(positions, i, j)
                if square > 0.0:
                    gain = arcs[i, j] / math.sqrt(square)
                    for k in range(positions.shape[1]):
                        out[i, k] += gain * (positions[j, k] - positions[i, k])
