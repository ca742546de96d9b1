"""What is guaranteed for a scenario, by which theorem, or why nothing is."""

from __future__ import annotations

import math
import os
import warnings
from dataclasses import dataclass
from typing import Any

from ...checks import choice, real, refuse
from ...scenario.scenario import Scenario
from ...scenario.scenarios import resolve
from ..gains import gain_range
from ..links import check_share
from ..settings import bounded_error, check_bearing_error
from . import delay, descent, gains, links, noise, tank, turning
from .descent import check_margin
from .theorem import CHOICES, Asked, Bounds, Theorem

THEOREMS: tuple[Theorem, ...] = (
    *gains.THEOREMS,
    *descent.THEOREMS,
    *turning.THEOREMS,
    *tank.THEOREMS,
    *links.THEOREMS,
    *noise.THEOREMS,
    *delay.THEOREMS,
)
"""All that certificates ask, in turn; the first that promises a rendezvous gives the words."""
_DEFAULT_SHARE = 0.5
_APPLIES = 1000
"""More than any theorem has assumptions."""
_UNDER = {
    "law": "law (1)",
    "heading": "certified headings",
    "tank": "an energy tank",
    "gains": "gains",
    "links": "link-keeping",
}


@dataclass(frozen=True)
class Certificate:
    """What is guaranteed for a scenario, and why or why not; ``print`` gives it in three lines."""

    min_alignment: float
    """ε: the least alignment |hᵀf|/‖f‖ that the guarantee builds on; 1 for law (1)."""
    dead_zone: float
    """δ = a*/(2n), m/s."""
    certified_step: float
    """r/(2D̄), s."""
    bottleneck_weight: float
    """a*, m/s."""
    time_bound: float
    """Time in s by which all robots have met in the environment as it steps, inputs held, from any
    start in the spawn area or from the given start; inf without a bound."""
    guaranteed: bool
    """Whether rendezvous is guaranteed."""
    theorem: str
    """Which theorem covers the scenario, or why none does."""
    by: str = "law"
    """What keeps the guarantee, one of CHOICES."""
    continuous_time_bound: float = math.inf
    """The same for velocities that follow the bearings in continuous time; inf without a bound."""
    continuous_time_only: bool = False
    """Whether the guarantee is proven in continuous time only, so that ``time_bound`` is inf."""
    lyapunov_bound: float = math.inf
    """What V never exceeds, m²/s, with obstacles in motion without a contact; inf without a
    bound."""
    hull_bound: float = math.inf
    """What L never exceeds, m; inf without a bound."""
    link_growth_bound: float = math.inf
    """By how much a link is never longer than at the start, m; inf without a bound."""
    bearing_error: float = 0.0
    """η, rad: by how much bearings may be wrong here. The wrapper must be given it too."""
    tolerated_bearing_error: float = 0.0
    """By how much bearings could be wrong, any less than this, rad, inputs held, and a theorem
    would still promise a rendezvous; 0 if none is tolerated."""
    expected_time_bound: float = math.inf
    """What the mean time to rendezvous does not exceed under noise that is drawn anew for every
    bearing and step, s; inf without a bound."""
    scenario: str = "custom"
    """Its name."""
    time_limit: float = math.inf
    """Of its episodes, s."""

    @property
    def promises(self) -> dict[str, float]:
        """Every number that is promised of the environment as it steps, by what it bounds: time, s;
        V ("lyapunov"), m²/s, and L ("hull"), m, at any time; "link_growth", m; "expected_time", s.
        """
        found = {
            "time": self.time_bound,
            "lyapunov": self.lyapunov_bound,
            "hull": self.hull_bound,
            "link_growth": self.link_growth_bound,
            "expected_time": self.expected_time_bound,
        }
        return {name: bound for name, bound in found.items() if math.isfinite(bound)}

    margin = property(lambda self: self.min_alignment, doc="ε: ``min_alignment``.")
    sampled_time_bound = property(lambda self: self.time_bound, doc="``time_bound``, s.")

    @property
    def held_time_bound(self) -> float:
        """Deprecated: ``time_bound``."""
        return _renamed("held_time_bound", "time_bound", self.time_bound)

    @property
    def bearing_error_borne(self) -> float:
        """Deprecated: ``tolerated_bearing_error``."""
        name = "tolerated_bearing_error"
        return _renamed("bearing_error_borne", name, self.tolerated_bearing_error)

    @property
    def continuous_time(self) -> bool:
        """Deprecated: ``continuous_time_only``."""
        return _renamed("continuous_time", "continuous_time_only", self.continuous_time_only)

    def __str__(self) -> str:
        """What is promised, by when, and how that compares with the episode's limit."""
        what = f"{self.scenario} under {_UNDER[self.by]}: {self.theorem}"
        units = {"lyapunov": ("V", "m²/s"), "hull": ("L", "m"), "link_growth": ("a link", "m")}
        kept = [
            f"{units[name][0]} never {'grows by more than' if name == 'link_growth' else 'exceeds'}"
            f" {bound:.4g} {units[name][1]}"
            for name, bound in self.promises.items()
            if name in units
        ]
        if self.tolerated_bearing_error > 0:
            kept.append(f"bearings may err by up to {self.tolerated_bearing_error:.3g} rad")
        return "\n".join((what, "; ".join(kept) or "No other number is promised.", self._by_when()))

    def _by_when(self) -> str:
        if not self.guaranteed:
            return "No rendezvous is guaranteed."
        limit = self.time_limit
        if math.isinf(self.time_bound):
            bound = f"bound {self.continuous_time_bound:.4g} s" * math.isfinite(
                self.continuous_time_bound
            )
            known = bound or "without a bound"
            return f"Proven in continuous time only, {known}: of held inputs nothing is said."
        if self.time_bound <= limit:
            return f"Bound {self.time_bound:.4g} s, within the limit of {limit:.4g} s."
        return (
            f"Bound {self.time_bound:.4g} s, limit {limit:.4g} s: the guarantee says nothing about "
            "when this episode ends."
        )


def _renamed(old: str, new: str, value: Any) -> Any:
    warnings.warn(f"Certificate.{old} is called {new} now", DeprecationWarning, stacklevel=3)
    return value


def certificate(
    scenario: Scenario | str | os.PathLike[str],
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

    For the scenario's own graph, and starts in its spawn area; by the theorems of THEOREMS, of
    which each number is the best. Bounded errors of the scenario's sensor count: η is the larger of
    them and of ``bearing_error``. The wrapper is to be given the same numbers.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        min_alignment: a number without unit: 1 for the paper's own laws, gains and links, ε in
            [10⁻⁶, 1) for certified headings of that margin, ε in [10⁻⁶, 1] for a tank.
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
    scenario = resolve(scenario)
    error = max(check_bearing_error(bearing_error), bounded_error(scenario.sensing, scenario.dim))
    chosen = _checked(min_alignment, by, budget)
    check_share(share)
    _check_goes_with(chosen, min_gain=min_gain, max_gain=max_gain, share=share)
    if chosen == "gains":
        gain_range(scenario, min_gain, max_gain)
    asked = Asked(chosen, real(min_alignment), real(budget), min_gain, max_gain, real(share), error)
    found, words = _ask(scenario, asked)
    promised = [bounds for bounds in found if bounds.meets]
    time = min((bounds.time for bounds in promised), default=math.inf)
    followed = min((bounds.continuous_time for bounds in promised), default=math.inf)
    return Certificate(
        min_alignment=asked.min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        time_bound=time,
        guaranteed=bool(promised),
        theorem=words,
        by=chosen,
        continuous_time_bound=followed,
        continuous_time_only=bool(promised) and math.isinf(time),
        bearing_error=error,
        tolerated_bearing_error=max((b.tolerated_bearing_error for b in found), default=0.0),
        lyapunov_bound=min((b.lyapunov for b in found), default=math.inf),
        hull_bound=min((b.hull for b in found), default=math.inf),
        link_growth_bound=min((b.link_growth for b in found), default=math.inf),
        expected_time_bound=min((b.expected_time for b in found), default=math.inf),
        scenario=scenario.name,
        time_limit=scenario.time_limit,
    )


def _ask(scenario: Scenario, asked: Asked) -> tuple[list[Bounds], str]:
    """What all theorems that apply promise; and the words of the first that promises a rendezvous,
    or what the one that comes nearest lacks.
    """
    found, nearest, lacking = [], -1, ""
    for theorem in THEOREMS:
        if asked.by not in theorem.by:
            continue
        met, words = theorem.unmet(scenario, asked)
        if not words:
            found.append(bounds := theorem.bounds(scenario, asked))
            met, words = _APPLIES, bounds.words if asked.error and not bounds.meets else ""
        if words and theorem.rendezvous and met > nearest:
            nearest, lacking = met, words
    promised = next((bounds.words for bounds in found if bounds.meets), "")
    return found, promised or lacking


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
