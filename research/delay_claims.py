"""Claims of theorem E1: bearings with any delay per pair (guarantees 11)."""

from __future__ import annotations

import math

import numpy as np
from adversarial_graphs import draw_teams
from continuous_time import Array, Batch, Bearings, ContinuousTrial, Law
from continuous_time_claims import ContinuousTimeClaim, stays_below
from continuous_time_laws import Random, followed

from rendezvous_env.graphs.weights import bottleneck_weight, max_degree
from train.verify.monitors import unit

_KEPT = 8
"""Number of stored moments; the oldest admissible one is close to the maximum delay."""

_MARGINS = (0.45, 0.9)
"""Minimum alignments ε of law (4); smaller ones only increase the rendezvous time."""


class Stale:
    """Delayed bearings, with a separate delay for each pair.

    Bearings of robots that have just merged are current. A third of the teams have the maximum
    delay, a third a constant delay for each pair, and a third a new delay at each call.

    Args:
        teams: the environments.
        random: random number generator.
        oldest: maximum delay of a bearing, (B,), s.
    """

    def __init__(self, teams: Batch, random: Random, oldest: Array) -> None:
        self._random, self._oldest = random, oldest
        self._seen = np.repeat(teams.look().bearings[None], _KEPT, axis=0)
        self._when = np.zeros((_KEPT, len(oldest)))
        self._kind = random.integers(3, size=(len(oldest), 1, 1))
        self._own = random.random(teams.weights.shape)
        self._calls = 0

    def __call__(self, teams: Batch, sights: Bearings) -> Array:
        """Bearings, (B, n, n, d)."""
        if teams.merged.any():
            fresh = teams.merged[:, :, None] | teams.merged[:, None]
            self._seen[:, fresh] = sights.bearings[fresh]
        slot = self._calls % _KEPT
        self._seen[slot], self._when[slot] = sights.bearings, teams.time
        self._calls += 1
        drawn = self._random.random(self._own.shape)
        share = np.choose(self._kind, (np.ones_like(drawn), self._own, drawn))
        since = teams.time[:, None, None] - share * self._oldest[:, None, None]
        when = self._when[:, :, None, None]
        # the current one is included
        latest = np.where(when >= since - 1e-12, when, np.inf).argmin(axis=0)
        return np.take_along_axis(self._seen, latest[None, ..., None], axis=0)[0]


def largest_age(max_degree: Array, merge_radius: float, *, law_4: bool = False) -> Array:
    """Maximum delay of bearings, s: r/(2D̄), under law (4) r/(2√3 D̄)."""
    return merge_radius / (2.0 * max_degree) / (math.sqrt(3.0) if law_4 else 1.0)


def _stale(teams: Batch, random: Random, *, law_4: bool) -> tuple[Stale, Array]:
    """Delayed bearings, and the duration for which inputs are held."""
    degrees = np.array([max_degree(matrix) for matrix in teams.weights])
    age = largest_age(degrees, teams.merge_radius, law_4=law_4)
    step = age / _KEPT
    return Stale(teams, random, age - step), step


def _bounds(teams: Batch) -> tuple[Array, Array]:
    """V0⁺ and a* of each team."""
    r, n = teams.merge_radius, teams.active.shape[1]
    rises = (n - 1) * r * teams.weights.sum(axis=(-2, -1)) / 2.0
    weakest = np.array([bottleneck_weight(matrix) for matrix in teams.weights])
    return teams.lyapunov() + rises, weakest


def draw_stale(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample law (1) with a separate, time-varying speed factor for each robot."""
    teams = draw_teams(random, batch, linked=True)
    seen, step = _stale(teams, random, law_4=False)
    most, weakest = _bounds(teams)
    slowest = float(random.choice([1.0, random.uniform(0.3, 1.0)]))

    def law(teams: Batch) -> Array:
        f = followed(seen(teams, teams.look()), teams.weights)
        return f * random.uniform(slowest, 1.0, (*teams.active.shape, 1))

    n = teams.active.shape[1]
    limit = n * most / (4.0 * weakest**2 * slowest)
    return ContinuousTrial(teams, law, step, limit, stays_below(teams, most))


def draw_stale_headings(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample law (4) with hᵀf̂ = ε‖f̂‖ always, on any side."""
    teams = draw_teams(random, batch, linked=True)
    seen, step = _stale(teams, random, law_4=True)
    most, weakest = _bounds(teams)
    margin = random.uniform(*np.maximum(_MARGINS, least_margin))
    limit = teams.active.shape[1] * most / (weakest * margin) ** 2
    return ContinuousTrial(
        teams, _sideways(teams, random, seen, margin), step, limit, stays_below(teams, most)
    )


def _sideways(teams: Batch, random: Random, seen: Stale, margin: float) -> Law:
    aside, steady = random.normal(size=teams.positions.shape), random.random() < 0.7

    def law(teams: Batch) -> Array:
        f = followed(seen(teams, teams.look()), teams.weights)
        ahead = unit(f)
        axis = aside if steady else random.normal(size=aside.shape)
        across = unit(axis - np.sum(axis * ahead, axis=-1, keepdims=True) * ahead)
        h = margin * ahead + math.sqrt(1.0 - margin**2) * across
        return np.asarray(h * np.sum(h * f, axis=-1, keepdims=True))

    return law


DELAY = (
    ContinuousTimeClaim(
        "stale",
        "law (1), bearings of any age ≤ r/(2D̄), speeds s_i from s to 1: V ≤ V0⁺, T ≤ nV0⁺/(4sa*²)",
        draw_stale,
    ),
    ContinuousTimeClaim(
        "stale-headings",
        "law (4), bearings of any age ≤ r/(2√3 D̄): V ≤ V0⁺, T ≤ nV0⁺/(ε²a*²)",
        draw_stale_headings,
    ),
)
