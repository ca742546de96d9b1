"""What is guaranteed for a scenario, by which theorem, or why nothing is."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...checks import choice, raise_invalid, to_float
from ...field_docs import lists_fields
from ...scenario.scenario import Scenario
from ...scenario.scenarios import resolve
from ..gains import gain_range
from ..settings import TANK_MARGIN, bounded_error, check_bearing_error, check_share
from . import delay, descent, gains, links, noise, policies, tank, turning
from .theorem import CHOICES, LAW, PROMISED, Asked, Bounds, Theorem, at_least, at_most

THEOREMS: tuple[Theorem, ...] = tuple(
    theorem
    for file in (gains, descent, turning, tank, links, noise, delay)
    for theorem in file.THEOREMS
)
"""All that certificates ask, in turn; the first that promises a rendezvous gives the words."""
_KEPT = {
    "lyapunov": "V never exceeds {} m²/s{}",
    "hull": "L never exceeds {} m",
    "link_growth": "a link that merges cannot end never grows by more than {} m",
    "expected_time": "the mean time to rendezvous never exceeds {} s",
}


def _renamed(old: str, new: str) -> Any:
    def read(found: Certificate) -> Any:
        warnings.warn(f"Certificate.{old} is called {new} now", DeprecationWarning, stacklevel=2)
        return getattr(found, new)

    return property(read, doc=f"Deprecated: ``{new}``.")


@lists_fields
@dataclass(frozen=True)
class Certificate:
    """What is guaranteed for a scenario, and why or why not; a bound is infinite where none is."""

    min_alignment: float
    """ε, without unit: least alignment |hᵀf|/‖f‖ that the guarantee assumes; 1 for law (1)."""
    dead_zone: float
    """δ = a*/(2n), m/s: below it a certified heading need not follow the net bearing f."""
    certified_step: float
    """r/(2D̄), s: longest step for which V is proven not to rise between merges."""
    bottleneck_weight: float
    """a*, m/s: bottleneck weight of the graph (theory 3)."""
    time_bound: float
    """Bound on the time to rendezvous in the environment as it steps, s, from the start that the
    scenario gives or any that its episodes draw."""
    guaranteed: bool
    """Whether rendezvous is guaranteed."""
    theorem: str
    """Theorem that covers the scenario, or why none does."""
    by: str = "law"
    """What keeps the guarantee: "law", "heading", "tank", "gains", "links"; "policy" where nothing
    does."""
    continuous_time_bound: float = math.inf
    """``time_bound`` for velocities that follow the bearings in continuous time."""
    continuous_time_only: bool = False
    """Whether the guarantee is proven in continuous time only, so that ``time_bound`` is inf."""
    lyapunov_bound: float = math.inf
    """Bound on V at any time, m²/s; among obstacles, in motion without a contact."""
    hull_bound: float = math.inf
    """Bound on the perimeter L of the convex hull at any time, m."""
    link_growth_bound: float = math.inf
    """Bound on how much longer a link ever is than at the start, m; for links that would be within
    the sensing range if they were longer by this."""
    bearing_error: float = 0.0
    """η, rad: largest bearing error that the guarantee allows for. Give it to the wrapper too."""
    tolerated_bearing_error: float = 0.0
    """Bearing error below which a theorem still guarantees a rendezvous, inputs held, rad; rounding
    takes 2⁻²² rad of it, more in short steps."""
    expected_time_bound: float = math.inf
    """Bound on the mean time to rendezvous under noise that is drawn anew in every step, s."""
    scenario: str = "custom"
    """Name of the scenario."""
    time_limit: float = math.inf
    """Time limit of its episodes, s."""
    touches_obstacles: bool = False
    """Whether robots may touch obstacles; ``lyapunov_bound`` then holds up to the first contact."""
    policy: str = ""
    """Name of the policy that was asked about; empty if none was given."""

    @property
    def promises(self) -> dict[str, float]:
        """Every number that is promised of the environment as it steps, by what it bounds: time, s;
        V ("lyapunov"), m²/s, but for contacts, and L ("hull"), m, at any time; "link_growth", m;
        "expected_time", s.
        """
        found = {name: getattr(self, f"{name}_bound") for name in PROMISED}
        return {name: bound for name, bound in found.items() if math.isfinite(bound)}

    margin = property(lambda self: self.min_alignment, doc="ε: ``min_alignment``.")
    sampled_time_bound = property(lambda self: self.time_bound, doc="``time_bound``, s.")

    held_time_bound = _renamed("held_time_bound", "time_bound")
    bearing_error_borne = _renamed("bearing_error_borne", "tolerated_bearing_error")
    continuous_time = _renamed("continuous_time", "continuous_time_only")

    def __str__(self) -> str:
        """What is promised, by when, and how that compares with the episode's limit."""
        promises, free = self.promises.items(), " in motion without a contact"
        free *= self.touches_obstacles
        known = [(name, at_most(bound)) for name, bound in promises if name in _KEPT]
        kept = [_KEPT[name].format(bound, free) for name, bound in known]
        hears = self.by in ("heading", "tank", "links")
        if kept and hears and self.bearing_error > 0:
            kept.append(f"all of this if the wrapper is told bearing_error={self.bearing_error}")
        if self.tolerated_bearing_error > 0:
            told = " if the wrapper is told so" * hears
            error = at_least(self.tolerated_bearing_error, 3)
            kept.append(f"bearings may err by up to {error} rad{told}, less what rounding takes")
        first = f"{self.scenario} under {self.policy or CHOICES[self.by]}: {self.theorem}"
        numbers = "; ".join(kept) or "No other number is promised."
        return f"{first}\n{numbers}\n{self._by_when()}"

    def _by_when(self) -> str:
        if not self.guaranteed:
            return "No rendezvous is guaranteed."
        bound, limit, followed = self.time_bound, self.time_limit, self.continuous_time_bound
        if math.isinf(bound):
            known = "without a bound" if math.isinf(followed) else f"bound {at_most(followed)} s"
            return f"Proven in continuous time only, {known}: of held inputs nothing is said."
        if bound <= limit:
            return f"Bound {at_most(bound)} s, within the limit of {limit:.4g} s."
        return (
            f"Bound {at_most(bound)} s, limit {limit:.4g} s: the guarantee says nothing about "
            "when this episode ends."
        )


def certificate(
    scenario: Scenario | str | os.PathLike[str],
    min_alignment: float = 1.0,
    *,
    by: str | None = None,
    budget: float = 0.0,
    min_gain: float | None = None,
    max_gain: float | None = None,
    share: float = LAW.share,
    bearing_error: float = 0.0,
    policy: Any = None,
) -> Certificate:
    """What is guaranteed for a scenario under law (1), or whatever a policy does under a wrapper,
    or of a given policy.

        certificate("ring-12")                                      # law (1)
        certificate("ring-12", 0.1)                                 # any policy under a wrapper
        certificate("ring-12", policy=HeadingPolicy("ring-12", f))  # with that policy's settings

    For the scenario's own graph and obstacles, and the start that it gives or those that episodes
    draw: in its spawn area, linked robots 2r or more apart, connected on a proximity graph where
    ``require_connected``. Of other starts, weights or obstacles, as ``reset(options=…)`` takes
    them, nothing is said: ask for ``scenario.replace(start_positions=…, graph=…, obstacles=…)``.
    Of other weights or obstacles that is true of an environment made of that scenario: steps, gains
    and levels of tanks follow from a scenario's own. Each number is the best that one of the
    theorems gives; the wrapper is to be given the same numbers as ``certificate``.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        min_alignment: a number without unit: 1 for the paper's own laws, gains and links, ε in
            [10⁻⁶, 1) for certified headings of that margin and for a tank, where 1 stands for the
            0.05 of a tank that is given no other.
        by: "law", "heading", "tank", "gains" or "links"; None is "law" if ``min_alignment`` is 1,
            else "heading".
        budget: B_i that each robot's tank begins with, m²/s.
        min_gain: the least that a robot's gains add up to, m/s; None is a*.
        max_gain: the most, m/s; None is D̄.
        share: λ in [10⁻⁶, 1], how much of a velocity is the link-keeping law's.
        bearing_error: by how much bearings may be wrong, rad; η is the larger of it and of the
            bounded errors of the scenario's sensor.
        policy: a policy or any function of observations and time, in place of all other arguments:
            its attribute ``guarantee``, a mapping of such arguments, says what its filter keeps. Of
            a function without one nothing is guaranteed; ``theorem`` then names the wrappers that
            guarantee a rendezvous whatever it chooses, and the command that searches for
            counterexamples.

    Returns:
        A Certificate, each of whose fields says its unit.

    Raises:
        TypeError: for a policy that cannot be called.
        ValueError: naming the argument that is out of its range, or does not go with ``by`` or
            ``policy``.
    """
    scenario = resolve(scenario)
    given: dict[str, Any] = {"min_alignment": min_alignment, "budget": budget, "share": share}
    given |= {"min_gain": min_gain, "max_gain": max_gain}
    if policy is None:
        return answer(scenario, question(scenario, by, given, bearing_error))[0]
    for name, value in (given | {"by": by, "bearing_error": bearing_error}).items():
        if value != (usual := getattr(LAW, name) if name in given else _UNASKED[name]):
            raise_invalid(name, value, f"{usual} with a policy, which has settings of its own")
    return of_policy(scenario, policy)


_UNASKED = {"by": None, "bearing_error": 0.0}


def of_policy(scenario: Scenario, policy: object) -> Certificate:
    """The certificate of a policy's own guarantee, or one that promises nothing."""
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
    """By which a rendezvous is guaranteed under a filter of usual settings, s, or None."""
    margin = {"min_alignment": 0.1 if by == "heading" else LAW.min_alignment}
    try:
        found, _ = answer(scenario, question(scenario, by, margin, 0.0))
    except ValueError:  # such a filter has no settings here
        return None
    return found.time_bound if found.guaranteed else None


def question(scenario: Scenario, by: Any, given: Mapping[str, Any], bearing_error: Any) -> Asked:
    """What is asked, if the arguments of ``certificate`` go together (theorem A: LAW), η a number,
    rad.
    """
    margin = check_share("min_alignment", given.get("min_alignment", LAW.min_alignment))
    by = choice("by", ("law" if margin == 1 else "heading") if by is None else by, CHOICES)
    if by in ("law", "gains", "links") and margin != 1:
        raise_invalid("min_alignment", margin, f'exactly 1 with by="{by}"')
    if by == "tank" and margin == 1:
        margin = TANK_MARGIN  # no tank has 1
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


def answer(scenario: Scenario, asked: Asked) -> tuple[Certificate, list[tuple[Theorem, Bounds]]]:
    """The best of all that is promised, with the words of the first theorem that promises a
    rendezvous, or what the one that comes nearest lacks, of several that apply the one that bears
    the largest error; and all theorems that apply.
    """
    applies, nearest, words = [], (-1.0, 0.0), ""
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
    scenario: Scenario, asked: Asked, lacks: str, found: list[Bounds], policy: str = ""
) -> Certificate:
    """The best of the bounds that apply, or in words what is lacking."""
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
        touches_obstacles=bool(scenario.obstacles) and scenario.obstacle_contact != "ignore",
        policy=policy,
        **{f"{name}_bound": bound for name, bound in least.items()},
    )
