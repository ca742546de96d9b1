"""Theorem G: robots that weigh the bearings they see, on any graph, in continuous time and held.

**Assumptions.** ṗ_i = Σ_j c_ij g_ij with gains c_ij ≥ 0 that may depend on time, state, a network
or an adversary, and Σ_j c_ij ≥ c; robots whose action is their velocity, exact bearings, nothing
in the way. The graph may be directed and may switch, as long as at every moment all robots see
somebody (or all but one, the leader). Neighbours nearer than r merge. Law (1) has gains a_ij.

**Promise**, L0 = L(0) the size of the team at the start (``Simulator.size``):

* in continuous time T ≤ L0/(2 c κ(n)), in 3-D n w0/(2c), w0 = L0/2π; with a leader κ₁, 2(n−1)
  w0/c;
* inputs held over τ with τ Σ_j c_ij ≤ τ C < r, in the plane and in 3-D (D1):

      T ≤ L0 / (c s μ k) + (n − 1) τ,      s = sin(ψ/2),   k = (r − τC)/(r − τC + 2τc),
      ψ = π/n,  with a leader 5π/(12 (n−1)),  in 3-D π (1 − cos 5π/12)/(2 (n−1)),
      μ = ψ,  in 3-D 2π (1 − cos(ψ/2));

* for τ C ≤ r the hull of the team does not grow in a step that begins with linked robots r or
  more apart, which is every step but the first of given starts and those in which links change.
  There it grows by r at most, at most once for each merge: L0 stands for L(0) and that growth.

**Proof.** docs/proofs.md, G and D1.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...scenario.scenario import Scenario
from ..gains import gain_range
from . import assumptions as given
from .constants import (
    DIRECTED,
    SWITCHING,
    UNDIRECTED,
    checked,
    hull_growth,
    kind_of_links,
    largest_size,
    least_degrees,
    led,
    lightest_link,
    over_rate,
)
from .theorem import Asked, Bounds, Theorem

Array = NDArray[np.float64]

_WIDE = 5.0 * np.pi / 12.0
"""How far from the direction of the robot farthest from a leader the leader still lies deep."""

# ---- rates ---------------------------------------------------------------------------------------


def kappa(n: ArrayLike) -> Array:
    """κ(n) = min{Σ sin²x_i : Σx_i = π, 0 ≤ x_i ≤ π/2}, (...), without unit (proofs, G).

    κ(n) = min( n sin²(π/n), 1 + (n − 1) sin²(π/(2(n − 1))) )
    """
    m = np.asarray(n, dtype=np.float64)
    alike = m * np.sin(np.pi / m) ** 2
    one_flat = 1.0 + (m - 1.0) * np.sin(np.pi / (2.0 * (m - 1.0))) ** 2
    return np.asarray(np.minimum(alike, one_flat))


def shrinking(n: ArrayLike, dim: int, gain: ArrayLike, error: ArrayLike = 0.0) -> Array:
    """Least −L' of n robots that move with gains Σ_j c_ij ≥ c along their bearings, (...), m/s.

        2-D:   2 c κ(n) sin(π/n − η)/sin(π/n)                           (theorem G; N for η > 0)
        3-D:   4π c [cos η/n − sin η √(1 − 2/n)]

    With an error η, rad, all Σ_j c_ij must equal c; 0 where it is too large for any promise.
    """
    m, c, eta = np.asarray(n, dtype=np.float64), np.asarray(gain), np.asarray(error)
    if dim == 2:
        share = np.sin(np.pi / m - eta) / np.sin(np.pi / m)
        rate = 2.0 * c * kappa(m) * share
    else:
        rate = 4.0 * np.pi * c * (np.cos(eta) / m - np.sin(eta) * np.sqrt(1.0 - 2.0 / m))
    return np.where(eta < np.pi / m, np.maximum(rate, 0.0), 0.0)


def shrinking_to_leader(n: ArrayLike, dim: int, gain: ArrayLike) -> Array:
    """Least −L' if one robot may rest and see nobody, (...), m/s; otherwise as ``shrinking``.

    2-D:   2 c κ₁(n),   κ₁(n) = (n − 1) sin²(π/(2(n − 1)));      3-D:   π c/(n − 1)
    """
    others, c = np.asarray(n, dtype=np.float64) - 1.0, np.asarray(gain)
    if dim == 2:
        return np.asarray(2.0 * c * others * np.sin(np.pi / (2.0 * others)) ** 2)
    return np.asarray(np.pi * c / others)


# ---- times, of numbers ---------------------------------------------------------------------------


def size_bound(scenario: Scenario, initial_size: ArrayLike) -> Array:
    """Time by which law (1) has brought all robots together in continuous time, (...), s, from
    L(0), m.

        2-D   T ≤ L0 / (2 min_m c_m κ(m)),      3-D   T ≤ max_m m w0 / (2 c_m)
    """
    left = np.arange(2, scenario.n_robots + 1)
    slowest = shrinking(left, scenario.dim, _law_gains(scenario)[0]).min()
    return checked("initial_size", initial_size, "m") / slowest


def law_held_time(scenario: Scenario, initial_size: ArrayLike) -> Array:
    """The same with inputs held, (...), s, from L(0), m (D1); infinite for τ D̄ ≥ r."""
    gains, most = _law_gains(scenario)
    extent = checked("initial_size", initial_size, "m") + hull_growth(scenario)
    return _held_time(scenario, extent, gains, most)


def _held_time(scenario: Scenario, extent: ArrayLike, gains: Array, most: float) -> Array:
    """T of D1, s, of gains c_m, (n − 1,), and C, m/s: L0/(c s μ k) + (n − 1) τ as above."""
    m, step = np.arange(2, scenario.n_robots + 1), scenario.tau
    psi = np.asarray(np.pi / m, dtype=np.float64)
    if led(scenario):
        wide = _WIDE if scenario.dim == 2 else np.pi * (1.0 - math.cos(_WIDE)) / 2.0
        psi = np.asarray(wide / (m - 1.0), dtype=np.float64)
    measure = psi if scenario.dim == 2 else 2.0 * np.pi * (1.0 - np.cos(psi / 2.0))
    spare = max(scenario.merge_radius - step * most, 0.0)
    rates = gains * np.sin(psi / 2.0) * measure * spare / (spare + 2.0 * step * gains)
    return over_rate(extent, rates.min()) + (scenario.n_robots - 1) * step


# ---- the theorem ---------------------------------------------------------------------------------


def _law_gains(scenario: Scenario) -> tuple[Array, float]:
    """c_m, (n − 1,), and C of law (1), m/s: a_ij, scaled where it scales velocities (theory 4)."""
    gains, most = least_degrees(scenario), scenario.max_degree
    if kind_of_links(scenario.sensing_graph) != UNDIRECTED:
        gains = np.full(len(gains), scenario.bottleneck_weight)
    if given.nearest_hides(scenario):
        # behind others all but the nearest may be hidden, and its link may be the lightest
        gains = np.full(len(gains), lightest_link(scenario))
    if scenario.scales_velocity:
        slow = scenario.merge_radius / (2.0 * scenario.tau)
        gains, most = np.minimum(gains, slow), min(most, slow)
    return np.minimum(gains, scenario.speed_limit), most


def _gains(scenario: Scenario, asked: Asked) -> tuple[Array, float]:
    """c_m, (n − 1,), and C, m/s."""
    if asked.by == "law":
        return _law_gains(scenario)
    least, most = gain_range(scenario, asked.min_gain, asked.max_gain)
    return np.full(scenario.n_robots - 1, min(least, scenario.speed_limit)), most


def bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Both times and L."""
    gains, most = _gains(scenario, asked)
    left, one_rests = np.arange(2, scenario.n_robots + 1), led(scenario)
    initial = largest_size(scenario)
    extent = initial + hull_growth(scenario)
    followed = (shrinking_to_leader if one_rests else shrinking)(left, scenario.dim, gains).min()
    who = "law (1)" if asked.by == "law" else "every policy that weighs neighbours"
    mutual = kind_of_links(scenario.sensing_graph) == UNDIRECTED and not given.nearest_hides(
        scenario
    )
    first = "theorems 1 and G" if asked.by == "law" and mutual else "theorem G"
    scaled = asked.by == "law" and scenario.scales_velocity
    how = ", with velocities scaled to the step," if scaled else ""
    return Bounds(
        words=(
            f"{first}: {who}{how} meets in finite time, and the hull does not grow while linked "
            "robots are r or more apart"
        ),
        meets=True,
        time=float(_held_time(scenario, extent, gains, most)),
        continuous_time=float(over_rate(initial, followed)),
        hull=extent,
    )


def hull_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """L alone, where nobody need be seen."""
    return Bounds(hull=largest_size(scenario) + hull_growth(scenario))


_ON_ANY = (
    given.on_graphs(UNDIRECTED, DIRECTED, SWITCHING),
    given.connected,
    given.one_leader_at_most,
    given.velocity_inputs,
    given.bounded_errors,
    given.somebody_seen,
    given.nothing_in_the_way,
)
_WITHIN = (given.within_neighbours, given.exact_bearings)
_HULL = (given.velocity_inputs, given.bounded_errors, given.nothing_in_the_way)
THEOREMS = (
    Theorem("G", ("law",), (*_ON_ANY, *_WITHIN), bounds),
    Theorem("G", ("gains",), (*_ON_ANY, given.exact_bearings), bounds),
    Theorem(
        "G, the hull", ("gains",), (*_HULL, given.exact_bearings), hull_bounds, rendezvous=False
    ),
    Theorem(
        "G, the hull",
        ("law",),
        (*_HULL, given.all_neighbours_seen, *_WITHIN),
        hull_bounds,
        rendezvous=False,
    ),
)
"""A wrapper of gains keeps τ Σ_j c_ij ≤ r by itself."""
