"""Representation of a theorem: assumptions as predicates with messages, and bounds."""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Any, NamedTuple

from ...scenario.scenario import Scenario

CHOICES = {
    "law": "law (1)",
    "heading": "certified headings",
    "tank": "an energy tank",
    "gains": "gains",
    "links": "link-keeping",
}
"""Description of each value of ``by`` in ``certificate``."""
ROUNDED = 2.0**-22
"""Bound on the rotation of a bearing by float32 rounding, rad."""
PROMISED = ("time", "lyapunov", "hull", "link_growth", "expected_time")
"""Fields of TheoremBounds that hold in discrete time."""


def at_most(bound: float) -> str:
    """Text of a number of any unit with four digits, ≥ the bound."""
    return _in_digits(bound, 4, ROUND_CEILING)


def at_least(tolerated: float, digits: int = 4) -> str:
    """Text of a tolerated number of any unit, rounded down to the given digits (guarantees 11)."""
    return _in_digits(tolerated, digits, ROUND_FLOOR)


def _in_digits(number: float, digits: int, rounding: str) -> str:
    # no further digit for float64 rounding alone
    shown = Context(prec=digits, rounding=rounding).create_decimal(f"{number:.12g}")
    return f"{float(shown):.{digits}g}"


class Asked(NamedTuple):
    """Arguments of ``certificate`` apart from the scenario; defaults: law (1), exact bearings."""

    by: str = "law"
    min_alignment: float = 1.0  # ε, without unit
    budget: float = 0.0  # B_i, m²/s
    min_gain: float | Sequence[float] | None = None  # m/s, of all robots or a list
    max_gain: float | Sequence[float] | None = None
    share: float = 0.5  # λ, without unit
    error: float = 0.0  # η, rad: the larger of the argument and the error of the sensor
    observes_merges: bool = True  # whether tanks observe merges, as in wrappers


LAW = Asked()


@dataclass(frozen=True)
class TheoremBounds:
    """Bounds of a theorem for a scenario; infinite where there is none."""

    words: str = ""  # the guarantee, theorem first; or the reason why there is none for this error
    meets: bool = False  # whether rendezvous is guaranteed
    time: float = math.inf  # rendezvous time, s, with zero-order hold over the scenario's step
    continuous_time: float = math.inf  # rendezvous time in continuous time, s
    expected_time: float = math.inf  # of the mean time to rendezvous, s
    lyapunov: float = math.inf  # of V at any time, m²/s; with obstacles, but for contacts
    hull: float = math.inf  # of L at any time, m
    link_growth: float = math.inf  # maximum growth of a link over its initial length, m
    tolerated_bearing_error: float = 0.0  # η, rad: below it, the time is finite


def bounds_with_errors(
    asked: Asked, time: Any, tolerated: float, words: str, who: str, even_so: str = "", **rest: Any
) -> TheoremBounds:
    """Numbers with bearing errors: a rendezvous guarantee if the time, s, is finite.

    Otherwise a message that the time overflows, or that η exceeds the ``tolerated`` error, rad, of
    ``who`` (guarantees 11). ``rest`` are bounds that hold in any case.
    """
    borne = asked.error < tolerated - (ROUNDED if asked.error > 0.0 else 0.0)
    meets = math.isfinite(time) and (borne or asked.error == 0.0)
    if not meets and borne:
        words = (
            f"none: the bound of {who} on the time overflows, beyond {sys.float_info.max:.2g} s, "
            "and rendezvous is not guaranteed"
        )
    elif not meets and asked.error == 0.0:
        words = ""
    elif not meets:
        words = (
            f"none: bearings may err by {asked.error:.4g} rad, and {who} is known to tolerate less "
            f"than {at_least(tolerated)} rad here (guarantees 11){even_so}"
        )
    time = float(time) if meets else math.inf
    return TheoremBounds(words, meets, time, tolerated_bearing_error=tolerated, **rest)


Assumption = Callable[[Scenario, Asked], str]
"""Predicate of a scenario: an empty string if met, otherwise a message."""

TWO_CRASHED = "none: two robots that crash apart can never meet; at most one may crash"


@dataclass(frozen=True)
class Theorem:
    """A theorem with its assumptions and bounds."""

    name: str  # name in docs/guarantees.md
    by: tuple[str, ...]  # mechanisms of the guarantee, from CHOICES
    assumptions: tuple[Assumption, ...]  # all must hold
    bounds: Callable[[Scenario, Asked], TheoremBounds]  # for a scenario that meets all
    rendezvous: bool = True  # whether it can guarantee rendezvous, and not only bounds
    every_step: str = ""
    """Property of every step without merge or contact, or empty: V does not increase ("descent"),
    nor V + ΣA ("ledger"), the hull ("nested", while linked robots are at least r apart), or any
    link ("links")."""
    clocks: tuple[str, ...] = ()
    """Values of ``Scenario.hold`` with which it also holds under asynchronous
    ``Scenario.activation``."""
    events: tuple[str, ...] = ()
    """Kinds of ``Scenario.events`` with which it also holds. Frames may rotate in all theorems
    except those that assume ``frames_stay`` (docs/proofs.md, N2)."""

    def unmet(self, scenario: Scenario, asked: Asked) -> tuple[int, str]:
        """Number of assumptions met before the first failure, and its message, if any.

        Negative if it does not cover the clocks (−2) or events (−1) of the scenario.
        """
        clocks = scenario.activation
        if not clocks.synchronous and scenario.hold not in self.clocks:
            return -2, (
                f"none: activation is asynchronous ({clocks}, hold = "
                f"{scenario.hold!r}), and no theorem covers {CHOICES[asked.by]} under it"
            )
        if kinds := scenario.events.kinds - {"compass", *self.events}:
            return -1, _why_not_with(scenario, kinds, CHOICES[asked.by])
        if scenario.meeting == "pack":
            return 0, (
                "none: theorems are about merging, and with meeting='pack' robots do not merge; "
                "bodies never overlap under any policy"
            )
        if scenario.drops_neighbours:
            return 0, (
                "none: with neighbour_overflow='nearest' a robot may have more neighbours than "
                f"the {scenario.neighbour_slots} observed rows, whose sum is then not f"
            )
        failing = ((met, holds(scenario, asked)) for met, holds in enumerate(self.assumptions))
        return next((found for found in failing if found[1]), (len(self.assumptions), ""))


def _why_not_with(scenario: Scenario, kinds: set[str], who: str) -> str:
    """Message that a theorem does not hold with some kinds of events."""
    events = scenario.events
    if len(events.crashes) + events.n_crashed > 1:
        return TWO_CRASHED
    if "adversary" in kinds:
        return "none: an adversarial robot can escape at the speed of the others"
    if "noise" in kinds:
        return "none: a Gaussian disturbance has no bound; events.disturbance has one"
    return f"none: no theorem covers {who} with these failures or disturbances ({events})"
