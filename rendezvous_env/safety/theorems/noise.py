"""Theorems N, N1, N1' and E[T]: bearings that are wrong, by a bounded angle or at random.

**N.** All Σ_j c_ij are equal to c, of every robot left, and every bearing is within η < π/n of
the true one, in space tan η < 1/√(n(n−2)). On any graph on which all see somebody, in continuous
time,

    T ≤ L0 sin(π/n)/(2 c κ(n) sin(π/n − η)),      in space  w0/(2c [cos η/n − sin η √(1 − 2/n)]).

Inputs that are held count as errors: η_m = η + asin(2 c_m τ/r), T ≤ L0 / min_m shrinking(m, c_m,
η_m) + (n−1) τ. With η > 0 the hull is not nested: L decreases in steps without a merge, and in
one with a merge it grows by 2 c τ sin(η/2) in every direction at most, which L0 counts n − 1
times.

**N1.** Law (1), undirected connected graph, τ ≤ r/(2D̄), nobody slowed down. With e_i = 2
sin(η/2) D_i and ρ = n D̄ sin(η/2)/a* < 1:

    V(t+τ) ≤ V(t) − τ Σ(‖f_i‖² − e_i²) between merges,
    T ≤ n (V0⁺ + (n−1) τ Σ e_i²)/(4a*²(1 − ρ²)) + (n−1) τ.

**N1'.** Any policy under headings that are certified against f̂ and go max(0, h·f̂_i − e_i) along
them: V never rises between merges, and with q = ε(2−β) − 2(1+ε)ρ > 0, β = ½, T ≤ n V0⁺/(a*² q²
s_min) + (n−1) τ.

**E[T].** Noise that is drawn anew for every bearing and step, τ = θ r/(2D̄), γ = exp(−σ²/2), ν =
n(1−γ²) Σ a_ij²/(4a*²), θ < 2γ/(γ²+ν): E[T] ≤ n (V0⁺ + n(n−1) r θ D̄)/(4a*² [γ(2−θγ) − θν]).

**Proofs.** docs/proofs.md, N to E[T].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...scenario.scenario import Scenario
from ...sensors.sensing import Sensing
from ..gains import gain_range
from ..settings import error_chord
from .assumptions import (
    all_neighbours_seen,
    bounded_errors,
    certified_or_scaled,
    connected,
    nothing_in_the_way,
    on_graphs,
    one_leader_at_most,
    undirected,
    velocity_inputs,
)
from .constants import (
    DIRECTED,
    SWITCHING,
    UNDIRECTED,
    checked,
    degrees_stay_equal,
    directions,
    hull_growth,
    largest_lyapunov,
    largest_size,
    least_degrees,
    led,
    long_step,
    lyapunov_bound,
    over_rate,
    scale_bound,
)
from .gains import shrinking
from .theorem import Asked, Bounds, Theorem, too_wrong

Array = NDArray[np.float64]

DEAD_ZONE = 0.5
"""β of the dead zone δ = βa*/n of certified headings."""

# ---- N: equal gains ------------------------------------------------------------------------------


def largest_error(n: ArrayLike, dim: int) -> Array:
    """η below which theorem N promises a rendezvous, rad.

        2-D   η < π/n (sharp),        3-D   tan η < 1/√(n(n − 2)), sufficient

    Args:
        n: number of robots, (...), at least 2.
        dim: 2 or 3.

    Returns:
        (...), rad.
    """
    m = np.asarray(n, dtype=np.float64)
    if dim == 2:
        return np.asarray(np.pi / m)
    return np.arctan2(1.0, np.sqrt(m * (m - 2.0)))


def held_error(gain: ArrayLike, duration: ArrayLike, merge_radius: float) -> Array:
    """The error of a bearing that is held, or late, for a while, rad: asin(2 c (τ + delay)/r).

    It adds to the errors of the sensor and of the direction of the motion.

    Args:
        gain: c, no robot is faster, (...), m/s.
        duration: τ + delay, (...), s.
        merge_radius: r, m.

    Returns:
        (...), rad; π where a neighbour can be passed meanwhile.
    """
    sine = 2.0 * np.asarray(gain) * np.asarray(duration) / merge_radius
    return np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)), np.pi)


def wrong_bearings_time(
    n: ArrayLike, dim: int, initial_size: ArrayLike, gain: ArrayLike, error: ArrayLike
) -> Array:
    """T of theorem N in continuous time, s.

    Args:
        n: number of robots, (...), at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        gain: c, (...), m/s.
        error: η, (...), rad.

    Returns:
        (...), s; infinite from ``largest_error`` on.
    """
    return over_rate(np.asarray(initial_size), shrinking(n, dim, gain, error))


def equal_gains(scenario: Scenario, asked: Asked) -> Array | None:
    """c_m of m = 2 … n robots left, (n − 1,), m/s, if all have that and nobody is slowed down
    (theorem N).
    """
    if asked.by == "gains":
        least, most = gain_range(scenario, asked.min_gain, asked.max_gain)
        if not least == most <= scenario.speed_limit:
            return None
        return np.full(scenario.n_robots - 1, least)
    gains = least_degrees(scenario)
    even = degrees_stay_equal(scenario) and not (long_step(scenario) and scenario.scales_velocity)
    return gains if even and scenario.speed_limit >= gains.max(initial=0.0) else None


def gains_are_equal(scenario: Scenario, asked: Asked) -> str:
    """All robots that are left have the same Σ_j c_ij at any time, and all of them see somebody."""
    if equal_gains(scenario, asked) is not None and not led(scenario):
        return ""
    return (
        f"none: bearings may err by {asked.error:.4g} rad; theorem N needs gains that add up to "
        "the same for all robots, all of whom see one"
    )


def held_size_bound(scenario: Scenario, initial_size: ArrayLike) -> Array:
    """Time by which law (1) has brought all together, inputs held over the step, s (theorem N).

    Args:
        scenario: gives n, the dimension, the graph, r, τ and v_max.
        initial_size: L(0), (...), m.

    Returns:
        (...), s; infinite where nothing is proven, as where degrees do not stay equal.

    Raises:
        ValueError: if a size is not finite or negative.
    """
    initial = checked("initial_size", initial_size, "m")
    gains = equal_gains(scenario, _LAW)
    if gains is None:
        return np.full(initial.shape, np.inf)
    return _equal_gain_time(scenario, initial, gains, 0.0)


_LAW = Asked("law", 1.0, 0.0, None, None, 0.5, 0.0)


def _equal_gain_time(scenario: Scenario, size: ArrayLike, gains: Array, error: float) -> Array:
    """T of theorem N with held inputs, s; infinite where an η_m is too large. Two robots whose
    bearings are right are never wrong about each other: they move on one line.
    """
    left = np.arange(2.0, scenario.n_robots + 1.0)
    late_by = held_error(gains, scenario.tau, scenario.merge_radius)
    if error == 0.0:
        late_by = np.where(left == 2, 0.0, late_by)
    initial = np.asarray(size)[..., np.newaxis]
    times = wrong_bearings_time(left, scenario.dim, initial, gains, error + late_by)
    return np.asarray(times.max(axis=-1) + (scenario.n_robots - 1) * scenario.tau)


def equal_gain_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem N with inputs held."""
    gains = equal_gains(scenario, asked)
    assert gains is not None  # an assumption
    n, dim, error = scenario.n_robots, scenario.dim, asked.error
    strayed = 2.0 * gains.max() * scenario.tau * math.sin(error / 2.0)
    extent = largest_size(scenario) + hull_growth(scenario)
    extent += (n - 1) * directions(dim) * strayed
    time = float(_equal_gain_time(scenario, extent, gains, error))
    late_by = held_error(gains, scenario.tau, scenario.merge_radius)
    borne = float((largest_error(np.arange(2.0, n + 1.0), dim) - late_by).min())
    borne = max(0.0, borne)
    who = "law (1)" if asked.by == "law" else "every policy that weighs neighbours"
    words = f"theorem N: {who} meets in finite time although bearings err by {error:.4g} rad"
    return Bounds(
        words=words if math.isfinite(time) else too_wrong(asked, borne, who),
        meets=math.isfinite(time),
        time=time,
        hull=extent if math.isfinite(time) else math.inf,
        tolerated_bearing_error=borne,
    )


# ---- N1: law (1) ---------------------------------------------------------------------------------


def most_wrong(degree: ArrayLike, error: float) -> Array:
    """The most by which a net bearing can be wrong, e_i = 2 sin(η/2) D_i (theorem N1), m/s.

    Args:
        degree: D_i = Σ_j a_ij, (...), m/s.
        error: η, a number, rad: no bearing is off by more.

    Returns:
        (...), m/s.
    """
    return np.asarray(error_chord(error) * np.asarray(degree))


def error_share(scenario: Scenario, error: float) -> float:
    """ρ = n D̄ sin(η/2)/a*, what errors take from Σ‖f_i‖ ≥ 2 a*, a number without unit (N1).

    Args:
        scenario: gives n, D̄ and a*.
        error: η, rad.
    """
    wrong = scenario.n_robots * most_wrong(scenario.max_degree, error)
    return float(wrong / (2.0 * scenario.bottleneck_weight))


def error_of_share(scenario: Scenario, share: ArrayLike) -> float:
    """The η of a given ρ, 2 asin(ρ a*/(n D̄)), a number, rad (theorem N1): see ``error_share``.

    Args:
        scenario: gives n, D̄ and a*.
        share: ρ, without unit, at least 0.
    """
    sine = (
        np.asarray(share) * scenario.bottleneck_weight / (scenario.n_robots * scenario.max_degree)
    )
    return float(2.0 * np.arcsin(np.minimum(sine, 1.0)))


def law_time_bound(scenario: Scenario, initial_lyapunov: ArrayLike, error: float) -> Array:
    """T for law (1) as it is, inputs held, s (theorem N1).

    Args:
        scenario: undirected and connected, with a step that is certified.
        initial_lyapunov: V(0), (...), m²/s.
        error: η, rad.

    Returns:
        (...), s; infinite for ρ ≥ 1, for a long step, or if robots can be slowed down.
    """
    n, step = scenario.n_robots, scenario.tau
    above = lyapunov_bound(scenario, initial_lyapunov)
    if scenario.speed_limit < scenario.max_degree or long_step(scenario):
        return np.full(above.shape, np.inf)
    lost = (n - 1) * step * n * most_wrong(scenario.max_degree, error) ** 2
    rate = 4.0 * scenario.bottleneck_weight**2 * (1.0 - error_share(scenario, error) ** 2)
    return over_rate(n * (above + lost), rate) + (n - 1) * step


def law_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem N1."""
    time = float(law_time_bound(scenario, largest_lyapunov(scenario), asked.error))
    usable = scenario.speed_limit >= scenario.max_degree and not long_step(scenario)
    borne = error_of_share(scenario, 1.0) if usable else 0.0
    words = (
        f"theorem N1: law (1) meets in finite time although bearings err by {asked.error:.4g} rad"
    )
    return Bounds(
        words=words if math.isfinite(time) else too_wrong(asked, borne, "law (1)"),
        meets=math.isfinite(time),
        time=time,
        tolerated_bearing_error=borne,
    )


# ---- N1' and the tank: certified velocities ------------------------------------------------------


def certified_share(
    min_alignment: ArrayLike, rho: ArrayLike, dead_zone: float = DEAD_ZONE
) -> Array:
    """Share q = ε (2 − β) − 2 (1 + ε) ρ: Σ_i (h·f̂_i − e_i)₊ ≥ q a* (theorem N1').

    Args:
        min_alignment: ε, (...), without unit.
        rho: ρ of ``error_share``, (...), without unit.
        dead_zone: β, the dead zone δ in units of a*/n; a tank has none, 0.

    Returns:
        (...), without unit; nothing is promised unless it is positive.
    """
    epsilon = np.asarray(min_alignment)
    return np.asarray(epsilon * (2.0 - dead_zone) - 2.0 * (1.0 + epsilon) * np.asarray(rho))


def forgiven_share(min_alignment: ArrayLike, dead_zone: float = DEAD_ZONE) -> Array:
    """The ρ at which q = 0, so that any less is tolerated: ε (2 − β)/(2 (1 + ε)) (theorem N1').

    Args:
        min_alignment: ε, (...), without unit.
        dead_zone: β, as ``certified_share``.

    Returns:
        (...), without unit.
    """
    epsilon = np.asarray(min_alignment)
    return np.asarray(epsilon * (2.0 - dead_zone) / (2.0 * (1.0 + epsilon)))


def certified_time(scenario: Scenario, most: ArrayLike, share: ArrayLike) -> Array:
    """T ≤ n V0⁺/(a*² q² s_min) + (n−1) τ of velocities that are certified against what is seen, s.

    Args:
        scenario: gives n, a*, τ and s_min.
        most: V0⁺, or what stands for it, (...), m²/s.
        share: q of ``certified_share``, (...), without unit.

    Returns:
        (...), s; infinite for q ≤ 0.
    """
    n, q = scenario.n_robots, np.maximum(np.asarray(share), 0.0)
    rate = (scenario.bottleneck_weight * q) ** 2 * scale_bound(scenario)
    return over_rate(n * np.asarray(most), rate) + (n - 1) * scenario.tau


def heading_time_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, error: float, min_alignment: float
) -> Array:
    """T for certified headings that allow for errors, inputs held, s (theorem N1').

    Args:
        scenario: undirected and connected.
        initial_lyapunov: V(0), (...), m²/s.
        error: η, rad.
        min_alignment: ε.

    Returns:
        (...), s; infinite for q ≤ 0.
    """
    share = certified_share(min_alignment, error_share(scenario, error))
    return certified_time(scenario, lyapunov_bound(scenario, initial_lyapunov), share)


def heading_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem N1'."""
    start, margin = largest_lyapunov(scenario), asked.min_alignment
    time = float(heading_time_bound(scenario, start, asked.error, margin))
    scaled = " with velocities scaled to the long step" if long_step(scenario) else ""
    borne = error_of_share(scenario, forgiven_share(margin))
    words = (
        "theorem N1': every policy under certified headings that allow for errors of "
        f"{asked.error:.4g} rad meets in finite time{scaled}"
    )
    if math.isinf(time):
        words = too_wrong(asked, borne, "a heading of this margin")
        words += "; V still never rises between merges"
    return Bounds(
        words=words,
        meets=math.isfinite(time),
        time=time,
        tolerated_bearing_error=borne,
    )


# ---- E[T]: noise without a bound -----------------------------------------------------------------


def mean_cosine(noise: ArrayLike) -> Array:
    """γ = E cos ξ = exp(−σ²/2) of a normally distributed angle ξ.

    Args:
        noise: σ, (...), rad.

    Returns:
        (...), without unit.
    """
    return np.asarray(np.exp(-0.5 * np.asarray(noise) ** 2))


def scatter(scenario: Scenario, cosine: ArrayLike) -> Array:
    """ν = n (1 − γ²) Σ a_ij²/(4 a*²), what noise adds to ‖f‖² as a share of 4 a*²/n.

    Args:
        scenario: gives n, a* and Σ_i Σ_j a_ij², each link in both directions.
        cosine: γ of ``mean_cosine``, (...), without unit.

    Returns:
        (...), without unit.
    """
    n, graph = scenario.n_robots, scenario.sensing_graph
    weights = graph.links(n)[2] * graph.weight_range[1]
    spread = n * (1.0 - np.asarray(cosine) ** 2) * 2.0 * float(weights @ weights)
    return np.asarray(spread / (4.0 * scenario.bottleneck_weight**2))


def expected_time_bound(scenario: Scenario, initial_lyapunov: ArrayLike) -> Array:
    """E[T] of law (1) under the sensor's noise, s (theorem E[T]).

    Args:
        scenario: undirected and connected; gives n, r, τ, D̄, a* and σ.
        initial_lyapunov: V(0), (...), m²/s.

    Returns:
        (...), s; infinite if the step is too long for this noise, or robots can be slowed down.
    """
    n, degree, radius = scenario.n_robots, scenario.max_degree, scenario.merge_radius
    above = lyapunov_bound(scenario, initial_lyapunov)
    if scenario.speed_limit < degree:
        return np.full(above.shape, np.inf)
    gamma, theta = mean_cosine(scenario.sensing.noise), 2.0 * degree * scenario.tau / radius
    share = gamma * (2.0 - theta * gamma) - theta * scatter(scenario, gamma)
    cut_short = n * (n - 1) * radius * theta * degree
    return over_rate(n * (above + cut_short), 4.0 * scenario.bottleneck_weight**2 * share)


def noise_alone(scenario: Scenario, asked: Asked) -> str:
    """Noise that is drawn anew for every bearing and step is all that is wrong."""
    alone = scenario.sensing == Sensing(noise=scenario.sensing.noise) and scenario.sensing.noise > 0
    if alone and asked.error == 0.0:
        return ""
    return "none: the mean time is known of noise alone, drawn anew for every bearing and step"


def noisy_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """The mean time; in a single episode nothing is sure."""
    return Bounds(expected_time=float(expected_time_bound(scenario, largest_lyapunov(scenario))))


_SEEING = (velocity_inputs, bounded_errors, all_neighbours_seen, nothing_in_the_way)
THEOREMS = (
    Theorem(
        "N",
        ("law", "gains"),
        (
            on_graphs(UNDIRECTED, DIRECTED, SWITCHING),
            connected,
            one_leader_at_most,
            *_SEEING,
            gains_are_equal,
        ),
        equal_gain_bounds,
    ),
    Theorem("N1", ("law",), (undirected, connected, *_SEEING, certified_or_scaled), law_bounds),
    Theorem("N1'", ("heading",), (undirected, connected, *_SEEING), heading_bounds),
    Theorem(
        "E[T]",
        ("law",),
        (undirected, connected, velocity_inputs, noise_alone, nothing_in_the_way),
        noisy_bounds,
        rendezvous=False,
    ),
)
