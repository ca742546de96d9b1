"""Claims of theorem R: connectivity maintenance with limited sensing range (guarantees 12)."""

from __future__ import annotations

import numpy as np
from continuous_time import Array, Batch, Bearings, ContinuousTrial, Law, Look
from continuous_time_claims import ContinuousTimeClaim
from continuous_time_laws import Random, away, turned
from desired_velocities import desired_velocities
from numpy.typing import ArrayLike
from time_bounds import gains_time, links_time

from rendezvous_env import Scenario
from rendezvous_env.safety.links import LinkKeeping, link_keeping_law, min_norm_points
from train.verify.claims import BATCH
from train.verify.monitors import unit

_SIZES = (2, 3, 4, 5)
_SIGHT = 1.0
"""Sensing range R, m."""
_FINE = 0.2
"""Step over r/(2D̄) that represents continuous time."""
_FLOAT32 = 1e-6
"""Fraction of R by which rounding of velocities may lengthen a link in a step.

Actual rounding is smaller."""


def draw_sighted(random: Random, batch: int) -> Batch:
    """Sample teams in which each robot is at most R − (n−1) r/2 away from another one."""
    n, dim = _SIZES[batch % len(_SIZES)], int(random.choice([2, 3]))
    radius = random.uniform(0.05, 0.15)
    reach = _SIGHT - (n - 1) * radius / 2.0
    places = np.zeros((BATCH, n, dim))
    for k in range(1, n):
        other = places[np.arange(BATCH), random.integers(k, size=BATCH)]
        stride = reach * random.uniform(0.6, 1.0, (BATCH, 1))
        places[:, k] = other + stride * unit(random.normal(size=(BATCH, dim)))
    return Batch(places, radius)


def rows_in_sight(sights: Bearings, bearings: Array, weight: float) -> Array:
    """Neighbour rows a g_ij of all others within R, (B, n, n − 1, d), m/s."""
    count, n = sights.distances.shape[:2]
    rows = weight * bearings * (sights.distances <= _SIGHT)[..., None]
    return np.asarray(rows[:, ~np.eye(n, dtype=np.bool_)].reshape(count, n, n - 1, -1))


def links_last(teams: Batch, tolerance: float = 0.0) -> Look:
    """Difference of R and the longest protected link, and the decrease of each link.

    Both are fractions of R; links are compared between merges.
    """
    radius, n = teams.merge_radius, teams.active.shape[1]
    latest = teams.look().distances
    kept = latest <= _SIGHT - (n - 1) * radius / 2.0

    def look(teams: Batch) -> Array:
        nonlocal latest
        before, latest = latest, teams.look().distances
        places = np.take_along_axis(teams.positions, teams.into[..., None], axis=1)
        apart = np.linalg.norm(places[:, None] - places[:, :, None], axis=-1)
        spare = np.min(_SIGHT - apart, axis=(-2, -1), where=kept, initial=np.inf)
        seen = (before <= _SIGHT) & np.isfinite(latest)
        shorter = np.subtract(before, latest, out=np.zeros_like(before), where=seen)
        shortest = shorter.min(axis=(-2, -1)) + tolerance * _SIGHT
        shortest[teams.merged.any(axis=-1)] = np.inf
        return np.asarray(np.minimum(spare, shortest) / _SIGHT)

    return look


def draw_link_keeping(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample the law of connectivity maintenance, R b."""
    teams, weight = draw_sighted(random, batch), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    step = _FINE * teams.merge_radius / (2.0 * (n - 1) * weight)

    def law(teams: Batch) -> Array:
        sights = teams.look()
        rows = rows_in_sight(sights, sights.bearings, weight)
        degree = np.linalg.norm(rows, axis=-1).sum(axis=-1)
        return link_keeping_law(
            min_norm_points(rows), degree, merge_radius=teams.merge_radius, duration=step
        )

    limit = gains_time(n, teams.dim, teams.size(), weight)
    return ContinuousTrial(teams, law, step, limit, links_last(teams))


def draw_kept_links(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample arbitrary desired velocities, R c."""
    return _any_velocities(random, batch, float(random.uniform(0.3, 1.0)), 0.0)


def draw_kept_misled(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample arbitrary desired velocities and bearing errors, R d."""
    return _any_velocities(random, batch, float(random.uniform(0.5, 1.0)), random.uniform(0.2, 0.8))


def sighted_lyapunov_bound(
    n: int,
    initial_lyapunov: ArrayLike,
    *,
    links: ArrayLike,
    weight: float,
    sight: float,
    merge_radius: float,
) -> Array:
    """Upper bound on V for links of weight a, m/s, with limited sensing range, (...), m²/s.

        V_tot = V0 + 2aR [n(n−1)/2 − |E0| + (n−1)²] + (n−1) r a n(n−1)/2

    ``links`` is the initial number of links |E0|; lengths are in m.
    """
    pairs = n * (n - 1) / 2.0
    appear = pairs - np.asarray(links) + (n - 1) ** 2
    merges = (n - 1) * merge_radius * weight * pairs
    return np.asarray(np.asarray(initial_lyapunov) + 2.0 * weight * sight * appear + merges)


def _any_velocities(
    random: Random, batch: int, share: float, error_share: float
) -> ContinuousTrial:
    """Velocities projected on those that keep links; the error is a fraction of π/(2n)."""
    teams, weight = draw_sighted(random, batch), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    error = error_share * np.pi / (2.0 * n)
    scenario = Scenario(
        n_robots=n, dim=teams.dim, merge_radius=teams.merge_radius, graph=weight * _all_pairs(n)
    )
    distances = teams.look().distances
    links = np.where(distances <= _SIGHT, distances, 0.0)
    most = sighted_lyapunov_bound(
        n,
        weight * links.sum(axis=(-2, -1)),
        links=np.count_nonzero(links, axis=(-2, -1)) / 2,
        weight=weight,
        sight=_SIGHT,
        merge_radius=teams.merge_radius,
    )
    limit = links_time(n, most, least_degree=weight, step=scenario.tau, share=share, error=error)
    law = _desiring(random, scenario, weight, share, error)
    return ContinuousTrial(teams, law, scenario.tau, limit, links_last(teams, _FLOAT32))


def _all_pairs(n: int) -> Array:
    return np.ones((n, n)) - np.eye(n)


def _desiring(random: Random, scenario: Scenario, weight: float, share: float, error: float) -> Law:
    keeping = LinkKeeping(
        scenario, BATCH, share=share, bearing_error=error, frame="local", num_threads=1
    )
    desired, calls = desired_velocities(scenario, BATCH, random), 0
    outwards = random.random((BATCH, 1, 1, 1)) < 0.5

    def law(teams: Batch) -> Array:
        nonlocal calls
        sights = teams.look()
        bearings = sights.bearings
        if error:
            anyhow = random.normal(size=bearings.shape)
            towards = np.where(outwards, away(teams, sights), anyhow)
            bearings = turned(bearings, towards, error * (1.0 - 1e-6))
        rows = rows_in_sight(sights, bearings, weight).astype(np.float32)
        keeping.hold(desired(keeping.observe(rows), calls))
        calls += 1
        return keeping.apply(rows).astype(np.float64)

    return law


LINKS = (
    ContinuousTimeClaim(
        "link-keeping",
        "law v = d q within sight R: no link longer, none lost, T ≤ G with c = d_min",
        draw_link_keeping,
    ),
    ContinuousTimeClaim(
        "links",
        "any velocities kept to the links: none longer, none lost, T ≤ n V_tot/(4λd²) + (n−1)τ",
        draw_kept_links,
    ),
    ContinuousTimeClaim(
        "links-misled",
        "the same with bearings off by η < π/(2n): T ≤ n V_tot/(4λd²(1 − 2nη/π)²) + (n−1)τ",
        draw_kept_misled,
    ),
)
