"""Where a robot must not go: outward from the hull of its team; and bearings turned that way."""

from __future__ import annotations

import math

import numpy as np

from .free_flow import Array, Mask, Sights, Teams

_MANY = 64
"""Directions in which the extent of a team is taken."""
_TINY = 1e-12


def unit(vectors: Array) -> Array:
    """Unit vectors (..., d); zero stays zero."""
    lengths = np.sqrt(np.sum(vectors**2, axis=-1, keepdims=True))
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > _TINY)


def directions(dim: int, count: int = _MANY) -> Array:
    """Unit vectors all round, (count, d); in space on a spiral."""
    k = np.arange(count) + 0.5
    if dim == 2:
        return np.stack([np.cos(2 * np.pi * k / count), np.sin(2 * np.pi * k / count)], axis=-1)
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)


def extents(positions: Array, active: Mask, along: Array) -> Array:
    """max_i u·p_i over the robots that are there, for each direction u of (M, d): (B, M), m."""
    reach = np.where(active[..., None], positions @ along.T, -np.inf)
    return np.asarray(reach.max(axis=1))


def outward(teams: Teams, sights: Sights) -> Array:
    """Unit vectors (B, n, d) along ∂L/∂p_i, exact in the plane and nearly so in space; away from
    the centroid for robots inside the hull.
    """
    there = teams.active[..., None]
    centroid = np.sum(teams.positions * there, axis=1, keepdims=True) / teams.left[:, None, None]
    inside = unit(teams.positions - centroid)
    if teams.dim == 2:
        middle, width = _widest_gap(sights)
        found = np.stack([np.cos(middle), np.sin(middle)], axis=-1)
        vertex = width > np.pi * (1.0 + 1e-9)
    else:
        along = directions(3)
        reach = np.where(there, teams.positions @ along.T, -np.inf)
        farthest = reach == reach.max(axis=1, keepdims=True)
        found = unit(farthest @ along)
        vertex = farthest.any(axis=-1)
    return np.where(vertex[..., None], found, inside)


def _widest_gap(sights: Sights) -> tuple[Array, Array]:
    """The middle and the width of the widest angle in which a robot sees nobody, (B, n) each, rad.

    Only of a corner of the hull it is wider than π; then its middle points along ∂L/∂p_i.
    """
    angles = np.arctan2(sights.bearings[..., 1], sights.bearings[..., 0])
    # who is not there stands where another one does
    alone = ~sights.present.any(axis=-1)
    someone = np.max(angles, axis=-1, keepdims=True, initial=-np.pi, where=sights.present)
    ordered = np.sort(np.where(sights.present, angles, someone), axis=-1)
    following = np.concatenate([ordered[..., 1:], ordered[..., :1] + 2 * np.pi], axis=-1)
    gaps = following - ordered
    widest = np.argmax(gaps, axis=-1)[..., None]
    width = np.take_along_axis(gaps, widest, axis=-1)[..., 0]
    start = np.take_along_axis(ordered, widest, axis=-1)[..., 0]
    return start + width / 2.0, np.where(alone, 0.0, width)


def turned(bearings: Array, towards: Array, error: Array | float) -> Array:
    """Bearings (B, n, n, d) turned by an error, rad, towards directions of the same shape.

    One that already points there, or away, is turned across.
    """
    aside = towards - np.sum(towards * bearings, axis=-1, keepdims=True) * bearings
    across = np.roll(bearings, 1, axis=-1) * np.array([-1.0, 1.0, 0.5])[: bearings.shape[-1]]
    across = across - np.sum(across * bearings, axis=-1, keepdims=True) * bearings
    aligned = np.sum(aside**2, axis=-1, keepdims=True) < 1e-18
    side = unit(np.where(aligned, across, aside))
    angle = np.asarray(error)
    if angle.ndim:
        angle = angle.reshape(*angle.shape, *[1] * (4 - angle.ndim))
    return np.asarray(np.cos(angle) * bearings + np.sin(angle) * side)
