"""The certified heading and law (4): any raw direction becomes a heading that keeps the margin.

Theorem C of docs/theory.md, section 3. The turn rates of nonholonomic robots are in ``turning.py``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compilation import kernel
from ..equations.vectors import X_AXIS, combine, dot, load, split, without
from ..experiment.checks import floats, real, shown

NO_CAP = -2.0
"""A margin that every heading keeps."""
_NEARLY_PARALLEL = 1e-9
_NEARLY_ANTIPODAL = 1e-6


def flexible_velocity(
    net_bearing: NDArray[np.float64], headings: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Velocity of the flexible bearing-only law: the net bearing projected onto the heading.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                              (Zhao & Zheng, eq. 4)

    Args:
        net_bearing: fᵢ = Σⱼ aᵢⱼ gᵢⱼ, (..., d), m/s, in the robot's own frame.
        headings: hᵢ, (..., d), unit vectors in the same frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    f, h = net_bearing, headings
    return h * np.sum(h * f, axis=-1, keepdims=True)


def step_scale(row_lengths_sum: Any, merge_radius: float, duration: float) -> Any:
    """Factor on a robot's velocity with which V cannot rise within a long step.

        min(1, r/(2 Dᵢ τ))                                          (theory 4)

    Args:
        row_lengths_sum: Dᵢ = Σⱼ aᵢⱼ, the summed lengths of the neighbour rows, a number or an array
            of any shape, m/s.
        merge_radius: r, m.
        duration: τ, s.

    Returns:
        Factors in (0, 1], of the same shape; 1 where Dᵢ = 0.
    """
    return merge_radius / np.maximum(2.0 * duration * row_lengths_sum, merge_radius)


scale_of_step = kernel(step_scale)
"""``step_scale`` of a number, for kernels."""


@kernel
def turn_limit(max_turn):
    """A largest turn γ as ``certify_one`` wants it: cos γ, sin γ, squared chord 4 sin²(γ/2).

    Args:
        max_turn: γ, rad; π or more is no limit.

    Returns:
        Three numbers without unit; the chord is inf where there is no limit.
    """
    turn = min(max_turn, math.pi)
    chord = 2.0 * math.sin(0.5 * turn)
    square = chord * chord if max_turn < math.pi else math.inf
    return math.cos(turn), math.sin(turn), square


def certified_heading(
    raw: ArrayLike,
    net_bearing: ArrayLike,
    previous: ArrayLike,
    *,
    min_alignment: float,
    dead_zone: float,
    max_turn: float,
) -> NDArray[np.float64]:
    """The heading nearest in spirit to a raw vector with which law (4) is certain to meet.

        Cᵢ = {h : ‖h‖ = 1, hᵀfᵢ ≥ εᵢ ‖fᵢ‖},   εᵢ = ε clip(‖fᵢ‖/δ − 1, 0, 1)    (theorem C)

    1. Carry: the previous heading, flipped if hᵀfᵢ < 0, is projected onto the cap Cᵢ.
    2. Aim: the raw vector is projected onto the cap without flipping. A zero raw vector, or one
       along −fᵢ where that is outside the cap, aims at the carried heading.
    3. Turn from carried towards aim along the great circle, through fᵢ if they are antipodal, by at
       most ``max_turn``.

    Where fᵢ = 0 every heading is allowed, nothing is flipped, and antipodal headings turn
    counter-clockwise in the local xy plane.

    Args:
        raw: any vectors, (..., d), d = 2 or 3, of any unit; only the direction counts.
        net_bearing: fᵢ, (..., d), m/s, in the same frame.
        previous: the headings of the step before, (..., d), in the same frame; zero = none yet:
            fᵢ/‖fᵢ‖ is carried then, or the local x axis where fᵢ = 0.
        min_alignment: ε, in (0, 1).
        dead_zone: δ = a*/(2n), m/s.
        max_turn: ω_max τ, rad; π or more (inf too) is no limit.

    Returns:
        Headings hᵢ, (..., d), unit vectors.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, dead_zone)
    if not real(max_turn) > 0:
        raise ValueError(f"max_turn is {shown(max_turn)}; it must be positive (rad)")
    f = check_vectors("net_bearing", net_bearing)
    q = check_vectors("raw", raw, like=f)
    h = check_vectors("previous", previous, like=f)
    out = np.empty_like(f)
    d = f.shape[-1]
    flat = (q.reshape(-1, d), f.reshape(-1, d), h.reshape(-1, d))
    turn = real(max_turn) if real(max_turn) < math.pi else math.inf
    certify(*flat, float(min_alignment), float(dead_zone), turn, out.reshape(-1, d))
    return out


def check_gate_constants(min_alignment: float, dead_zone: float) -> None:
    """Refuse constants of theorem C's margin unless 0 < ε < 1 and 0 < δ < ∞.

    Args:
        min_alignment: ε, a number without unit.
        dead_zone: δ = a*/(2n), a number, m/s.

    Raises:
        ValueError: naming the constant and its value.
    """
    if not 0 < real(min_alignment) < 1:
        raise ValueError(
            f"min_alignment is {shown(min_alignment)}; it must lie between 0 and 1, exclusive"
        )
    if not 0 < real(dead_zone) < math.inf:
        raise ValueError(f"dead_zone is {shown(dead_zone)}; it must be positive and finite (m/s)")


def check_vectors(
    name: str, value: ArrayLike, like: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Finite vectors of the plane or of space as contiguous float64, d = 2 or 3.

    Args:
        name: what the message calls them.
        value: the vectors, (..., d), of any unit.
        like: vectors whose shape they must have, if any.

    Returns:
        The vectors, (..., d), in the same unit.

    Raises:
        ValueError: naming the argument, and its shape or that it is not finite.
    """
    vectors = floats(name, value)
    if like is not None and vectors.shape != like.shape:
        raise ValueError(f"{name} has shape {vectors.shape}; net_bearing has {like.shape}")
    if vectors.shape[-1:] not in ((2,), (3,)):
        raise ValueError(f"{name} has shape {vectors.shape}; it must be (..., 2) or (..., 3)")
    if not np.isfinite(vectors).all():
        raise ValueError(f"{name} must be finite")
    return np.ascontiguousarray(vectors)


# One implementation for the plane and for space: a vector of the plane has z = 0 and keeps it.


@kernel
def certify(raw, net_bearing, previous, min_alignment, dead_zone, max_turn, out):
    """``certified_heading`` for N robots, unchecked: hᵀf ≥ ε_i ‖f‖ (theorem C).

    Args:
        raw: (N, d), of any unit, float64 like all of these arrays.
        net_bearing: f, (N, d), m/s.
        previous: (N, d), unit vectors or zero.
        min_alignment: ε.
        dead_zone: δ, m/s.
        max_turn: rad; inf is no limit.
        out: (N, d), for unit vectors; may be ``previous`` itself.
    """
    limit = turn_limit(max_turn)
    for i in range(out.shape[0]):
        q, f, h = load(raw[i]), load(net_bearing[i]), load(previous[i])
        x, y, z = certify_one(q, f, h, min_alignment, dead_zone, limit)
        out[i, 0], out[i, 1] = x, y
        if out.shape[1] == 3:
            out[i, 2] = z


@kernel
def certify_one(raw, net_bearing, previous, min_alignment, dead_zone, limit):
    """``certified_heading`` of one robot: hᵀf ≥ ε_i ‖f‖ (theorem C).

    Args:
        raw: a triple, of any unit.
        net_bearing: f, a triple, m/s.
        previous: a unit triple or zero.
        min_alignment: ε.
        dead_zone: δ, m/s.
        limit: from ``turn_limit``.

    Returns:
        h, a unit triple.
    """
    strength, towards = split(net_bearing)
    margin = min_alignment * min(max(strength / dead_zone - 1.0, 0.0), 1.0)
    if strength == 0.0:
        towards, margin = X_AXIS, NO_CAP
    carried = _carry(previous, towards, margin)
    length, direction = split(raw)
    aim = into_cap(direction, towards, margin, carried) if length > 0.0 else carried
    return into_cap(_turn(carried, aim, towards, limit), towards, margin, towards)


@kernel
def _carry(previous, towards, margin):
    """The previous heading as a line: its end that looks along f, projected onto the cap."""
    length, heading = split(previous)
    if length == 0.0:
        return towards
    if margin != NO_CAP and dot(heading, towards) < 0.0:
        heading = combine(-1.0, heading, 0.0, heading)
    return into_cap(heading, towards, margin, towards)


@kernel
def into_cap(direction, towards, margin, otherwise):
    """Nearest unit vector h with h·u ≥ margin: ε u + √(1 − ε²) w, w the part across u.

    Args:
        direction: a unit triple.
        towards: u, the centre of the cap, a unit triple.
        margin: ε, the cosine of the cap's half angle.
        otherwise: what to return where the direction is −u, all of the edge being equally near.

    Returns:
        h, a unit triple.
    """
    if dot(direction, towards) >= margin:
        return direction
    size, across = split(without(direction, towards))
    if size < _NEARLY_PARALLEL:
        return otherwise
    return combine(margin, towards, math.sqrt(1.0 - margin * margin), across)


@kernel
def _turn(carried, aim, towards, limit):
    """From carried towards aim along the great circle by at most the angle γ.

        h cos γ + t sin γ,   t the unit tangent at the carried heading h

    Args:
        carried: h, a unit vector.
        aim: a unit vector.
        towards: u, a unit vector; an antipodal aim is reached through it.
        limit: cos γ, sin γ and the square of the chord of γ.
    """
    cos_limit, sin_limit, square_chord = limit
    gap = combine(1.0, aim, -1.0, carried)
    if dot(gap, gap) <= square_chord:
        return aim
    size, tangent = split(without(aim, carried))
    if size < _NEARLY_ANTIPODAL and dot(aim, carried) < 0.0:
        size, tangent = split(without(towards, carried))
        if size < _NEARLY_ANTIPODAL:
            tangent = _any_perpendicular(carried)
    return combine(cos_limit, carried, sin_limit, tangent)


@kernel
def _any_perpendicular(h):
    """A unit vector across h: counter-clockwise in the xy plane; along x if h is vertical."""
    size, perpendicular = split((-h[1], h[0], 0.0))
    return perpendicular if size > _NEARLY_ANTIPODAL else split(without(X_AXIS, h))[1]
