"""Whether what was measured is what a claim says."""

from __future__ import annotations

import numpy as np

from .claim import Record, Verdict

_FLOAT64 = 1e-12
_FLOAT32 = 2.0**-20
_WATCHED = 1e-9


def falls(record: Record) -> Verdict:
    """V falls by what is promised in every step, up to its first merge."""
    return record.slack, record.fell


def meets(record: Record) -> Verdict:
    """All have met by the time limit; the margin is the share of it that is left."""
    margin = 1.0 - record.times / record.limit
    return margin, record.times <= record.limit


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
