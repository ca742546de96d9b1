"""What theorems A, C and D promise of V, and N1 of wrong bearings; G of law (1)."""

from __future__ import annotations

import math
from dataclasses import replace

from ..experiment.scenario import Scenario
from . import error_bounds, even_bounds
from .bounds import lyapunov_bound, tank_lyapunov_bound, tank_time_bound, time_bound, walled
from .kinds_of_links import UNDIRECTED, kind_of_links
from .promise import Asked, Certificate
from .promises_on_hull import of_law_on_any_graph
from .size_bounds import size_bound
from .worst_starts import largest_lyapunov, largest_size


def of_law(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Law (1), or of nonholonomic robots the paper's own."""
    if kind_of_links(scenario.sensing_graph) != UNDIRECTED or scenario.sensing.occlusion != "none":
        return of_law_on_any_graph(scenario, without, asked)
    found = _with_lyapunov_bound(scenario, without)
    long_step, scaled = _long_step(scenario), scenario.scales_velocity
    if walled(scenario):
        rises = (long_step and not scaled) or not scenario.model.bounded or asked.error > 0
        return _walled(found, math.inf if rises else found.lyapunov_bound)
    if not scenario.model.bounded:
        return _of_bodies(scenario, found, asked)
    if long_step and not scaled:
        words = (
            f"none for law (1) as it stands: the step {scenario.tau:.4g} s is longer than the "
            f"certified {scenario.certified_step:.4g} s; certified headings scale the velocity "
            "and are covered"
        )
        return replace(found, theorem=words, lyapunov_bound=math.inf)
    if asked.error > 0:
        return _of_law_with_errors(scenario, found, asked.error)
    return _of_scaled_law(scenario, found) if long_step else _of_exact_law(scenario, found)


def _of_exact_law(scenario: Scenario, without: Certificate) -> Certificate:
    """Theorem G's bound, which is never above A's (V(0) ≥ a* L0 in the plane, 4 a* w0 in space),
    and what is proven for held inputs.
    """
    start, extent = largest_lyapunov(scenario), largest_size(scenario)
    held = float(time_bound(scenario, start, initial_size=extent))
    words = (
        "theorems 1 and G: law (1) meets in finite time; this bound is proven in continuous time, "
        f"for inputs held over the step it is {held:.4g} s"
    )
    return replace(
        without,
        guaranteed=True,
        theorem=words,
        time_bound=float(size_bound(scenario, extent)),
        continuous_time=True,
        held_time_bound=held,
        bearing_error_borne=_law_bears(scenario),
    )


def _of_scaled_law(scenario: Scenario, without: Certificate) -> Certificate:
    """Law (1) in a large sparse graph: theorem A, for velocities scaled to the step (theory 4)."""
    bound = float(time_bound(scenario, largest_lyapunov(scenario)))
    words = (
        "theorem 1: law (1) meets in finite time, with velocities scaled by r/(2 D_i τ) where that "
        "is below 1, as the policy bearing-only does here (theory 4)"
    )
    return replace(without, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def _law_bears(scenario: Scenario) -> float:
    """By N1 on any graph, by N too where all degrees are equal at any time."""
    borne = 0.0
    if scenario.speed_limit >= scenario.max_degree:
        borne = error_bounds.law_error_borne(scenario)
    if even_bounds.evenly_moved(scenario):
        borne = max(borne, even_bounds.even_error_borne(scenario))
    return borne


def _of_law_with_errors(scenario: Scenario, without: Certificate, error: float) -> Certificate:
    """Theorems N and N1."""
    start, extent = largest_lyapunov(scenario), largest_size(scenario)
    found = replace(without, lyapunov_bound=math.inf, bearing_error_borne=_law_bears(scenario))
    bounds = {"N1": math.inf, "N": math.inf}
    if not _long_step(scenario):
        bounds["N1"] = float(error_bounds.law_time_bound(scenario, start, error))
    if even_bounds.evenly_moved(scenario):
        bounds["N"] = float(even_bounds.even_time_bound(scenario, extent, error))
    by = min(bounds, key=lambda name: bounds[name])
    if math.isinf(bounds[by]):
        return replace(found, theorem=_too_wrong(error, found.bearing_error_borne, "law (1)"))
    words = f"theorem {by}: law (1) meets in finite time although bearings err by {error:.4g} rad"
    return replace(
        found, guaranteed=True, theorem=words, time_bound=bounds[by], held_time_bound=bounds[by]
    )


def _too_wrong(error: float, borne: float, what: str) -> str:
    return (
        f"none: bearings may err by {error:.4g} rad, and {what} is known to bear less than "
        f"{borne:.4g} rad here (guarantees 11)"
    )


def of_headings(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Theorem C for any policy under certified headings, N1' where bearings are wrong."""
    found = _with_lyapunov_bound(scenario, without)
    if walled(scenario):
        return _walled(found, found.lyapunov_bound)
    if not scenario.model.bounded:
        return _of_bodies(scenario, found, asked)
    start, margin = largest_lyapunov(scenario), without.margin
    found = replace(found, bearing_error_borne=error_bounds.heading_error_borne(scenario, margin))
    scaled = " with velocities scaled to the long step" if _long_step(scenario) else ""
    words = f"theorems 2 and C: every policy under certified headings meets in finite time{scaled}"
    bound = float(time_bound(scenario, start, min_alignment=margin))
    if asked.error > 0:
        words = (
            "theorem N1': every policy under certified headings that allow for errors of "
            f"{asked.error:.4g} rad meets in finite time{scaled}"
        )
        bound = float(error_bounds.heading_time_bound(scenario, start, asked.error, margin))
    if math.isinf(bound) and asked.error > 0:
        words = _too_wrong(asked.error, found.bearing_error_borne, "a heading of this margin")
        return replace(found, theorem=f"{words}; V still never rises between merges")
    return replace(found, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def of_tank(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Theorem D: any motion at all, while the ledger lasts."""
    start = largest_lyapunov(scenario)
    most = float(tank_lyapunov_bound(scenario, start, budget=asked.budget))
    found = replace(without, lyapunov_bound=most)
    stays = f"theorem D still keeps V at or below {most:.4g} m²/s"
    if walled(scenario):
        words = (
            f"none: obstacles can hold a robot back for ever (theory 6); {stays} in motion "
            "without a contact, but no time is proven"
        )
        return replace(found, theorem=words)
    if not scenario.model.bounded:
        words = (
            f"none: no time by which {scenario.model.name} robots meet under a tank is proven; "
            f"{stays}"
        )
        return replace(found, theorem=words)
    margin = without.margin
    borne = error_bounds.tank_error_borne(scenario, margin)
    found = replace(found, bearing_error_borne=borne)
    bound = float(
        tank_time_bound(
            scenario,
            start,
            min_alignment=margin,
            budget=asked.budget,
            bearing_error=asked.error,
        )
    )
    words = "theorem D: whatever is wanted, all robots meet in finite time while a tank keeps count"
    if asked.error > 0:
        words += f" and charges errors of {asked.error:.4g} rad"
    if math.isinf(bound) and asked.error > 0:
        return replace(
            found, theorem=f"{_too_wrong(asked.error, borne, 'a tank of this margin')}; {stays}"
        )
    return replace(found, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def _of_bodies(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Theorems 3 and 4, for the paper's laws or gated turn rates."""
    if asked.error > 0:
        stays = "; V still never rises between merges" * (without.by == "heading")
        words = f"none: theorems 3 and 4 are for exact bearings{stays}"
        most = without.lyapunov_bound if stays else math.inf
        return replace(without, theorem=words, lyapunov_bound=most)
    own = scenario.model.theorem
    words = f"{own} in continuous time (for free turn rates: the gate); no time bound"
    return replace(without, guaranteed=True, theorem=words, continuous_time=True)


def _with_lyapunov_bound(scenario: Scenario, without: Certificate) -> Certificate:
    most = float(lyapunov_bound(scenario, largest_lyapunov(scenario)))
    return replace(without, lyapunov_bound=most)


def _long_step(scenario: Scenario) -> bool:
    return scenario.tau > scenario.certified_step * (1 + 1e-12)


def _walled(without: Certificate, most: float) -> Certificate:
    words = (
        "none: obstacles can hold a robot back for ever (theory 6); with certified headings V "
        "still never rises between merges in a step without a contact"
    )
    return replace(without, theorem=words, lyapunov_bound=most)
