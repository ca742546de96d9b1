"""Laws for the continuous-time integrator: gains, bearing errors, headings in a cone."""

from __future__ import annotations

import numpy as np
from adversarial_graphs import Attention
from continuous_time import Array, Batch, Bearings, Law, outward

from train.verify.adversaries import turned_rows
from train.verify.monitors import unit

Random = np.random.Generator


def turned(bearings: Array, towards: Array, error: Array | float) -> Array:
    """Bearings (B, n, k, d) rotated by an error, rad, towards directions of the same shape.

    The error is common to all, per team (B,), or per bearing (B, n, k, 1).
    """
    aims = np.broadcast_to(towards, bearings.shape)
    angles = np.reshape(error, (*np.shape(error), *[1] * (4 - np.ndim(error))))
    return turned_rows(bearings, aims, angles)


def followed(bearings: Array, gains: Array) -> Array:
    """Σ_j c_ij g_ij, (B, n, d), m/s."""
    return np.asarray(np.einsum("bij,bijd->bid", gains, bearings))


def with_gains(
    teams: Batch, random: Random, gains: tuple[float, float], *, led: bool = False
) -> Law:
    """Law ṗ_i = Σ_j c_ij g_ij with Σ_j c_ij between two limits at any time (theorem G).

    Robot 0 rests if teams have a stationary root. Half of the teams have the minimum sum.
    """
    attention = Attention(teams, random)
    steady = random.random((len(teams.time), 1)) < 0.5

    def law(teams: Batch) -> Array:
        sights = teams.look()
        totals = np.where(steady, gains[0], random.uniform(*gains, teams.active.shape))
        if led:
            totals[:, 0] = 0.0
        return followed(sights.bearings, totals[..., None] * attention(teams, sights))

    return law


def now_and_then(
    teams: Batch, random: Random, gains: tuple[float, float], window: float, duration: float
) -> Law:
    """As ``with_gains``, with visible neighbours only once per time window and robot."""
    everywhen = with_gains(teams, random, gains)
    turn = random.uniform(0.0, window - duration, teams.active.shape)

    def law(teams: Batch) -> Array:
        since = teams.time[:, None] % window - turn
        return everywhen(teams) * ((since >= 0) & (since <= duration))[..., None]

    return law


def misled(teams: Batch, random: Random, gain: float, error: float) -> Law:
    """Law with Σ_j c_ij = c and bearing errors η, outward or in any direction (theorem N)."""
    attention = Attention(teams, random)
    outwards = random.random((len(teams.time), 1, 1, 1)) < 0.7

    def law(teams: Batch) -> Array:
        sights = teams.look()
        anyhow = random.normal(size=sights.bearings.shape)
        seen = turned(sights.bearings, np.where(outwards, away(teams, sights), anyhow), error)
        return followed(seen, gain * attention(teams, sights))

    return law


def away(teams: Batch, sights: Bearings) -> Array:
    """Outward directions for each bearing, (B, n, n, d)."""
    return np.broadcast_to(outward(teams, sights)[:, :, None], sights.bearings.shape)


def in_polygons(random: Random, gain: float, error: float) -> Law:
    """Law of regular polygons with the next, the previous or both as neighbours.

    All robots have the same neighbours and outward bearing errors.
    """

    def law(teams: Batch) -> Array:
        sights = teams.look()
        n, forward = teams.active.shape[1], random.random((len(teams.time), 1))
        here = np.arange(n)
        shares = np.zeros_like(sights.distances)
        shares[:, here, (here + 1) % n] = forward
        shares[:, here, here - 1] += 1.0 - forward
        seen = turned(sights.bearings, away(teams, sights), error)
        return followed(seen, gain * shares)

    return law


STRAIGHT_BACK = -0.98
"""Cosine beyond which a bearing counts as opposite to f."""


def into_cone(bearing: Array, net_bearing: Array, margin: Array) -> Array:
    """Headings h of cone{g, f} with h·f ≥ ε‖f‖, closest to a bearing (C4).

    Args:
        bearing: g of one neighbour, (..., d); ignored if it points away from f.
        net_bearing: f, (..., d), m/s.
        margin: ε, (..., 1).

    Returns:
        (..., d), unit vectors.
    """
    ahead = unit(net_bearing)
    cosine = np.sum(bearing * ahead, axis=-1, keepdims=True)
    edge = margin * ahead + np.sqrt(1.0 - margin**2) * unit(bearing - cosine * ahead)
    inside = np.where(cosine >= margin, bearing, edge)
    return np.where(cosine < STRAIGHT_BACK, ahead, inside)


def in_cones(teams: Batch, random: Random, margin: Array, most: float) -> Law:
    """Law (4) with headings of cone{g_ij}, and d_i between 1 m/s and a limit (C4)."""
    attention, taste = Attention(teams, random), Attention(teams, random)

    def law(teams: Batch) -> Array:
        sights = teams.look()
        shares = attention(teams, sights)
        totals = random.uniform(1.0, most, (*teams.active.shape, 1))
        f = followed(sights.bearings, totals * shares)
        liked = np.where(shares > 0, taste(teams, sights), -1.0)
        picked = np.argmax(liked, axis=-1)[..., None, None]
        bearing = np.take_along_axis(sights.bearings, picked, axis=2)[:, :, 0]
        h = into_cone(bearing, f, margin[:, None, None])
        return np.asarray(h * np.sum(h * f, axis=-1, keepdims=True))

    return law
