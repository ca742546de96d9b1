"""What is guaranteed for a scenario, by which theorem, or why nothing is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ..experiment.checks import choice, real, refuse
from ..experiment.scenario import Scenario
from .bounds import (
    check_margin,
    check_scenario,
    connected,
    lyapunov_bound,
    tank_lyapunov_bound,
    tank_time_bound,
    time_bound,
)
from .size_bounds import size_bound
from .worst_starts import largest_lyapunov, largest_size

CHOICES = ("law", "heading", "tank")
"""What keeps the guarantee: law (1) itself, certified headings, or an energy tank."""


@dataclass(frozen=True)
class Certificate:
    """What is guaranteed for a scenario, and why or why not."""

    margin: float
    """ε: the least alignment |hᵀf|/‖f‖ that the guarantee builds on; 1 for law (1)."""
    dead_zone: float
    """δ = a*/(2n), m/s."""
    certified_step: float
    """r/(2D̄), s."""
    bottleneck_weight: float
    """a*, m/s."""
    time_bound: float
    """Time in s by which all robots have met from any start in the spawn area, or from the given
    start; inf without a bound."""
    guaranteed: bool
    """Whether rendezvous is guaranteed."""
    theorem: str
    """Which theorem covers the scenario, or why none does."""
    by: str = "law"
    """What keeps the guarantee, one of CHOICES."""
    continuous_time: bool = False
    """Whether ``time_bound``, or the guarantee if there is no bound, is proven for velocities that
    follow the bearings in continuous time only."""
    held_time_bound: float = math.inf
    """Time in s by which all robots have met with inputs held over the scenario's step; inf without
    a bound."""
    lyapunov_bound: float = math.inf
    """What V never exceeds, m²/s, with obstacles in motion without a contact; inf without a
    bound."""


def certificate(
    scenario: Scenario,
    min_alignment: float = 1.0,
    *,
    by: str | None = None,
    budget: float = 0.0,
) -> Certificate:
    """What is guaranteed for a scenario under law (1), certified headings or an energy tank.

    For the scenario's own graph, and starts in its spawn area; by theorems 1, 2, A, C, D, G and N.

    Args:
        scenario: the experiment.
        min_alignment: a number without unit: 1 for the paper's own laws, ε in (0, 1) for certified
            headings of that margin, ε in (0, 1] for a tank.
        by: "law", "heading" or "tank"; None is "law" if ``min_alignment`` is 1, else "heading".
        budget: B_i that each robot's tank begins with, m²/s.

    Returns:
        A Certificate, each of whose fields says its unit.

    Raises:
        ValueError: naming the argument that is out of its range, or does not go with ``by``.
    """
    check_scenario(scenario)
    chosen = _checked(min_alignment, by, budget)
    without = Certificate(
        margin=min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        time_bound=math.inf,
        guaranteed=False,
        theorem="",
        by=chosen,
    )
    if hindrance := _hindrance(scenario):
        return replace(without, theorem=hindrance)
    if chosen == "tank":
        return _of_tank(scenario, without, budget)
    most = float(lyapunov_bound(scenario, largest_lyapunov(scenario)))
    return _of_law_4(scenario, replace(without, lyapunov_bound=most))


def _checked(min_alignment: float, by: Any, budget: float) -> str:
    """What keeps the guarantee, if the arguments go together."""
    check_margin(min_alignment)
    if by is None:
        by = "law" if min_alignment == 1 else "heading"
    choice("by", by, CHOICES)
    if by == "law" and min_alignment != 1:
        refuse("min_alignment", min_alignment, 'exactly 1 with by="law"')
    if by == "heading" and min_alignment == 1:
        refuse("min_alignment", min_alignment, 'less than 1 with by="heading"')
    if by != "tank" and real(budget) != 0:
        refuse("budget", budget, f'0 with by="{by}": only a tank has one')
    return str(by)


def _hindrance(scenario: Scenario) -> str:
    """Why no theorem says anything of such robots; empty if one does."""
    if not connected(scenario):
        return "none: the graph is not connected, one robot per component remains (theorem 1)"
    model = scenario.model
    if not model.bounded and model.theorem is None:
        return (
            f"none: no theorem covers {model.name} robots, whose action ({model.action}) is not "
            "their velocity; V may rise at any time"
        )
    return ""


def _walled(scenario: Scenario) -> bool:
    return bool(scenario.obstacles) and scenario.obstacle_contact != "ignore"


def _of_law_4(scenario: Scenario, without: Certificate) -> Certificate:
    """Law (1), or any policy under certified headings."""
    by_law = without.by == "law"
    long_step = scenario.tau > scenario.certified_step * (1 + 1e-12)
    if _walled(scenario):
        words = (
            "none: obstacles can hold a robot back for ever (theory 6); with certified headings "
            "V still never rises between merges in a step without a contact"
        )
        unscaled = long_step and not scenario.scales_velocity
        rises = by_law and (unscaled or not scenario.model.bounded)
        most = math.inf if rises else without.lyapunov_bound
        return replace(without, theorem=words, lyapunov_bound=most)
    if not scenario.model.bounded:
        words = (
            f"{scenario.model.theorem} in continuous time (for free turn rates: the gate); no time "
            "bound"
        )
        return replace(without, guaranteed=True, theorem=words, continuous_time=True)
    if long_step and by_law and scenario.scales_velocity:
        return _of_scaled_law_1(scenario, without)
    if long_step and by_law:
        words = (
            f"none for law (1) as it stands: the step {scenario.tau:.4g} s is longer than the "
            f"certified {scenario.certified_step:.4g} s; certified headings scale the velocity "
            "and are covered"
        )
        return replace(without, theorem=words, lyapunov_bound=math.inf)
    return _of_law_1(scenario, without) if by_law else _of_headings(scenario, without, long_step)


def _of_law_1(scenario: Scenario, without: Certificate) -> Certificate:
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
    )


def _of_scaled_law_1(scenario: Scenario, without: Certificate) -> Certificate:
    """Law (1) in a large sparse graph: theorem A, for velocities scaled to the step (theory 4)."""
    bound = float(time_bound(scenario, largest_lyapunov(scenario)))
    words = (
        "theorem 1: law (1) meets in finite time, with velocities scaled by r/(2 D_i τ) where that "
        "is below 1, as the policy bearing-only does here (theory 4)"
    )
    return replace(without, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def _of_headings(scenario: Scenario, without: Certificate, long_step: bool) -> Certificate:
    bound = float(time_bound(scenario, largest_lyapunov(scenario), min_alignment=without.margin))
    scaled = " with velocities scaled to the long step" if long_step else ""
    words = f"theorems 2 and C: every policy under certified headings meets in finite time{scaled}"
    return replace(without, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def _of_tank(scenario: Scenario, without: Certificate, budget: float) -> Certificate:
    """Theorem D: any motion at all, while the ledger lasts."""
    start = largest_lyapunov(scenario)
    most = float(tank_lyapunov_bound(scenario, start, budget=budget))
    found = replace(without, lyapunov_bound=most)
    stays = f"theorem D still keeps V at or below {most:.4g} m²/s"
    if _walled(scenario):
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
    bound = float(tank_time_bound(scenario, start, min_alignment=without.margin, budget=budget))
    words = "theorem D: whatever is wanted, all robots meet in finite time while a tank keeps count"
    return replace(found, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)
