"""Theorem D's energy tank: what a step earns, what it owes, and what is done with an empty tank.

docs/guarantees.md, section 8. Each robot keeps this account alone, from its own bearings. Vectors
are triples in one frame; a vector of the plane has z = 0 and keeps it.
"""

from ..compilation import kernel
from ..equations.vectors import combine, dot, norm, split
from .heading import into_cap, scale_of_step


@kernel
def descent_scale(strength, degree, merge_radius, duration, speed_limit):
    """Factor s on f with which a step is sure to let V fall, and no faster than the robot may go.

        s = min(1, r/(2 D τ), v_max/‖f‖)                            (theorem D)

    Args:
        strength: ‖f‖, m/s.
        degree: D, the summed lengths of the neighbour rows, positive, m/s.
        merge_radius: r, m.
        duration: τ, s.
        speed_limit: v_max, m/s.

    Returns:
        s, a number in (0, 1], without unit.
    """
    unhurried = speed_limit / max(strength, speed_limit)
    return min(scale_of_step(degree, merge_radius, duration), unhurried)


@kernel
def certain_descent(net_bearing, degree, displacement, merge_radius, error=0.0):
    """This robot's part in what V is sure to fall by; negative where V may rise.

        2 f·Δ − (2/r) D ‖Δ‖² − 2 e ‖Δ‖                              (theorem D)

    Summed over the robots this bounds V(t) − V(t + τ) while neighbours stay at least r apart.

    Args:
        net_bearing: f, a triple, m/s.
        degree: D, m/s.
        displacement: Δ over the step, a triple, m.
        merge_radius: r, m.
        error: e, m/s: f is wrong by no more.

    Returns:
        A number, m²/s.
    """
    spent = 2.0 / merge_radius * degree * dot(displacement, displacement)
    sure = 2.0 * dot(net_bearing, displacement) - spent
    return sure - 2.0 * error * norm(displacement) if error > 0.0 else sure


@kernel
def promised_descent(strength, scale, min_alignment, duration, error=0.0):
    """What a robot owes in every step, so that all meet in finite time (theorem D).

        ε² τ s ‖f‖²,   with errors   τ s max(0, ε ‖f‖ − e)²

    Args:
        strength: ‖f‖, m/s.
        scale: s, without unit.
        min_alignment: ε, without unit.
        duration: τ, s.
        error: e, m/s.

    Returns:
        A number, m²/s.
    """
    if error > 0.0:
        sure = max(min_alignment * strength - error, 0.0)
        return duration * scale * sure * sure
    return min_alignment * min_alignment * duration * scale * strength * strength


@kernel
def descending_velocity(wanted, net_bearing, scale, min_alignment, error=0.0):
    """Law (4) along the wanted line, which earns at least what is owed.

        v = s h hᵀf,   h the wanted direction projected onto the cap |hᵀf| ≥ ε‖f‖    (theorem D)
        v = s max(0, hᵀf − e) h                                     with errors (theorem N1')

    The direction is f/‖f‖ where nothing is wanted.

    Args:
        wanted: a triple, of any length and unit.
        net_bearing: f, a triple, not zero, m/s.
        scale: s, without unit.
        min_alignment: ε, without unit.
        error: e, m/s.

    Returns:
        v, a triple, m/s.
    """
    (length, h), (_, towards) = split(wanted), split(net_bearing)
    if length == 0.0:
        h = towards
    elif dot(h, towards) < 0.0:  # h and −h are the same line
        h = combine(-1.0, h, 0.0, h)
    h = into_cap(h, towards, min_alignment, towards)
    along = dot(h, net_bearing)
    if error > 0.0:
        along = max(along - error, 0.0)
    return combine(scale * along, h, 0.0, h)
