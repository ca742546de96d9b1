"""Turn rates of nonholonomic robots: laws (8) and (17), the gate around a policy, and arcs.

docs/theory.md sections 3 (the gate) and 4 (arcs). All vectors are in the body frame at the start of
the step: x = heading h, y = horizontal left, z = up-ish.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import floats, positive, shown
from ..compilation import kernel
from ..physics.vectors import dot, load
from ..robots.nonholonomic_3d import arc_3d
from ..robots.unicycle import clip, mean_cos_sin
from .settings import check_gate_constants, check_vectors

SMALLEST_COSINE = 1e-9
"""Law (17) takes |cos β| for no less than this: its rate is then far over any limit."""


def yaw_rate_law(left: Any, pitch: Any) -> Any:
    """Yaw rate of law (17): α̇ = f_y / cos β, huge but finite at β = ±π/2.

    Args:
        left: f_y, the net bearing's part along the body's left, any shape, m/s.
        pitch: β, of the same shape, rad.

    Returns:
        α̇, of the same shape, rad/s: the law's gain is 1 rad/m.
    """
    cos_pitch = np.cos(pitch)
    return left / np.copysign(np.maximum(np.abs(cos_pitch), SMALLEST_COSINE), cos_pitch)


def mean_body_axis_2d(rate: ArrayLike, duration: float) -> NDArray[np.float64]:
    """Mean of a unicycle's body axis over a step with held turn rate.

        m = (sin ωτ/(ωτ), (1 − cos ωτ)/(ωτ))                        (theory 4, arcs)

    Args:
        rate: ω, any shape, rad/s.
        duration: τ, s.

    Returns:
        m, (..., 2), ‖m‖ ≤ 1, in the body frame at the start of the step.
    """
    rates = np.asarray(rate, dtype=np.float64)
    out = np.empty((*rates.shape, 2))
    mean_axes_2d(rates.reshape(-1), float(duration), out.reshape(-1, 2))
    return out


def mean_body_axis_3d(
    yaw_rate: ArrayLike, pitch_rate: ArrayLike, pitch: ArrayLike, duration: float
) -> NDArray[np.float64]:
    """Mean of a 3-D nonholonomic robot's body axis over a step with held yaw and pitch rates.

        m = (1/τ) ∫ h dt,   h = (cos β cos α, cos β sin α, sin β),  α̇ = ω_α,  β̇ = ω_β

    The integral is exact: it is the displacement of eq. (9) at unit speed.

    Args:
        yaw_rate: ω_α about the vertical, any shape, rad/s.
        pitch_rate: ω_β, rad/s, broadcast with it.
        pitch: β at the start of the step, rad, broadcast with it.
        duration: τ, s, positive.

    Returns:
        m, (..., 3), ‖m‖ ≤ 1, in the body frame at the start of the step.
    """
    arrays = np.broadcast_arrays(
        *(np.asarray(a, np.float64) for a in (yaw_rate, pitch_rate, pitch))
    )
    out = np.empty((*arrays[0].shape, 3))
    mean_axes_3d(*(a.flatten() for a in arrays), float(duration), out.reshape(-1, 3))
    return out


def gated_turn_rate(
    requested: ArrayLike,
    net_bearing: ArrayLike,
    pitch: ArrayLike | None = None,
    *,
    min_alignment: float,
    dead_zone: float,
    duration: float,
    max_rate: ArrayLike,
) -> NDArray[np.float64]:
    """Turn rates with which a nonholonomic robot cannot stay orthogonal to its net bearing.

    While ‖f‖ > δ and |hᵀf| < ε‖f‖, or the requested (clipped) rate would give |mᵀf| < ε‖f‖/2 over
    the step, the requested rate is replaced by one that turns towards f and, held over the step,
    never past it; otherwise it is free (theory 3, the gate):

    * in the plane by law (8), ω = f_y, clipped and at most |∠(h, f)|/τ;
    * in space by the yaw and the pitch, each as fast as its limit lets it, that bring h onto the
      line of f, see ``rates_onto_line``. Law (17) itself flips from step to step near β = ±π/2,
      where its yaw rate is saturated, and a robot may then stay across f for ever.

    Args:
        requested: ω, (..., 1), or (ω_α, ω_β), (..., 2), rad/s.
        net_bearing: f, (..., 2) or (..., 3), m/s, in the body frame.
        pitch: β, (...), rad; in space only.
        min_alignment: ε, in (0, 1).
        dead_zone: δ = a*/(2n), m/s.
        duration: τ, s.
        max_rate: limit of each rate, a number or (d - 1,), rad/s.

    Returns:
        Turn rates, of the shape of ``requested``, rad/s.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, dead_zone)
    f = check_vectors("net_bearing", net_bearing)
    leading, d = f.shape[:-1], f.shape[-1]
    rates = _checked("requested", requested, (*leading, d - 1))
    if (pitch is None) != (d == 2):
        raise ValueError(
            f"pitch must be {'left out' if d == 2 else 'given'} where net_bearing is {d}-D"
        )
    limits = floats("max_rate", max_rate)
    if limits.shape not in ((), (1,), (d - 1,)) or not (limits > 0).all():
        raise ValueError(
            f"max_rate is {shown(max_rate)}; it must be positive, one number or {d - 1} (rad/s)"
        )
    limits = np.array(np.broadcast_to(limits, (d - 1,)))
    duration = positive("duration", duration, "s")
    out = np.empty_like(rates)
    constants = (float(min_alignment), float(dead_zone), float(duration))
    flat = (rates.reshape(-1, d - 1), f.reshape(-1, d))
    if pitch is None:
        gate_2d(*flat, *constants, limits, out.reshape(-1, 1))
    else:
        angles = _checked("pitch", pitch, leading).reshape(-1)
        gate_3d(*flat, angles, *constants, limits, out.reshape(-1, 2))
    return out


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = floats(name, value)
    if array.shape != shape:
        raise ValueError(
            f"{name} has shape {array.shape}; with this net_bearing it must be {shape}"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return np.ascontiguousarray(array).reshape(shape)


@kernel
def gate_2d(requested, net_bearing, min_alignment, dead_zone, duration, limits, out):
    """``gated_turn_rate`` for N unicycles, unchecked: ω, or f_y of law (8) (theory 3, the gate).

    Args:
        requested: ω, (N, 1), rad/s.
        net_bearing: f, (N, 2), m/s.
        min_alignment: ε.
        dead_zone: δ, m/s.
        duration: τ, s.
        limits: (1,), rad/s.
        out: (N, 1), for turn rates, rad/s.
    """
    for i in range(out.shape[0]):
        f, wanted = load(net_bearing[i]), requested[i, 0]
        out[i, 0] = gated_rate_2d(wanted, f, min_alignment, dead_zone, duration, limits[0])


@kernel
def gate_3d(requested, net_bearing, pitch, min_alignment, dead_zone, duration, limits, out):
    """``gated_turn_rate`` for N robots in space, unchecked: (ω_α, ω_β), or onto f (theory 3).

    Rates are (N, 2), net bearings (N, 3), ``pitch`` (N,), rad, and ``limits`` (2,); units and the
    other arguments as ``gate_2d``.
    """
    for i in range(out.shape[0]):
        f, wanted = load(net_bearing[i]), (requested[i, 0], requested[i, 1])
        out[i, 0], out[i, 1] = gated_rates_3d(
            wanted,
            f,
            pitch[i],
            min_alignment,
            dead_zone,
            duration,
            (limits[0], limits[1]),
        )


@kernel
def gated_rate_2d(requested, net_bearing, min_alignment, dead_zone, duration, limit):
    """``gated_turn_rate`` of one unicycle, a number, rad/s: ω, or f_y of law (8), both limited.

    ``requested`` and ``limit`` are numbers, ``net_bearing`` is a triple; their units and the other
    arguments as ``gate_2d``.
    """
    rate = clip(requested, limit)
    if keeps_margin(net_bearing, mean_axis_2d(rate, duration), min_alignment, dead_zone):
        return rate
    left = abs(math.atan2(net_bearing[1], net_bearing[0]))
    return clip(net_bearing[1], min(limit, left / duration))


@kernel
def gated_rates_3d(requested, net_bearing, pitch, min_alignment, dead_zone, duration, limits):
    """``gated_turn_rate`` of one robot in space, a pair, rad/s: as asked, or ``rates_onto_line``.

    ``requested`` and ``limits`` are pairs of yaw and pitch, ``net_bearing`` is a triple, ``pitch``
    is a number, rad; units and the other arguments as ``gate_2d``.
    """
    yaw_rate, pitch_rate = clip(requested[0], limits[0]), clip(requested[1], limits[1])
    mean_axis = mean_axis_3d(yaw_rate, pitch_rate, pitch, duration)
    if keeps_margin(net_bearing, mean_axis, min_alignment, dead_zone):
        return yaw_rate, pitch_rate
    return rates_onto_line(net_bearing, pitch, duration, limits)


@kernel
def rates_onto_line(net_bearing, pitch, duration, limits):
    """Yaw and pitch rates that bring the body axis h onto the line of f, in this step if they may.

        ω_α = ψ/τ,   ω_β = (β* − β)/τ,   each within its limit                    (docs/proofs.md)

    ψ ∈ [−π/2, π/2] is the yaw after which the meridian of h holds f, and β* the pitch of f or −f on
    it, whichever is nearer: h and −h are the same line. Yaw and pitch are a robot's own coordinates
    and have no pole, so both errors fall in every step by as much as the limits allow.

    Args:
        net_bearing: f, a triple in the body frame, m/s.
        pitch: β, rad.
        duration: τ, s.
        limits: of yaw and pitch, a pair, rad/s.

    Returns:
        A pair, rad/s.
    """
    c, s = math.cos(pitch), math.sin(pitch)
    ahead, left = c * net_bearing[0] - s * net_bearing[2], net_bearing[1]
    up = s * net_bearing[0] + c * net_bearing[2]
    side = -1.0 if ahead < 0.0 else 1.0
    yaw = math.atan2(side * left, side * ahead)
    rise = math.atan2(side * up, math.hypot(ahead, left)) - pitch
    rise -= math.pi * round(rise / math.pi)
    return clip(yaw / duration, limits[0]), clip(rise / duration, limits[1])


@kernel
def keeps_margin(net_bearing, mean_axis, min_alignment, dead_zone):
    """Whether |hᵀf| ≥ ε‖f‖ now and |mᵀf| ≥ ε‖f‖/2 over the step, or ‖f‖ ≤ δ; h is the x axis.

    Args:
        net_bearing: f, a triple, m/s.
        mean_axis: m, a triple without unit.
        min_alignment: ε.
        dead_zone: δ, m/s.
    """
    f, m = net_bearing, mean_axis
    strength = math.sqrt(dot(f, f))
    if strength <= dead_zone:
        return True
    needed = min_alignment * strength
    return abs(f[0]) >= needed and abs(dot(m, f)) >= 0.5 * needed


@kernel
def mean_axis_2d(rate, duration):
    """``mean_body_axis_2d`` of one robot, (sin ωτ, 1 − cos ωτ, 0)/(ωτ), a triple without unit.

    Args:
        rate: ω, rad/s.
        duration: τ, s.
    """
    mean_cos, mean_sin = mean_cos_sin(0.0, rate * duration)
    return mean_cos, mean_sin, 0.0


@kernel
def mean_axis_3d(yaw_rate, pitch_rate, pitch, duration):
    """``mean_body_axis_3d`` of one robot, m = (1/τ) ∫ h dt, a triple without unit.

    Args:
        yaw_rate: ω_α, rad/s.
        pitch_rate: ω_β, rad/s.
        pitch: β at the start of the step, rad.
        duration: τ, s.
    """
    forward, left, up = arc_3d(1.0 / duration, 0.0, pitch, yaw_rate, pitch_rate, duration)
    c, s = math.cos(pitch), math.sin(pitch)
    return c * forward + s * up, left, c * up - s * forward


@kernel
def mean_axes_2d(rates, duration, out):
    """``mean_axis_2d`` for N turn rates (N,), rad/s; ``out`` (N, 2) is filled in."""
    for i in range(out.shape[0]):
        out[i, 0], out[i, 1], _ = mean_axis_2d(rates[i], duration)


@kernel
def mean_axes_3d(yaw_rates, pitch_rates, pitches, duration, out):
    """``mean_axis_3d`` for N robots, (N,) each, rad/s and rad; ``out`` (N, 3) is filled in."""
    for i in range(out.shape[0]):
        mean = mean_axis_3d(yaw_rates[i], pitch_rates[i], pitches[i], duration)
        out[i, 0], out[i, 1], out[i, 2] = mean
