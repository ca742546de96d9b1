"""Certificates: guarantees of a scenario, their theorems, or the reasons why none applies."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...checks import choice, is_sequence, raise_invalid, to_float
from ...deprecation import renamed_attribute
from ...field_checks import known_arguments
from ...field_docs import lists_fields
from ...field_repr import repr_of_changes
from ...scenario.scenario import Scenario
from ...scenario.scenarios import resolve
from ..gains import gain_range
from ..settings import TANK_MARGIN, bounded_error, check_bearing_error, check_share
from . import delay, descent, gains, links, mean_time, noise, policies, tank, turning
from .theorem import CHOICES, LAW, PROMISED, Asked, Theorem, TheoremBounds, at_least, at_most

THEOREMS: tuple[Theorem, ...] = tuple(
    theorem
    for file in (gains, descent, turning, tank, links, noise, delay, mean_time)
    for theorem in file.THEOREMS
)
"""All theorems in order of precedence; the first that guarantees rendezvous is cited."""
_KEPT = {
    "lyapunov": "V never exceeds {} m²/s{}",
    "hull": "L never exceeds {} m",
    "link_growth": "a link that merges cannot end never grows by more than {} m",
    "expected_time": "the mean time to rendezvous never exceeds {} s",
}


@lists_fields
@dataclass(frozen=True)
class Certificate:
    """Guarantees of a scenario with their theorem or the missing assumption; inf means no bound."""

    min_alignment: float
    """ε, without unit: assumed minimum alignment |hᵀf|/‖f‖; 1 for law (1)."""
    dead_zone: float
    """δ = a*/(2n), m/s: a certified heading need not follow a net bearing f shorter than δ."""
    certified_step: float
    """r/(2D̄), s: longest step for which V provably does not increase between merges."""
    bottleneck_weight: float
    """Bottleneck weight a* of the graph, m/s (theory 3)."""
    time_bound: float
    """Bound on the rendezvous time in discrete time, s, from the given initial condition or from
    any that episodes sample; inf if none is proven."""
    guaranteed: bool
    """True if rendezvous is guaranteed: at the scenario's time step, or in continuous time where
    ``continuous_time_only``."""
    theorem: str
    """Theorem that applies to the scenario, or the missing assumption."""
    by: str = "law"
    """Mechanism of the guarantee: "law", "heading", "tank", "gains" or "links"; "policy" if
    there is none."""
    continuous_time_bound: float = math.inf
    """Bound on the rendezvous time if velocities follow the bearings in continuous time, s."""
    continuous_time_only: bool = False
    """True if the guarantee is proven in continuous time only; ``time_bound`` is then inf."""
    lyapunov_bound: float = math.inf
    """Bound on V at any time, m²/s; with obstacles, for motion without contact."""
    hull_bound: float = math.inf
    """Bound on the perimeter L of the convex hull at any time, m."""
    link_growth_bound: float = math.inf
    """Bound on the growth of a link over its initial length, m; it holds for links that remain
    within sensing range if lengthened by this amount."""
    bearing_error: float = 0.0
    """η, rad: largest bearing error covered by the guarantee. Pass the same value to the
    wrapper."""
    tolerated_bearing_error: float = 0.0
    """Bearing error below which a theorem still guarantees rendezvous in discrete time, rad.
    Rounding reduces it by 2⁻²² rad, more for short steps."""
    expected_time_bound: float = math.inf
    """Bound on the mean rendezvous time of law (1), s, where noise is white or neighbours are
    detected by chance (theorems E[T] and E[L])."""
    scenario: str = "custom"
    """Name of the scenario."""
    time_limit: float = math.inf
    """Time limit of its episodes, s."""
    contact_possible: bool = False
    """True if contact with obstacles is possible; ``lyapunov_bound`` then holds up to the first
    contact."""
    policy: str = ""
    """Name of the certified policy; empty if none was given."""

    __repr__ = repr_of_changes

    @property
    def promises(self) -> dict[str, float]:
        """Every guaranteed discrete-time bound by name.

        "time", s; "lyapunov" (V without contacts), m²/s; "hull" (L), m, at any time; "link_growth",
        m; "expected_time", s.
        """
        found = {name: getattr(self, f"{name}_bound") for name in PROMISED}
        return {name: bound for name, bound in found.items() if math.isfinite(bound)}

    margin = property(lambda self: self.min_alignment, doc="ε: ``min_alignment``.")
    sampled_time_bound = property(lambda self: self.time_bound, doc="``time_bound``, s.")

    held_time_bound = renamed_attribute("held_time_bound", "time_bound")
    bearing_error_borne = renamed_attribute("bearing_error_borne", "tolerated_bearing_error")
    continuous_time = renamed_attribute("continuous_time", "continuous_time_only")
    touches_obstacles = renamed_attribute("touches_obstacles", "contact_possible")

    def __str__(self) -> str:
        """Summary of the guarantee: bounds, and comparison with the time limit of episodes."""
        promises, free = self.promises.items(), " in motion without contact"
        free *= self.contact_possible
        known = [(name, at_most(bound)) for name, bound in promises if name in _KEPT]
        kept = [_KEPT[name].format(bound, free) for name, bound in known]
        hears = self.by in ("heading", "tank", "links")
        if kept and hears and self.bearing_error > 0:
            kept.append(f"these bounds hold with bearing_error={self.bearing_error} in the wrapper")
        if self.tolerated_bearing_error > 0:
            told = ", with that bearing_error in the wrapper" * hears
            error = at_least(self.tolerated_bearing_error, 3)
            kept.append(f"bearings may err by up to {error} rad, minus rounding{told}")
        first = f"{self.scenario} under {self.policy or CHOICES[self.by]}: {self.theorem}"
        numbers = "; ".join(kept) or "There are no other bounds."
        return f"{first}\n{numbers}\n{self._by_when()}"

    def _by_when(self) -> str:
        if not self.guaranteed:
            return "No rendezvous is guaranteed."
        bound, limit, followed = self.time_bound, self.time_limit, self.continuous_time_bound
        if math.isinf(bound):
            known = "without a bound" if math.isinf(followed) else f"bound {at_most(followed)} s"
            return f"Proven in continuous time only, {known}: not with zero-order hold."
        if bound <= limit:
            return f"Bound {at_most(bound)} s, within the limit of {limit:.4g} s."
        return (
            f"Bound {at_most(bound)} s, limit {limit:.4g} s: the guarantee says nothing about "
            "when this episode ends."
        )


@known_arguments
def certificate(
    scenario: Scenario | str | os.PathLike[str],
    min_alignment: float = 1.0,
    *,
    by: str | None = None,
    budget: float = 0.0,
    min_gain: float | Sequence[float] | None = None,
    max_gain: float | Sequence[float] | None = None,
    share: float = LAW.share,
    bearing_error: float = 0.0,
    policy: Any = None,
) -> Certificate:
    """Return the guarantees of a scenario under law (1), under a wrapper, or for a given policy.

        certificate("ring-12")                                      # law (1)
        certificate("ring-12", 0.1)                                 # any policy under a wrapper
        certificate("ring-12", policy=HeadingPolicy("ring-12", f))  # with that policy's settings

    The certificate covers the scenario's own graph and obstacles. It covers the given initial
    condition, or those that episodes sample: in the spawn area, with linked robots at least 2r
    apart. On a proximity graph with ``require_connected`` they are connected.

    Initial conditions, weights or obstacles passed to ``reset(options=…)`` are not covered. Certify
    ``scenario.replace(start_positions=…, graph=…, obstacles=…)`` instead. For weights and
    obstacles, also create the environment from that scenario: steps, gains and tank levels depend
    on it. Each bound is the best that any theorem gives. Pass the same arguments to the wrapper as
    to ``certificate``.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        min_alignment: ε, a number without unit. 1 for the paper's laws, gains and links; in [10⁻⁶,
            1) for certified headings and tanks. For a tank, 1 is replaced by the default of 0.05.
        by: "law", "heading", "tank", "gains" or "links"; None is "law" if ``min_alignment`` is 1,
            else "heading".
        budget: initial stored energy B_i of each robot's tank, m²/s.
        min_gain: lower bound on the sum of a robot's gains, m/s, or a list with one for each
            robot; None is a*.
        max_gain: upper bound on the sum of a robot's gains, m/s, likewise; None is D̄.
        share: λ in [10⁻⁶, 1], velocity share of the connectivity-maintaining law.
        bearing_error: bound on the bearing error, rad; η is the maximum of it and the bounded
            errors of the scenario's sensor.
        policy: a policy or any function of observations and time, in place of all other arguments.
            Its attribute ``guarantee``, a mapping of these arguments, describes its filter. Without
            the attribute there is no guarantee; ``theorem`` then lists wrappers that provide one
            for any policy, and the command that searches for counterexamples.

    Returns:
        A Certificate; its fields document their units.

    Raises:
        TypeError: if ``policy`` is not callable.
        ValueError: for an argument out of range or incompatible with ``by`` or ``policy``.
    """
    scenario = resolve(scenario)
    given: dict[str, Any] = {"min_alignment": min_alignment, "budget": budget, "share": share}
    for name, limit in (("min_gain", min_gain), ("max_gain", max_gain)):
        given[name] = tuple(limit) if is_sequence(limit) else limit  # type: ignore[arg-type]
    if policy is None:
        return answer(scenario, question(scenario, by, given, bearing_error))[0]
    for name, value in (given | {"by": by, "bearing_error": bearing_error}).items():
        if value != (usual := getattr(LAW, name) if name in given else _UNASKED[name]):
            raise_invalid(name, value, f"{usual} with a policy, which has its own settings")
    return of_policy(scenario, policy)


_UNASKED = {"by": None, "bearing_error": 0.0}


def of_policy(scenario: Scenario, policy: object) -> Certificate:
    """Return the certificate of a policy's ``guarantee``, or one without guarantees."""
    guarantee = policies.guarantee_of(scenario, policy)
    lacks = "" if guarantee is None else policies.unmet(scenario, guarantee)
    if guarantee is not None and not lacks:
        given = {name: value for name, value in guarantee.items() if name in Asked._fields}
        by, error = given.pop("by", None), guarantee.get("bearing_error", 0.0)
        found, _ = answer(scenario, question(scenario, by, given, error))
        return replace(found, policy=policies.name_of(policy))
    nothing = Asked(by="policy", error=bounded_error(scenario.sensing, scenario.dim))
    words = lacks or policies.no_guarantee(policy, partial(_time_bound, scenario))
    return _certificate(scenario, nothing, words, [], policies.name_of(policy))


def _time_bound(scenario: Scenario, by: str) -> float | None:
    """Guaranteed rendezvous time under a filter with default settings, s, or None."""
    margin = {"min_alignment": 0.1 if by == "heading" else LAW.min_alignment}
    try:
        found, _ = answer(scenario, question(scenario, by, margin, 0.0))
    except ValueError:  # no settings are valid for this filter
        return None
    return found.time_bound if found.guaranteed else None


def question(scenario: Scenario, by: Any, given: Mapping[str, Any], bearing_error: Any) -> Asked:
    """Query from consistent arguments of ``certificate`` (theorem A: LAW), with η a number, rad."""
    margin = check_share("min_alignment", given.get("min_alignment", LAW.min_alignment))
    by = choice("by", ("law" if margin == 1 else "heading") if by is None else by, CHOICES)
    if by in ("law", "gains", "links") and margin != 1:
        raise_invalid("min_alignment", margin, f'exactly 1 with by="{by}"')
    if by == "tank" and margin == 1:
        margin = TANK_MARGIN  # 1 is invalid for a tank
    if by == "heading" and margin == 1:
        raise_invalid("min_alignment", margin, 'less than 1 with by="heading"')
    asked = LAW._replace(by=by, **given)
    if not 0 <= (budget := to_float(asked.budget)) < math.inf:
        raise_invalid("budget", asked.budget, "finite and at least 0 m²/s")
    share, own = check_share("share", asked.share), bounded_error(scenario.sensing, scenario.dim)
    error = max(check_bearing_error(bearing_error), own)
    asked = asked._replace(min_alignment=margin, budget=budget, share=share, error=error)
    if by != "tank" and budget != 0:
        raise_invalid("budget", asked.budget, f'0 with by="{by}": only a tank has one')
    for name, only in (("min_gain", "gains"), ("max_gain", "gains"), ("share", "links")):
        value, usual = getattr(asked, name), getattr(LAW, name)
        if by != only and value != usual:
            raise_invalid(name, value, f'{usual} with by="{by}": only {only} have one')
    if by == "gains":
        gain_range(scenario, asked.min_gain, asked.max_gain)
    return asked


def answer(
    scenario: Scenario, asked: Asked
) -> tuple[Certificate, list[tuple[Theorem, TheoremBounds]]]:
    """Return the best of all bounds, the theorem text, and all theorems that apply.

    The text is that of the first theorem that guarantees rendezvous, or the missing assumption of
    the closest one. If several apply, the one with the largest admissible bearing error is cited.
    """
    applies, nearest, words = [], (-3.0, 0.0), ""
    for theorem in THEOREMS:
        if asked.by not in theorem.by:
            continue
        met, lacks = theorem.unmet(scenario, asked)
        came = float(met), 0.0
        if not lacks:
            bounds = theorem.bounds(scenario, asked)
            applies.append((theorem, bounds))
            came, lacks = (math.inf, bounds.tolerated_bearing_error), bounds.words
            lacks *= not bounds.meets
        if lacks and theorem.rendezvous and came > nearest:
            nearest, words = came, lacks
    return _certificate(scenario, asked, words, [bounds for _, bounds in applies]), applies


def _certificate(
    scenario: Scenario, asked: Asked, lacks: str, found: list[TheoremBounds], policy: str = ""
) -> Certificate:
    """Certificate with the best applicable bounds, or with the missing assumption."""
    promised = [bounds.words for bounds in found if bounds.meets]
    least = {
        name: min((getattr(bounds, name) for bounds in found), default=math.inf)
        for name in (*PROMISED, "continuous_time")
    }
    return Certificate(
        min_alignment=asked.min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        guaranteed=bool(promised),
        theorem=promised[0] if promised else lacks,
        by=asked.by,
        continuous_time_only=bool(promised) and math.isinf(least["time"]),
        bearing_error=asked.error,
        tolerated_bearing_error=max((one.tolerated_bearing_error for one in found), default=0.0),
        scenario=scenario.name,
        time_limit=scenario.time_limit,
        contact_possible=bool(scenario.obstacles) and scenario.obstacle_contact != "ignore",
        policy=policy,
        **{f"{name}_bound": bound for name, bound in least.items()},
    )
