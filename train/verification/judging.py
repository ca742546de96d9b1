"""Whether what was measured is what a claim says."""

from __future__ import annotations

import numpy as np

from rendezvous_env import Scenario

from .claim import Array, Record, Verdict

_FLOAT64 = 1e-12
_FLOAT32 = 2.0**-20
_WATCHED = 1e-9
_CONFIDENCE = 3.0
"""Standard errors."""


def falls(record: Record) -> Verdict:
    """V falls by what is promised in every step, up to its first merge."""
    return record.slack, record.fell


def meets(record: Record) -> Verdict:
    """All have met by the time limit; the margin is the share of it that is left."""
    margin = 1.0 - record.times / record.limit
    return margin, record.times <= record.limit


def meets_on_average(record: Record) -> Verdict:
    """The mean of T/bound over the teams of a batch is at most 1, with three standard errors to
    spare.
    """
    ratio = record.times / record.limit
    spread = np.std(ratio, ddof=1) if np.isfinite(ratio).all() else np.inf
    margin = 1.0 - np.mean(ratio) - _CONFIDENCE * spread / np.sqrt(len(ratio))
    return np.full(len(ratio), margin), np.full(len(ratio), bool(margin >= 0))


def stays_apart(record: Record) -> Verdict:
    """No team of a disconnected graph meets: the margin is robots left less pieces."""
    scenario = record.case.scenario
    pieces = len(scenario.sensing_graph.components(scenario.n_robots))
    return (record.left - pieces).astype(np.float64), (record.left == pieces) & np.isinf(
        record.times
    )


def merges_within_bound(record: Record) -> Verdict:
    """V rises at a merge by no more than theory 5 allows."""
    return -record.excess, record.excess * record.start <= _FLOAT64 * (1.0 + record.start)


def is_lemma_1(record: Record) -> Verdict:
    """Σ‖f_i‖ ≥ 2 max a_ij; law (1) moves at f_i."""
    return record.total - 1.0, record.total >= 1.0 - _FLOAT32


def keeps(record: Record) -> Verdict:
    """What the claim watches has kept its promise in every step; watches are shares of a length,
    of which rounding takes far less than 10⁻⁹.
    """
    return record.watched, record.watched >= -_WATCHED


def rounding(scenario: Scenario, lyapunov: Array) -> Array:
    """By how much rounding alone can make V miss its promise, m²/s.

    V is summed in float64. Rows and actions are float32: f_i is off by 2⁻²⁴ D̄, u_i by as much
    again, in up to three components; V changes by 2 f_iᵀδu_i τ ≤ 2 D̄ · 2√3 · 2⁻²⁴ D̄ τ < 2⁻²¹ D̄²τ
    for each robot. Arcs have angles in float32 too, which doubles it.
    """
    return (
        _FLOAT64 * lyapunov + _FLOAT32 * scenario.n_robots * scenario.max_degree**2 * scenario.tau
    )
