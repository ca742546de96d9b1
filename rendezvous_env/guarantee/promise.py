"""What a certificate says, and what it is asked about."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

CHOICES = ("law", "heading", "tank", "gains", "links")
"""What keeps the guarantee: law (1) itself, certified headings, an energy tank, gains that are not
negative, or velocities that lengthen no link."""


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
    bearing_error: float = 0.0
    """η, rad: by how much bearings may be wrong here. The wrapper must be given it too."""
    bearing_error_borne: float = 0.0
    """By how much bearings could be wrong, any less than this, rad, inputs held, and the theorem
    would still promise a rendezvous; 0 if it bears none."""
    expected_time_bound: float = math.inf
    """What the mean time to rendezvous does not exceed under noise that is drawn anew for every
    bearing and step, s; inf without a bound."""


class Asked(NamedTuple):
    """The arguments of a certificate besides the scenario and the margin."""

    by: str
    budget: float
    min_gain: float | None
    max_gain: float | None
    share: float
    error: float
    """η, rad, the larger of the argument and of the scenario's sensor."""
