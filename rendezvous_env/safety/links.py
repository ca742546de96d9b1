"""Connectivity maintenance: velocities that lengthen no visible link (theorem R, guarantees 12)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compilation import inner_kernel, kernel
from ..engine.threads import Calls, Slice
from ..physics.least_norm import min_along, min_norm_of
from ..physics.neighbour_rows import degree_of, net_bearing_of
from ..physics.vectors import (
    ORIGIN,
    combine,
    cross,
    dot,
    load,
    perpendicular,
    scaled,
    split,
    store,
    subtract,
    without,
)
from ..robots.single_integrator import speed_scale
from ..scenario.scenario import Scenario
from .safety_filter import Float32, SafetyFilter, check_inputs, over_robots, register_filter
from .settings import check_bearing_error, check_share, check_vectors


def min_norm_points(neighbour_rows: ArrayLike) -> NDArray[np.float64]:
    """Point of least norm q_i = argmin ‖q‖, q ∈ conv{g_ij}, (..., d), without unit (lemma 2).

    Rows are a_ij g_ij, (..., K, d), m/s; zero rows are absent, lengths are ignored. q_i is zero if
    neighbours surround the robot, or none is visible (guarantees 12).

    Raises:
        ValueError: for a wrong shape, or rows that are not finite.
    """
    rows = check_vectors("neighbour_rows", neighbour_rows)
    if rows.ndim < 2:
        raise ValueError(f"neighbour_rows has shape {rows.shape}; it must be (..., K, d)")
    points = np.empty((*rows.shape[:-2], rows.shape[-1]))
    _least_norm_points(rows.reshape(-1, *rows.shape[-2:]), points.reshape(-1, rows.shape[-1]))
    return points


@kernel
def _least_norm_points(rows, out):
    for i in range(len(rows)):
        store(min_norm_of(rows[i], rows.shape[1]), out[i])


def link_keeping_law(
    least_norm_point: NDArray[np.float64], degree: Any, *, merge_radius: float, duration: float
) -> NDArray[np.float64]:
    """Velocities v_i = min(d_i, r/τ) q_i, (..., d), m/s, that lengthen no visible link (R b).

    Inputs are q_i, (..., d), in the robot's frame, d_i = Σ_j a_ij, (...), m/s, r in m and τ in s.
    """
    speed = np.minimum(degree, merge_radius / duration)
    return least_norm_point * np.asarray(speed)[..., np.newaxis]


_MOST_ROUNDS = 48  # maximum number of iterations; a few suffice for any number of links
_SLACK = 1e-13  # violation of a ball, relative to ρ², that counts as on it
_ALIKE = 1e-11  # bearings whose difference is shorter than this are one bearing


@inner_kernel
def project_on_links(wanted, rows, neighbour_slots, radius, error):
    """Velocity in B_i closest to the desired one, a triple, m/s (theorem R c).

    Inputs are rows a_ij g_ij, (rows, d), m/s, the first K neighbours; ρ, m/s; and η, rad.
    Active-set method with at most three balls: while the point violates a ball, it is replaced by
    the nearest point of that ball and the active ones, at a larger distance. A remainder from
    rounding is scaled into the set: ‖v‖ ≤ 2 ρ cos ∠(v, g) for all g.
    """
    point, active = wanted, (ORIGIN, ORIGIN, ORIGIN)
    for _ in range(_MOST_ROUNDS):
        bearing = worst_bearing(point, rows, neighbour_slots, error)
        if _excess(point, bearing, radius) <= _SLACK * radius * radius:
            break
        point, active = _nearest_on(wanted, bearing, active, radius)
        if dot(point, point) == 0.0:
            break
    speed, direction = split(point)
    bearing = worst_bearing(direction, rows, neighbour_slots, error)
    most = max(2.0 * radius * dot(direction, bearing), 0.0)
    return point if speed <= most else scaled(direction, most)


@inner_kernel
def worst_bearing(direction, rows, neighbour_slots, error):
    """Bearing within η, rad, of the visible ones with the least component along v, a triple.

    g cos α − u sin α, α = min(η, π − ∠(g, v)), u ⟂ g along v; zero without a visible neighbour.
    """
    g = min_along(rows, neighbour_slots, direction)
    if error == 0.0 or dot(g, g) == 0.0:
        return g
    size, across = split(without(direction, g))
    if size == 0.0:
        across = split(perpendicular(g))[1]
    tilt = min(error, math.pi - math.atan2(size, dot(direction, g)))
    return combine(math.cos(tilt), g, -math.sin(tilt), across)


@inner_kernel
def _excess(point, bearing, radius):
    """Violation ‖x‖² − 2 ρ x·g of the ball of a bearing; negative inside."""
    return dot(point, point) - 2.0 * radius * dot(point, bearing)


@inner_kernel
def _nearest_on(wanted, bearing, active, radius):
    """Closest point to the desired one in several balls, on the boundary of the first.

    Returns also the balls it lies on. ``active`` holds up to three others, zero for none.
    """
    found, kept = ORIGIN, (ORIGIN, ORIGIN, ORIGIN)
    least = dot(wanted, wanted)
    others = (ORIGIN, active[0], active[1], active[2])
    for k in range(4):
        for m in range(max(k, 1)):
            on = (bearing, others[k], others[m])
            point = _nearest_on_all(wanted, on, radius)
            worst = -math.inf
            for other in active:
                if dot(other, other) > 0.0:
                    worst = max(worst, _excess(point, other, radius))
            gap = subtract(point, wanted)
            if worst <= _SLACK * radius * radius and dot(gap, gap) < least:
                found, kept, least = point, on, dot(gap, gap)
    return found, kept


@inner_kernel
def _nearest_on_all(wanted, on, radius):
    """Closest point to the desired one on the boundaries of one to three balls.

    Two spheres intersect in a circle, three in one point besides the common origin, which is the
    fallback.
    """
    g, first, second = on
    centre, strides = g, wanted
    if dot(first, first) > 0.0:
        size, normal = split(subtract(g, first))
        if size < _ALIKE:
            return ORIGIN
        if dot(second, second) > 0.0:
            size, line = split(cross(normal, subtract(g, second)))
            if size < _ALIKE:
                return ORIGIN
            return scaled(line, 2.0 * radius * dot(line, g))
        centre, strides = combine(0.5, g, 0.5, first), without(wanted, normal)
    _, outward = split(combine(1.0, strides, -radius, centre))
    return scaled(combine(1.0, centre, math.sqrt(dot(centre, centre)), outward), radius)


class _Constants(NamedTuple):
    neighbour_slots: int
    radius: float
    speed_limit: float
    share: float
    bearing_error: float


class LinkKeeping(SafetyFilter):
    """Connectivity-maintenance filter of B environments (theorem R).

        v_i = λ min(d_i, r/(2τ), v_max) sin(φ_i − η)₊ q_i/‖q_i‖ + (1 − λ) P(wanted)

    with φ_i = asin ‖q_i‖ and q_i of lemma 2. P is the projection onto B_i = ∩ ball(ρ g, ρ) over
    all bearings g within η of a visible one, with ρ = r/(4τ). Both terms lie in the convex set B_i.

    Args:
        scenario, num_envs, frame, num_threads: as ``SafetyFilter``.
        share: λ, in [10⁻⁶, 1], weight of the link-keeping law.
        bearing_error: η, rad, maximum bearing error.

    Raises:
        ValueError: with the reason why links cannot be maintained in the scenario.
    """

    state_key = "links"
    reuses_calls = True

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        num_threads: int | None = None,
    ) -> None:
        check_inputs(scenario, "theorem R")
        if reason := asymmetric_sight(scenario):
            raise ValueError(f"scenario: {reason}")
        super().__init__(scenario, num_envs, scenario.action_size, frame, num_threads)
        self._constants = _Constants(
            neighbour_slots=self._robot.neighbour_slots,
            radius=scenario.merge_radius / (4.0 * scenario.tau),
            speed_limit=float(scenario.min_speed_limit),
            share=check_share("share", share),
            bearing_error=check_bearing_error(bearing_error),
        )

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``SafetyFilter.apply_calls``."""
        arrays = observations, self._held, actions, self.alignment, self.lyapunov_rate
        return over_robots(_keep_links, part, self._constants, *arrays)


register_filter("links", LinkKeeping)


def asymmetric_sight(scenario: Scenario) -> str:
    """Reason why visibility is not mutual or a near robot may be invisible; else empty (R)."""
    sensing, graph = scenario.sensing, scenario.sensing_graph
    needs = "theorem R needs mutual visibility of near robots"
    if not graph.undirected and graph.kind != "proximity":
        kind = "switching" if graph.changes else "directed"
        return f"graph is {kind}; {needs}: it must be undirected, or a proximity graph"
    if sensing.custom:
        return f"sensing.custom is {sensing.custom}; {needs}, which is unknown for custom sensors"
    if isinstance(sensing.range, tuple):
        return f"sensing.range is {list(sensing.range)}; {needs}: it must be one for all robots"
    if (view := sensing.smallest("field_of_view")) < 2.0 * math.pi:
        return f"sensing.field_of_view is {view:.6g} rad; {needs}: it must be 2π"
    if (dropout := sensing.largest("dropout")) > 0.0:
        return f"sensing.dropout is {dropout:g}; {needs}: it must be 0"
    if (nearest := sensing.largest("min_range")) > 0.0:
        return f"sensing.min_range is {nearest:g} m; {needs}: it must be 0"
    if sensing.detection:
        return f"sensing.detection is {sensing.detection}; {needs}: it must be empty"
    if sensing.occlusion != "none":
        given = sensing.list_given("occlusion") or sensing.occlusion
        return f"sensing.occlusion is {given!r}; {needs}: it must be 'none'"
    return ""


@kernel
def _keep_links(axes, robots, constants, arrays, work):
    """Velocities (R c and d) from desired ones in units of v_max, and their diagnostics."""
    observations, held, actions, alignment, lyapunov_rate = arrays
    slots, radius, error = constants.neighbour_slots, constants.radius, constants.bearing_error
    for i in range(robots[0], robots[1]):
        rows, velocity = observations[i], ORIGIN
        degree, f = degree_of(rows, slots), net_bearing_of(rows, slots)
        if degree > 0.0:
            sine, towards = split(min_norm_of(rows, slots))
            cosine = math.sqrt(max(1.0 - sine * sine, 0.0))
            sure = max(sine * math.cos(error) - cosine * math.sin(error), 0.0)
            speed = min(degree, 2.0 * radius, constants.speed_limit) * sure
            wanted = scaled(load(held[i]), constants.speed_limit)
            _, within = speed_scale(dot(wanted, wanted), constants.speed_limit)
            free = project_on_links(scaled(wanted, within), rows, slots, radius, error)
            velocity = combine(constants.share * speed, towards, 1.0 - constants.share, free)
        store(velocity, actions[i])
        alignment[i] = alignment_of(velocity, f)
        lyapunov_rate[i] = -2.0 * dot(f, velocity)


@inner_kernel(inline="code")
def alignment_of(velocity, net_bearing):
    """|hᵀf|/‖f‖ of a velocity's direction h, without unit; NaN where either triple is zero."""
    (speed, direction), (strength, towards) = split(velocity), split(net_bearing)
    return abs(dot(direction, towards)) if speed > 0.0 and strength > 0.0 else np.nan
