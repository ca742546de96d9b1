"""The times by which claims say that all have met."""

from __future__ import annotations

import numpy as np

from rendezvous_env.guarantee.bounds import merge_rise_allowance, time_bound

from .cases import Case
from .claim import Array

PATIENCE = 500.0
"""Nonholonomic robots have no time bound; after this many seconds they are held not to meet."""


def bound_a(case: Case, start: Array) -> Array:
    """Of theorem A, s."""
    return time_bound(case.scenario, start)


def bound_b(case: Case, start: Array) -> Array:
    """Of theorem B, s."""
    return time_bound(case.scenario, start) / case.margin**2


def bound_c(case: Case, start: Array) -> Array:
    """Of theorem C, s."""
    return time_bound(case.scenario, start, min_alignment=case.margin)


def bound_of_pieces(case: Case, start: Array) -> Array:
    """Time by which each piece of a disconnected graph has met, s: the proof of A holds for it."""
    scenario = case.scenario
    above = start + merge_rise_allowance(scenario)
    return 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(case: Case, start: Array) -> Array:
    """No theorem's: PATIENCE."""
    return np.full(start.shape, PATIENCE)


def no_time(case: Case, start: Array) -> Array:
    """One step shows what there is to see."""
    return np.zeros(start.shape)
