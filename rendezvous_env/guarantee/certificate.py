"""What is guaranteed for a scenario, by which theorem, or why nothing is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..experiment.scenario import Scenario
from .bounds import check_scenario, connected, time_bound
from .lyapunov import lyapunov


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
    """Time in s by which all robots have met from any start in the spawn area; inf without a
    bound."""
    guaranteed: bool
    """Whether rendezvous is guaranteed."""
    theorem: str
    """Which theorem covers the scenario, or why none does."""


def certificate(scenario: Scenario, min_alignment: float = 1.0) -> Certificate:
    """What is guaranteed for a scenario under law (1), or under certified headings.

    Args:
        scenario: the experiment.
        min_alignment: 1 for the paper's own laws, ε in (0, 1) for certified headings of that
            margin.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1].
    """
    check_scenario(scenario)
    bound = float(time_bound(scenario, _largest_lyapunov(scenario), min_alignment=min_alignment))
    guaranteed, theorem = _which_theorem(scenario, min_alignment)
    return Certificate(
        margin=min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        time_bound=bound if guaranteed else math.inf,
        guaranteed=guaranteed,
        theorem=theorem,
    )


def _which_theorem(scenario: Scenario, min_alignment: float) -> tuple[bool, str]:
    long_step = scenario.tau > scenario.certified_step * (1 + 1e-12)
    if not connected(scenario):
        return (
            False,
            "none: the graph is not connected, one robot per component remains (theorem 1)",
        )
    model = scenario.model
    if not model.bounded and model.theorem is None:
        return False, (
            f"none: no theorem covers {model.name} robots, whose action ({model.action}) is not "
            "their velocity; V may rise at any time"
        )
    if scenario.obstacles and scenario.obstacle_contact != "ignore":
        return False, (
            "none: obstacles can hold a robot back for ever (theory 6); with certified headings "
            "V still never rises between merges in a step without a contact"
        )
    if not model.bounded:
        return (
            True,
            f"{model.theorem} in continuous time (for free turn rates: the gate); no time bound",
        )
    if long_step and min_alignment == 1:
        return False, (
            f"none for law (1) as it stands: the step {scenario.tau:.4g} s is longer than the "
            f"certified {scenario.certified_step:.4g} s; certified headings scale the velocity "
            "and are covered"
        )
    if min_alignment == 1:
        return True, "theorems 1 and A: law (1) meets in finite time"
    scaled = " with velocities scaled to the long step" if long_step else ""
    return (
        True,
        f"theorems 2 and C: every policy under certified headings meets in finite time{scaled}",
    )


def _largest_lyapunov(scenario: Scenario) -> float:
    """V(0) of the given start, or an upper bound over all starts that can be drawn."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    if scenario.start_positions is not None:
        weights = graph.base_weights(n) * graph.weight_range[1]
        return float(lyapunov(np.array(scenario.start_positions), weights))
    return 2.0 * graph.weight_sum(n) * scenario.spawn_size * math.sqrt(scenario.dim)
