"""What is guaranteed for a scenario, by which theorem, or why nothing is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..experiment.checks import choice, real, refuse
from ..experiment.scenario import Scenario
from . import error_bounds
from .bearing_errors import bounded_error, check_bearing_error
from .bounds import check_margin, check_scenario, covered
from .gains import gain_range
from .hindrances import hindrance
from .links import check_share
from .promise import CHOICES as CHOICES
from .promise import Asked
from .promise import Certificate as Certificate
from .promises_on_hull import of_gains, of_links
from .promises_on_v import of_headings, of_law, of_tank
from .worst_starts import largest_lyapunov

_PROMISES: dict[str, Callable[[Scenario, Certificate, Asked], Certificate]] = {
    "law": of_law,
    "heading": of_headings,
    "tank": of_tank,
    "gains": of_gains,
    "links": of_links,
}
_DEFAULT_SHARE = 0.5


def certificate(
    scenario: Scenario,
    min_alignment: float = 1.0,
    *,
    by: str | None = None,
    budget: float = 0.0,
    min_gain: float | None = None,
    max_gain: float | None = None,
    share: float = _DEFAULT_SHARE,
    bearing_error: float = 0.0,
) -> Certificate:
    """What is guaranteed for a scenario under law (1), or whatever a policy does under a wrapper.

    For the scenario's own graph, and starts in its spawn area; by theorems 1 to 4, A, C, D, G, N
    and R. Bounded errors of the scenario's sensor count: η is the larger of them and of
    ``bearing_error``. The wrapper is to be given the same numbers.

    Args:
        scenario: the experiment.
        min_alignment: a number without unit: 1 for the paper's own laws, gains and links, ε in
            (0, 1) for certified headings of that margin, ε in (0, 1] for a tank.
        by: "law", "heading", "tank", "gains" or "links"; None is "law" if ``min_alignment`` is 1,
            else "heading".
        budget: B_i that each robot's tank begins with, m²/s.
        min_gain: the least that a robot's gains add up to, m/s; None is a*.
        max_gain: the most, m/s; None is D̄.
        share: λ in (0, 1], how much of a velocity is the link-keeping law's.
        bearing_error: η, rad, by how much bearings may be wrong.

    Returns:
        A Certificate, each of whose fields says its unit.

    Raises:
        ValueError: naming the argument that is out of its range, or does not go with ``by``.
    """
    check_scenario(scenario)
    error = max(check_bearing_error(bearing_error), bounded_error(scenario.sensing, scenario.dim))
    chosen = _checked(min_alignment, by, budget)
    check_share(share)
    _check_goes_with(chosen, min_gain=min_gain, max_gain=max_gain, share=share)
    if chosen == "gains":
        gain_range(scenario, min_gain, max_gain)
    without = Certificate(
        margin=min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        time_bound=math.inf,
        guaranteed=False,
        theorem="",
        by=chosen,
        bearing_error=error,
    )
    if words := hindrance(scenario, chosen):
        return replace(
            without, theorem=words, expected_time_bound=_expected_time(scenario, without)
        )
    return _PROMISES[chosen](
        scenario, without, Asked(chosen, real(budget), min_gain, max_gain, real(share), error)
    )


def _checked(min_alignment: float, by: Any, budget: float) -> str:
    """What keeps the guarantee, if the arguments go together."""
    check_margin(min_alignment)
    if by is None:
        by = "law" if min_alignment == 1 else "heading"
    choice("by", by, CHOICES)
    if by in ("law", "gains", "links") and min_alignment != 1:
        refuse("min_alignment", min_alignment, f'exactly 1 with by="{by}"')
    if by == "heading" and min_alignment == 1:
        refuse("min_alignment", min_alignment, 'less than 1 with by="heading"')
    if by != "tank" and real(budget) != 0:
        refuse("budget", budget, f'0 with by="{by}": only a tank has one')
    return str(by)


def _check_goes_with(
    by: str, *, min_gain: float | None, max_gain: float | None, share: float
) -> None:
    """Refuse numbers of another wrapper."""
    for name, value in (("min_gain", min_gain), ("max_gain", max_gain)):
        if by != "gains" and value is not None:
            refuse(name, value, f'None with by="{by}": only gains have one')
    if by != "links" and share != _DEFAULT_SHARE:
        refuse("share", share, f'{_DEFAULT_SHARE} with by="{by}": only links have one')


def _expected_time(scenario: Scenario, without: Certificate) -> float:
    """E[T] of law (1) if independent noise is all that a sensor gets wrong, s; else inf."""
    noise = scenario.sensing.noise
    if without.by != "law" or not noise or scenario.sensing != type(scenario.sensing)(noise=noise):
        return math.inf
    if without.bearing_error or not covered(scenario):
        return math.inf
    return error_bounds.expected_time_bound(scenario, largest_lyapunov(scenario))
