"""What the robots' sensors get wrong; by default nothing."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Annotated, Any, Literal

from .. import checks
from ..checks import Metres
from ..field_docs import lists_fields
from ..limits import MOST_DELAY, MOST_SECTORS
from .custom_sensors import as_custom

_FULL_CIRCLE = 2.0 * math.pi


def _check_view(field: str, value: Any) -> float:
    if not 0.0 < checks.real(value) <= _FULL_CIRCLE:
        checks.refuse(field, value, "a positive number of at most 2π = 6.283185307179586 rad")
    return checks.real(value)


_Deviation = Annotated[float, partial(checks.number, least=0.0, most=_FULL_CIRCLE, unit="rad")]


@lists_fields
@checks.names_unknown_fields("sensing")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensing:
    """How the robots' sensors differ from exact ones, which see every neighbour and turn nothing.

    Links, merges and V follow the graph, not what a sensor misses. A missing row is zero, any other
    keeps its length. What is drawn belongs to seed, episode, step and ordered pair, so that an
    episode is the same in any batch.

    There is no constant error of a robot's compass: it turns what the robot measures and the
    velocity that it commands alike, and cancels for laws without memory of directions. With such a
    compass robots move as with random ``Scenario.local_frames``.

    Raises:
        ValueError: naming the field, its value and what would be right.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    range: Metres | None = None
    """Neighbours farther away have no row, m; None is without a limit."""
    field_of_view: Annotated[float, _check_view] = _FULL_CIRCLE
    """Angle of the cone about the body's or local x axis in which neighbours have a row, rad. An
    obstacle is seen while one of its silhouette points is in it."""
    noise: _Deviation = 0.0
    """Standard deviation of the angle by which each bearing is turned, drawn anew for every ordered
    pair and step, rad; in 3-D about a random axis perpendicular to the bearing."""
    bias: _Deviation = 0.0
    """Standard deviation of a constant error of each bearing, drawn once for every ordered pair and
    episode, rad. Pairs differ, so unlike the error of a compass it does not cancel."""
    error: Annotated[float, partial(checks.number, least=0.0, most=math.pi, unit="rad")] = 0.0
    """The bearings of neighbours are turned by exactly this much in the direction that raises L
    most, rad: the adversary of theorem N (guarantees, section 11)."""
    dropout: Annotated[float, partial(checks.number, least=0.0, most=1.0)] = 0.0
    """Chance that the row of a neighbour is missing in a step."""
    delay: Annotated[int, partial(checks.whole, least=0, most=MOST_DELAY)] = 0
    """Steps by which what is seen is late; until then what is seen first is held."""
    sectors: Annotated[int, partial(checks.whole, least=2, most=MOST_SECTORS)] | None = None
    """Bearings are rounded to this many directions from the x axis on, in 3-D in yaw and, as far as
    ± π/2, in elevation; None does not round."""
    occlusion: Literal["none", "obstacles", "robots", "both"] = "none"
    """What hides neighbours that are behind it: none, obstacles, robots (as discs or spheres of
    radius r/2) or both."""
    custom: Annotated[tuple[str, ...], as_custom] = ()
    """Names that ``sensor_imperfection`` registered, applied in this order after all others."""

    def __post_init__(self) -> None:
        checks.check_fields(self, "sensing.{}")

    @classmethod
    def camera(cls) -> Sensing:
        """Four cameras of 64 × 64 pixels and a detector of coloured lamps, as measured in pictures
        (docs/worlds.md).
        """
        return cls(noise=0.0075, dropout=0.03, occlusion="both")

    @property
    def exact(self) -> bool:
        """Whether nothing is missed and no bearing is wrong."""
        return self == _EXACT

    @property
    def built_in_exact(self) -> bool:
        """Whether nothing but a custom imperfection makes it wrong."""
        return dataclasses.replace(self, custom=()).exact

    def departures(self) -> str:
        """The fields that are not those of an exact sensor, in words."""
        own, ideal = dataclasses.asdict(self), dataclasses.asdict(_EXACT)
        return ", ".join(f"{field} = {own[field]}" for field in own if own[field] != ideal[field])

    def to_plain(self) -> dict[str, Any]:
        """The fields as plain data, as TOML or JSON hold it; None is an absent key."""
        plain = {**dataclasses.asdict(self), "custom": list(self.custom) or None}
        return {field: value for field, value in plain.items() if value is not None}


_EXACT = Sensing()
