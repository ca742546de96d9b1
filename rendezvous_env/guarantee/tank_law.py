"""Theorem D for the robots of many teams: what is wanted while the tank lasts, else what earns."""

import math

import numpy as np

from ..compilation import inlined_kernel, kernel, unfolded_kernel
from ..engine.pool.sharing import each_block
from ..equations.robots.arcs import clip
from ..equations.robots.kinematics import speed_scale
from ..equations.rows import degree_of, net_bearing_of
from ..equations.vectors import dot, load, scaled, split, store
from .tank import certain_descent, descending_velocity, descent_scale, promised_descent
from .teams import teams_of_block
from .turning import gated_rate_2d, gated_rates_3d, mean_axis_2d, mean_axis_3d


@kernel
def spend_tanks(share, turns_body, observations, constants, held, levels, actions, told):
    """The actions of the teams that this thread takes, and what is told of them (theorem D).

        carried out if A + G(Δ) ≥ 0,   G(Δ) = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²

    With bearing errors f may be wrong by e = 2 sin(η/2) D: see tank.py for what is charged then.

    Args:
        share: this thread's part, as sharing.py says.
        turns_body: whether the robots are nonholonomic.
        observations: (B, n, rows, d), in the robots' own frames; neighbour rows in m/s.
        constants: of the tank, see energy_tank.py.
        held: what is wanted, (B, n, k), as shares of the limits.
        levels: A, (B, n), m²/s.
        actions: (B, n, a) float32, all zero; filled in, m/s and rad/s.
        told: deposits G (m²/s), carried_out, alignment |hᵀf|/‖f‖ and lyapunov_rate −2 f·Δ/τ
            (m²/s²), (B, n) each; filled in.

    Returns:
        Whether all blocks are done, see ``each_block``.
    """
    return each_block(
        share, _spend_teams, (turns_body, observations, constants, held, levels, actions, told)
    )


@unfolded_kernel
def _spend_teams(block, arguments):
    turns_body, observations, constants, held, levels, actions, told = arguments
    first, last = teams_of_block(block, len(observations))
    for team in range(first, last):
        _spend_team(
            turns_body,
            observations[team],
            constants,
            held[team],
            levels[team],
            actions[team],
            (told[0][team], told[1][team], told[2][team], told[3][team]),
        )


@inlined_kernel
def _spend_team(turns_body, observations, constants, held, levels, actions, told):
    deposits, carried_out, alignment, lyapunov_rate = told
    for i in range(len(observations)):
        rows = observations[i]
        f = net_bearing_of(rows, constants.neighbour_slots)
        degree = degree_of(rows, constants.neighbour_slots)
        strength, _ = split(f)
        deposits[i], carried_out[i], alignment[i], lyapunov_rate[i] = 0.0, False, np.nan, 0.0
        if degree == 0.0:
            continue
        if turns_body:
            carried_out[i], deposits[i], moved = _spend_turning(
                rows, f, strength, degree, constants, held[i], levels[i], actions[i]
            )
            ahead = f[0]
        else:
            carried_out[i], deposits[i], moved = _spend_going(
                f, strength, degree, constants, held[i], levels[i], actions[i]
            )
            length, direction = split(moved)
            ahead = dot(direction, f) if length > 0.0 else np.nan
        if strength > 0.0:
            alignment[i] = abs(ahead) / strength
        lyapunov_rate[i] = -2.0 * dot(f, moved) / constants.duration


@inlined_kernel
def _spend_going(f, strength, degree, constants, held, level, action):
    """One robot that goes anywhere: whether its wish is carried out, its deposit, displacement."""
    error = constants.error_chord * degree
    scale = descent_scale(
        strength, degree, constants.merge_radius, constants.duration, constants.speed_limit
    )
    owed = promised_descent(strength, scale, constants.min_alignment, constants.duration, error)
    wanted = scaled(load(held), constants.speed_limit)
    _, within = speed_scale(dot(wanted, wanted), constants.speed_limit)
    moved = _go(scaled(wanted, within), constants, action)
    deposit = certain_descent(f, degree, moved, constants.merge_radius, error) - owed
    carried_out = level + deposit >= 0.0
    if not carried_out:
        moved = _go(
            descending_velocity(wanted, f, scale, constants.min_alignment, error), constants, action
        )
        deposit = certain_descent(f, degree, moved, constants.merge_radius, error) - owed
    return carried_out, deposit, moved


@inlined_kernel
def _go(velocity, constants, action):
    """Send a velocity; its displacement as it will be executed, after rounding to float32."""
    store(velocity, action)
    sent = load(action)
    _, within = speed_scale(dot(sent, sent), constants.speed_limit)
    return scaled(sent, constants.duration * within)


@inlined_kernel
def _spend_turning(rows, f, strength, degree, constants, held, level, action):
    """One nonholonomic robot, in its body frame; returns as ``_spend_going``."""
    pitch, error = 0.0, constants.error_chord * degree
    if len(held) == 3:
        gravity = load(rows[constants.gravity_row])
        pitch = math.atan2(-gravity[0], -gravity[2])
    action[0] = clip(held[0], 1.0) * constants.speed_limit
    action[1] = clip(held[1], 1.0) * constants.yaw_limit
    if len(held) == 3:
        action[2] = clip(held[2], 1.0) * constants.pitch_limit
    moved = _drive(_mean_axis(action, pitch, constants), constants, action)
    deposit = certain_descent(f, degree, moved, constants.merge_radius, error)
    carried_out = level + deposit >= 0.0
    if not carried_out:
        _gate(f, pitch, constants, action)
        mean_axis = _mean_axis(action, pitch, constants)
        scale = descent_scale(
            strength, degree, constants.merge_radius, constants.duration, constants.speed_limit
        )
        along = dot(mean_axis, f)
        if error > 0.0:
            along = math.copysign(max(abs(along) - error, 0.0), along)
        action[0] = scale * along
        moved = _drive(mean_axis, constants, action)
        deposit = certain_descent(f, degree, moved, constants.merge_radius, error)
    return carried_out, deposit, moved


@kernel
def _gate(f, pitch, constants, action):
    """Replace turn rates that would let a robot stay orthogonal to f, in place."""
    yaw_rate = np.float64(action[1])
    margin, dead_zone = constants.min_alignment, constants.dead_zone
    if len(action) == 2:
        action[1] = gated_rate_2d(
            yaw_rate, f, margin, dead_zone, constants.duration, constants.yaw_limit
        )
        return
    action[1], action[2] = gated_rates_3d(
        (yaw_rate, np.float64(action[2])),
        f,
        pitch,
        margin,
        dead_zone,
        constants.duration,
        (constants.yaw_limit, constants.pitch_limit),
    )


@kernel
def _mean_axis(action, pitch, constants):
    """The mean body axis m over a step with the turn rates of an action, in the body frame."""
    yaw_rate = clip(np.float64(action[1]), constants.yaw_limit)
    if len(action) == 2:
        return mean_axis_2d(yaw_rate, constants.duration)
    pitch_rate = clip(np.float64(action[2]), constants.pitch_limit)
    return mean_axis_3d(yaw_rate, pitch_rate, pitch, constants.duration)


@inlined_kernel
def _drive(mean_axis, constants, action):
    """The displacement τ v m (theory 4, arcs) of an action."""
    speed = clip(np.float64(action[0]), constants.speed_limit)
    return scaled(mean_axis, constants.duration * speed)


@kernel
def book_deposits(levels, deposits, contact, merged_into, resting):
    """Bring the levels of B teams up to the end of a step: A ← max(A + G, 0), in place (theorem D).

    A robot that presses against a wall along f would earn without end: in a step with contact only
    a loss is booked. A loss that would empty a tank is rounding. A survivor takes all.

    Args:
        levels: A, (B, n), m²/s.
        deposits: G, (B, n), m²/s; zero afterwards.
        contact: (B, n) bool, whether the robot touched an obstacle.
        merged_into: (B, n), index of the robot that each one is now part of.
        resting: (B,) bool, teams that the step passed by.
    """
    for team in range(len(levels)):
        for i in range(levels.shape[1]):
            deposit = deposits[team, i]
            deposits[team, i] = 0.0
            if resting[team] or (contact[team, i] and deposit > 0.0):
                continue
            levels[team, i] = max(levels[team, i] + deposit, 0.0)
        for i in range(levels.shape[1]):
            survivor = merged_into[team, i]
            if survivor != i:
                levels[team, survivor] += levels[team, i]
                levels[team, i] = 0.0
