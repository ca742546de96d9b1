"""Turn rates of nonholonomic robots: law (17), the gate around a policy, and mean axes of arcs.

See docs/theory.md, sections 3 (the gate) and 4 (arcs). Vectors are triples in the body frame at the
start of the step: x = heading h, y = horizontal left, z = upward. Turn rates are pairs (ω_α, ω_β),
rad/s; the second is 0 in the plane, as is the pitch β, a number, rad.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ..compilation import inner_kernel, kernel
from ..physics.vectors import dot, load
from ..robots.nonholonomic_3d import arc_3d
from ..robots.unicycle import clip, mean_cos_sin
from ..scenario.scenario import Scenario
from .settings import check_bearing_error, error_chord

SMALLEST_COSINE = 1e-9
"""Lower bound on |cos β| in law (17), where the rate is far above any limit."""
TINY = 1e-300  # rad/s; a limit of 0 counts as this


def yaw_rate_law(left: Any, pitch: Any) -> Any:
    """Yaw rate of law (17), any shape, rad/s: α̇ = f_y / cos β, large but finite at β = ±π/2.

    f_y, m/s, is the component of the net bearing along the body's left.
    """
    cos_pitch = np.cos(pitch)
    return left / np.copysign(np.maximum(np.abs(cos_pitch), SMALLEST_COSINE), cos_pitch)


class Gate(NamedTuple):
    """Constants of the gate."""

    planar: bool
    min_alignment: float  # ε
    dead_zone: float  # δ, m/s
    duration: float  # τ, s
    yaw_limit: float  # rad/s
    pitch_limit: float  # rad/s; 0 in the plane


class Robot(NamedTuple):
    """Constants of a scenario's robots for kernels."""

    neighbour_slots: int
    obstacle_slots: int
    gravity_row: int  # the first after neighbours and obstacles
    turns: bool  # whether they are nonholonomic
    merge_radius: float
    speed_limit: float  # m/s
    error_chord: float  # 2 sin(η/2), without unit: relative error of f, in units of D
    gate: Gate


def robot_of(
    scenario: Scenario,
    min_alignment: float = 0.0,
    bearing_error: Any = 0.0,
    most: float = math.inf,
) -> Robot:
    """Constants of a scenario's robots: margin ε, bearing errors η, numbers, rad (theorem N1').

    Turn limits are |ω| ≤ ``most``, rad/s; errors are validated. Limits are the lowest of the team,
    so that every robot executes each command of a filter; turn limits those of nonholonomic robots.
    """
    layout, turning = scenario.observation_layout, scenario.nonholonomic_robots
    bounds = scenario.robot_bounds[turning] if turning.any() else scenario.robot_bounds
    limits = [min(most, float(limit)) for limit in bounds.min(axis=0)[1:]]
    yaw, pitch, *_ = [*limits, 0.0, 0.0]
    dead_zone = float(scenario.dead_zone) if scenario.dead_zone > 0 else 1.0
    gate = Gate(scenario.dim == 2, min_alignment, dead_zone, float(scenario.tau), yaw, pitch)
    return Robot(
        neighbour_slots=layout.neighbour_slots,
        obstacle_slots=layout.obstacle_slots,
        gravity_row=layout.gravity.start,
        turns=bool(turning.any()),
        merge_radius=float(scenario.merge_radius),
        speed_limit=float(scenario.min_speed_limit),
        error_chord=error_chord(check_bearing_error(bearing_error)),
        gate=gate,
    )


@inner_kernel
def gated_rates(requested, net_bearing, pitch, gate):
    """Turn rates with which a nonholonomic robot cannot stay orthogonal to f, a triple, m/s.

    Rates are unchanged while they keep the margin, |hᵀf| ≥ ε‖f‖ now and |mᵀf| ≥ ε‖f‖/2 over the
    step, or ‖f‖ ≤ δ. Otherwise they are replaced by rates that turn towards f without overshoot
    (theory 3, the gate): in the plane by law (8), ω = f_y, limited to |∠(h, f)|/τ; in 3-D by
    ``rates_onto_line``. Law (17) itself alternates near β = ±π/2, where its yaw rate saturates, and
    a robot could stay orthogonal to f forever.
    """
    rates = clip(requested[0], gate.yaw_limit), clip(requested[1], gate.pitch_limit)
    m, strength = mean_axis(rates, pitch, gate), math.sqrt(dot(net_bearing, net_bearing))
    needed = gate.min_alignment * strength
    kept = abs(net_bearing[0]) >= needed and abs(dot(m, net_bearing)) >= 0.5 * needed
    if kept or strength <= gate.dead_zone:
        return rates
    if not gate.planar:
        return rates_onto_line(net_bearing, pitch, gate)
    left = abs(math.atan2(net_bearing[1], net_bearing[0]))
    return clip(net_bearing[1], min(gate.yaw_limit, left / gate.duration)), 0.0


@inner_kernel
def rates_onto_line(net_bearing, pitch, gate):
    """Yaw and pitch rates, a pair, rad/s, that align the body axis h with the line of f, m/s.

        ω_α = ψ/τ,   ω_β = (β* − β)/τ                                        (docs/proofs.md, T)

    After a yaw ψ ∈ [−π/2, π/2] the meridian of h contains f; β* is the nearer pitch of f or −f.
    """
    ahead, left, up = _levelled(net_bearing, pitch)
    side = -1.0 if ahead < 0.0 else 1.0
    yaw = math.atan2(side * left, side * ahead)
    rise = math.atan2(side * up, math.hypot(ahead, left)) - pitch
    rise -= math.pi * round(rise / math.pi)
    return clip(yaw / gate.duration, gate.yaw_limit), clip(rise / gate.duration, gate.pitch_limit)


@inner_kernel
def _levelled(vector, pitch):
    """Triple of the body frame in the level frame of the same yaw."""
    c, s = math.cos(pitch), math.sin(pitch)
    return c * vector[0] - s * vector[2], vector[1], s * vector[0] + c * vector[2]


@inner_kernel
def rates_towards(wanted, pitch, gate):
    """Turn rates towards a nonzero direction without overshoot, a pair, rad/s.

    ω = ψ/τ, in 3-D (ψ, β* − β)/τ scaled together to their limits; of both ways, upright or
    inverted, the faster one.
    """
    if gate.planar:
        yaw = math.atan2(wanted[1], wanted[0])
        return clip(yaw / gate.duration, gate.yaw_limit), 0.0
    ahead, left, up = _levelled(wanted, pitch)
    yaw, target = math.atan2(left, ahead), math.atan2(up, math.hypot(ahead, left))
    upright = _in_one_go(yaw, target - pitch, gate)
    over = _in_one_go(yaw - math.copysign(math.pi, yaw), math.pi - target - pitch, gate)
    yaw_rate, pitch_rate, steps = upright if upright[2] <= over[2] else over
    return yaw_rate / max(steps, 1.0), pitch_rate / max(steps, 1.0)


@inner_kernel
def _in_one_go(yaw, rise, gate):
    """Turn rates for two turns within one step, rad/s, and the number of steps they take."""
    rise -= 2.0 * math.pi * round(rise / (2.0 * math.pi))
    yaw_rate, pitch_rate = yaw / gate.duration, rise / gate.duration
    yaw_limit, pitch_limit = max(gate.yaw_limit, TINY), max(gate.pitch_limit, TINY)
    return yaw_rate, pitch_rate, max(abs(yaw_rate) / yaw_limit, abs(pitch_rate) / pitch_limit)


@inner_kernel
def mean_axis(rates, pitch, gate):
    """Mean body axis over a step with held turn rates, m = (1/τ) ∫ h dt, a triple without unit.

    The exact displacement of eqs. (5) and (9) at unit speed (theory 4, arcs).
    """
    if gate.planar:
        mean_cos, mean_sin = mean_cos_sin(0.0, rates[0] * gate.duration)
        return mean_cos, mean_sin, 0.0
    duration = gate.duration
    return _levelled(arc_3d(1.0 / duration, 0.0, pitch, rates[0], rates[1], duration), -pitch)


@kernel
def pitch_of(rows, gravity_row, gate):
    """β, a number, rad, of the row (−sin β, 0, −cos β); 0 in the plane (theory 3)."""
    if gate.planar:
        return 0.0
    gravity = load(rows[gravity_row])
    return math.atan2(-gravity[0], -gravity[2])


@inner_kernel
def rates_of(action, gate):
    """Executed turn rates |ω| ≤ limit of a float32 action, a pair, rad/s."""
    pitch_rate = 0.0 if gate.planar else clip(np.float64(action[2]), gate.pitch_limit)
    return clip(np.float64(action[1]), gate.yaw_limit), pitch_rate


@inner_kernel
def desired_rates(shares, gate):
    """Desired turn rates from fractions of their limits, a pair, rad/s, |ω| ≤ limit."""
    pitch_rate = 0.0 if gate.planar else clip(shares[-1], 1.0) * gate.pitch_limit
    return clip(shares[0], 1.0) * gate.yaw_limit, pitch_rate


@inner_kernel
def send_rates(rates, action, gate):
    """Write a pair of turn rates, rad/s, after the speed of an action (theory 3)."""
    action[1] = rates[0]
    if not gate.planar:
        action[2] = rates[1]


@inner_kernel
def turn(rates, pitch, action, gate):
    """``send_rates``, and m for the rounded rates, a triple without unit (theory 4)."""
    send_rates(rates, action, gate)
    return mean_axis(rates_of(action, gate), pitch, gate)
