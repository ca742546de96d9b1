"""Arcs: what a robot that moves along its own axis does while its inputs are held (theory 4).

Angles are in radians, yaw α about the vertical, pitch β above the horizontal. In the plane the
pitch is 0 and the yaw is the heading θ of the unicycle.
"""

import math

from ..compilation import kernel


@kernel
def mean_cos_sin(angle, swept):
    """Means of cos and sin over an angle that grows evenly from ``angle`` by ``swept``.

    With S = sin(x)/x and C = (1 − cos x)/x they are (S cos a − C sin a, S sin a + C cos a); C is
    written as sin²(x/2)/(x/2), which loses no digits as x → 0.

    Args:
        angle: a, rad.
        swept: x, rad, of either sign.

    Returns:
        Two numbers in [−1, 1], without unit: the mean of cos, that of sin.
    """
    half = 0.5 * swept
    if abs(half) < 1e-8:
        mean_sin, mean_cos = half, 1.0
    else:
        sin_half = math.sin(half)
        mean_sin = sin_half * sin_half / half
        mean_cos = sin_half * math.cos(half) / half
    c, s = math.cos(angle), math.sin(angle)
    return mean_cos * c - mean_sin * s, mean_cos * s + mean_sin * c


@kernel
def arc_2d(speed, yaw, yaw_rate, duration):
    """Exact displacement of a unicycle with held inputs.

        ẋ = v cos θ,  ẏ = v sin θ,  θ̇ = ω                         (eq. 5)

    Args:
        speed: v, m/s; negative is backwards.
        yaw: θ at the start, rad.
        yaw_rate: ω, rad/s.
        duration: s.

    Returns:
        (x, y), a pair, m, in the frame that θ is measured in.
    """
    distance = speed * duration
    mean_cos, mean_sin = mean_cos_sin(yaw, yaw_rate * duration)
    return distance * mean_cos, distance * mean_sin


@kernel
def arc_3d(speed, yaw, pitch, yaw_rate, pitch_rate, duration):
    """Exact displacement of a 3-D nonholonomic robot with held inputs.

        ẋ = v cos β cos α,  ẏ = v cos β sin α,  ż = v sin β,  α̇ = ω_α,  β̇ = ω_β     (eq. 9)

    The products of cosines are written as sums of cosines of α + β and α − β, each of which grows
    evenly.

    Args:
        speed: v, m/s; negative is backwards.
        yaw: α at the start, rad.
        pitch: β at the start, rad.
        yaw_rate: ω_α, rad/s.
        pitch_rate: ω_β, rad/s.
        duration: s.

    Returns:
        (x, y, z), a triple, m, in the frame that α and β are measured in.
    """
    distance = speed * duration
    cos_sum, sin_sum = mean_cos_sin(yaw + pitch, (yaw_rate + pitch_rate) * duration)
    cos_difference, sin_difference = mean_cos_sin(yaw - pitch, (yaw_rate - pitch_rate) * duration)
    _, mean_sin_pitch = mean_cos_sin(pitch, pitch_rate * duration)
    return (
        distance * 0.5 * (cos_sum + cos_difference),
        distance * 0.5 * (sin_sum + sin_difference),
        distance * mean_sin_pitch,
    )


@kernel
def body_frame_2d(yaw):
    """R = (cos θ, −sin θ; sin θ, cos θ), from the body frame to the global one.

    The body frame has x = heading, y = left.

    Args:
        yaw: θ, rad.

    Returns:
        R row by row, 4 numbers without unit.
    """
    c, s = math.cos(yaw), math.sin(yaw)
    return c, -s, s, c


@kernel
def body_frame_3d(yaw, pitch):
    """R = R_z(α) R_y(−β), from the body frame of a robot in space to the global one.

    The body frame has x = heading h of eq. (9), y = horizontal left, z = up-ish.

    Args:
        yaw: α, rad.
        pitch: β, rad.

    Returns:
        R row by row, 9 numbers without unit.
    """
    ca, sa = math.cos(yaw), math.sin(yaw)
    cb, sb = math.cos(pitch), math.sin(pitch)
    return cb * ca, -sa, -sb * ca, cb * sa, ca, -sb * sa, sb, 0.0, cb


@kernel
def clip(value, bound):
    """min(max(value, −bound), bound), a number in their unit; they are of the same unit."""
    return min(max(value, -bound), bound)
