"""Theorems E[T] and E[L]: mean time of law (1) under random detection.

**Sensor.** All rows are refreshed together, at most h apart, h = τ without a sample period, and
held. Given the past, link ij is detected with probability p(‖p_ij‖) ≥ q, independently per ordered
pair; with persistence it is redrawn with probability 1 − κ, and unchanged otherwise. In E[L] robots
may differ in p and κ; q is the least and κ the largest of all robots.

**E[T].** Undirected connected graph, no velocity scaling; white noise is allowed. γ is the mean
cosine of the noise, p ≤ p̄, and X ≥ 2q c_m the sum of all ‖Σ_j p_ij a_ij g_ij‖. Then

    E[T] ≤ (p̄ V0⁺ + (n−1) c)/F,     F = min_m min_X αX²/m − 2ηD̄_m X − m ζ D̄_m² − N_m > 0,
    A = γ(1−κ),   b = γκ,   θ = 2D̄h/r,   β = max(r p(d)/d) + r max p′₊,
    α = A(2 − θβA),   η = b|1 − θβA|,   ζ = θβb²,   N_m = ½θβ (D̄_m/D̄) Σa_ij² max_π (π − γ²π²),
    c = 4hD̄² (p̄ + θβ(1 − a/D̄)/4) for the loss by a merge, a the least weight; 8hD̄² (p̄ + θβ/2)
    if rows are held. For exact detection and noise q = p̄ = β = 1, κ = 0.

**E[L].** Any graph of theorem D1, velocity scaling allowed, no noise. With the D1 decrease y of L
per sample, x = hC/r < 1 and at most α_m unlinked robots within r of each other,

    E[T] ≤ L0/ρ + (n−1) B h/P,      ρ = min_m P y (1−x)^(B−1)/(B h),      P = (1 − (1−g)^B)^α_m,

for the best number B of samples, g the least probability of moving by the gain of y: (1−κ)q for a*,
or 1 − (1 − (1−κ)q)^k for the least weight and k neighbours. On complete graphs c_m stands for a*.

Proofs: docs/proofs.md, E[T] and E[L].
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scenario.scenario import Scenario
from ..settings import is_complete
from . import assumptions as given
from . import constants as known
from .gains import depth_gained
from .theorem import ROUNDED, Asked, Theorem, TheoremBounds

Array = NDArray[np.float64]

_NEARER = 1.0 - 2.0**-20  # of r: distances are rounded to float32
_MAX_SAMPLES = 64  # B, of the search


class Detection(NamedTuple):
    """Detection of linked neighbours at r or more, between samples h apart."""

    least: float  # q
    most: float  # p̄
    curvature: float  # β
    kept: float  # κ
    shortest: float  # time between samples, s
    longest: float  # h, s

    @property
    def fresh(self) -> float:
        """Probability (1 − κ) q of a detection that is independent of the past."""
        return (1.0 - self.kept) * self.least


def detection_of(scenario: Scenario) -> Detection:
    """Detection probabilities, persistence and sample times, the worst of a scenario's sensors."""
    sensing, n = scenario.sensing, scenario.n_robots
    dropout, persistence = (sensing.each(name, n).tolist() for name in ("dropout", "persistence"))
    own = {*zip(sensing.tables(n), dropout, persistence, strict=True)}
    found = [_detection_by(scenario, *one) for one in own]
    return found[0]._replace(
        least=min(one.least for one in found), kept=max(one.kept for one in found)
    )


def _detection_by(
    scenario: Scenario, detection: tuple[tuple[float, float], ...], dropout: float, time: float
) -> Detection:
    """``detection_of`` a robot with this table, dropout and persistence, s."""
    r, table = scenario.merge_radius, np.array(detection or ((0.0, 1.0),))
    table = table * (1.0, 1.0 - dropout)
    nearest = r * (_NEARER if detection else 1.0)
    first = nearest, float(np.interp(nearest, table[:, 0], table[:, 1]))
    d, p = np.vstack([first, table[table[:, 0] > nearest]]).T
    slope = np.max(np.diff(p) / np.diff(d), initial=0.0)
    per_sample = scenario.sensing.largest("sample_period") / scenario.tau
    # rounding of the ratio, beyond which a sample may come a step early or late
    few = max(1, math.floor(per_sample * (1.0 + 1e-15)))
    many = max(1, math.ceil(per_sample * (1.0 - 1e-15)))
    remembers = time > 0.0 and p.min() < 1.0
    return Detection(
        least=max(float(p.min()) - ROUNDED * (p.min() < 1.0), 0.0),
        most=float(p.max()),
        curvature=float((r * p / d).max() + r * slope),
        kept=math.exp(-few * scenario.tau / time) if remembers else 0.0,
        shortest=few * scenario.tau,
        longest=many * scenario.tau,
    )


def mean_cosine(scenario: Scenario) -> tuple[float, float]:
    """Bounds on γ = E cos ξ of the noise, numbers without unit, for angles drawn in float32."""
    noise = scenario.sensing.noise
    assert isinstance(noise, float)  # of all robots, by ``departs_by_chance``
    gamma = math.exp(-0.5 * noise**2)
    return max(gamma - ROUNDED * noise, 0.0), gamma + ROUNDED * noise


def lyapunov_decrease(scenario: Scenario, seen: Detection) -> float:
    """F of theorem E[T], (m/s)²: least mean decrease rate of U between merges; −inf if none."""
    m, most = known.robots_left(scenario), known.max_degrees(scenario)
    low, high = mean_cosine(scenario)
    theta = 2.0 * scenario.max_degree * seen.longest / scenario.merge_radius
    bent, spread = theta * seen.curvature, high * seen.kept
    a_low, a_high = low * (1.0 - seen.kept), high * (1.0 - seen.kept)
    alpha = 2.0 * a_low - bent * a_high**2
    if alpha <= 0.0:
        return -math.inf
    eta = spread * max(abs(1.0 - bent * a_low), abs(1.0 - bent * a_high))
    total = np.maximum(2.0 * seen.least * known.min_degrees(scenario), eta * most * m / alpha)
    steady = alpha * total**2 / m - 2.0 * eta * most * total - m * bent * (spread * most) ** 2
    return float((steady - _scatter(scenario, seen, bent, low)).min())


def _scatter(scenario: Scenario, seen: Detection, bent: float, gamma: float) -> Array:
    """N_m, (n − 1,), (m/s)²: mean rise of U by the scatter of velocities."""
    n, graph, m = scenario.n_robots, scenario.sensing_graph, known.robots_left(scenario)
    weights = graph.links(n)[2] * graph.weight_range[1]
    squares = np.minimum(2.0 * float(weights @ weights), m * (m - 1.0) * weights.max() ** 2)
    low, high = seen.fresh, seen.kept + (1.0 - seen.kept) * seen.most
    worst = min(max(low, 0.5 / gamma**2 if gamma > 0.0 else high), high)
    share = known.max_degrees(scenario) / scenario.max_degree
    return np.asarray(0.5 * bent * share * squares * (worst - (gamma * worst) ** 2))


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem E[T]; infinite for a step too long for the scatter, or limited speed."""
    degree, seen = scenario.max_degree, detection_of(scenario)
    if scenario.scales_velocity or scenario.min_speed_limit < degree:
        return TheoremBounds()
    fall = lyapunov_decrease(scenario, seen)
    exact = known.min_bearing_square(scenario)
    if fall <= 0.0 or given.outlasts_rounding(scenario, asked, min(fall / exact, 1.0)):
        return TheoremBounds()
    bent = 2.0 * degree * seen.longest / scenario.merge_radius * seen.curvature
    loss = seen.most + 0.25 * bent * (1.0 - known.lightest_link(scenario) / degree)
    if scenario.sensing.largest("sample_period") > 0.0:
        loss = 2.0 * (seen.most + 0.5 * bent)
    most = seen.most * known.lyapunov_bound(scenario, reach=degree * seen.longest)
    most += (scenario.n_robots - 1) * 4.0 * seen.longest * degree**2 * loss
    return TheoremBounds(expected_time=float(known.over_rate(most, fall)))


def max_unlinked(scenario: Scenario) -> Array:
    """Upper bounds on robots without links among them, α_m, an array (n − 1,), without unit.

    Each of E links has an end outside the set, which has Δ links at most: α ≤ n − E/Δ. Merging does
    not enlarge such a set. A graph that joins m robots has a link: α ≤ m − 1.
    """
    n, graph, m = scenario.n_robots, scenario.sensing_graph, known.robots_left(scenario)
    if is_complete(scenario):
        return np.ones(n - 1)
    if not graph.fixed or known.kind_of_links(graph) == known.SWITCHING:
        return np.maximum(m - 1.0, 1.0) if graph.undirected else m
    first, second, _ = graph.links(n)
    pairs = np.unique(np.sort(np.stack([first, second], axis=1), axis=1), axis=0)
    outside = math.ceil(len(pairs) / np.bincount(pairs.ravel()).max())
    return np.minimum(m - 1.0, n - outside)


def hull_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem E[L]; infinite for a step too long for the hull to be nested."""
    seen, m, r = detection_of(scenario), known.robots_left(scenario), scenario.merge_radius
    limit, most = scenario.min_speed_limit, scenario.max_degree
    if scenario.scales_velocity:
        limit, most = min(limit, r / (2.0 * scenario.tau)), min(most, r / (2.0 * scenario.tau))
    spare = r - seen.longest * most
    if spare <= 0.0 or seen.fresh <= 0.0:
        return TheoremBounds()
    depth = depth_gained(m, scenario.dim, known.led(scenario))

    def decrease(gain: Array) -> Array:
        """Decrease of L by a sample in which all shallow robots move, (n − 1,), m."""
        moved = seen.shortest * np.minimum(gain, limit)
        return np.asarray(moved * depth * spare / (spare + 2.0 * moved))

    found = [_events(scenario, seen, decrease, seen.longest * most / r)]
    if is_complete(scenario):
        full = decrease(known.min_degrees(scenario))
        lost = decrease(np.full(len(m), most)) / (full * seen.fresh)
        found.append((seen.fresh * full / seen.longest, seen.longest * lost))
    extent = known.largest_size(scenario) + known.hull_growth(scenario)
    if seen.longest > scenario.tau:  # merged robots keep moving to the next sample
        grown = 2.0 * math.pi * (scenario.dim - 1) * seen.longest * most
        extent += (scenario.n_robots - 1) * grown
    times, exact = [], decrease(known.min_degrees(scenario)) / seen.longest
    for rates, lost in found:
        spared = min(float((rates / exact).min()), 1.0)
        if rates.min() > 0.0 and not given.outlasts_rounding(scenario, asked, spared):
            times.append(extent / rates.min() + (scenario.n_robots - 1) * lost.max())
    return TheoremBounds(expected_time=float(min(times, default=math.inf)))


def _events(
    scenario: Scenario, seen: Detection, decrease: Callable[[Array], Array], share: float
) -> tuple[Array, Array]:
    """Rates ρ_m, m/s, and times lost by a merge, s, (n − 1,), for the best B and gains."""
    m, samples = known.robots_left(scenario), np.arange(1.0, _MAX_SAMPLES + 1.0)[:, None]
    sides = np.minimum(m - 1.0, known.min_neighbours(scenario))
    options = (
        (scenario.bottleneck_weight, np.full(len(m), seen.fresh)),
        (known.lightest_link(scenario), 1.0 - (1.0 - seen.fresh) ** sides),
    )
    rates, times = [], []
    for gain, chance in options:
        moved = (1.0 - (1.0 - chance) ** samples) ** max_unlinked(scenario)
        times.append(samples * seen.longest / moved)
        kept = (1.0 - share) ** (samples - 1.0)
        rates.append(decrease(np.full(len(m), gain)) * kept / times[-1])
    rate, time = np.vstack(rates), np.vstack(times)
    best = rate.argmax(axis=0), np.arange(len(m))
    return rate[best], time[best]


def rows_keep_their_frame(scenario: Scenario, asked: Asked) -> str:
    """Rows that are held between samples refer to the current frame."""
    holds = scenario.sensing.largest("sample_period") > 0.0
    return given.frames_stay(scenario, asked) if holds else ""


def detects_alike(scenario: Scenario, asked: Asked) -> str:
    """Two linked robots detect each other with the same probability, for U to be a potential."""
    for name in ("dropout", "detection", "persistence"):
        if given := scenario.sensing.list_given(name):
            return f"none: sensing.{name} is {given}; theorem E[T] needs one for all robots"
    return ""


_white = given.departs_by_chance("noise")
_drawn = given.departs_by_chance()
_FREE = given.no_obstacles, rows_keep_their_frame
THEOREMS = (
    Theorem("E[T]", ("law",), (*given.TEAM, _white, detects_alike, *_FREE), lyapunov_bounds, False),
    Theorem("E[L]", ("law",), (*given.JOINED, _drawn, *_FREE), hull_bounds, False),
)
