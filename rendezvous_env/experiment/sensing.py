"""What the robots' sensors get wrong; by default nothing."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from . import checks
from .limits import MOST_DELAY, MOST_SECTORS

OCCLUSION = ("none", "obstacles", "robots", "both")
_FULL_CIRCLE = 2.0 * math.pi


@checks.names_unknown_fields("sensing")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensing:
    """How the robots' sensors differ from exact ones, which see every neighbour and turn nothing.

    Links, merges and V follow the graph, not what a sensor misses. A row that is missing is zero;
    a row that is there is as long as ever. What is drawn belongs to the team's seed, the episode,
    the step and the ordered pair, so that an episode is the same in any batch.

    Raises:
        ValueError: naming the field, its value and what would be right.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    range: float | None = None
    """Neighbours farther away have no row, m; None is without a limit."""
    field_of_view: float = _FULL_CIRCLE
    """Angle of the cone about the body's or local x axis in which neighbours have a row, rad. An
    obstacle is seen while one of its silhouette points is in it."""
    noise: float = 0.0
    """Standard deviation of the angle by which each bearing is turned, drawn anew for every ordered
    pair and step, rad; in space about a random axis perpendicular to the bearing."""
    bias: float = 0.0
    """The same, drawn once for every ordered pair and episode."""
    error: float = 0.0
    """The bearings of neighbours are turned by exactly this much in the direction that raises L
    most, rad: the adversary of theorem N (guarantees, section 11)."""
    dropout: float = 0.0
    """Chance that the row of a neighbour is missing in a step."""
    delay: int = 0
    """Steps by which what is seen is late; until then what is seen first is held."""
    sectors: int | None = None
    """Bearings are rounded to so many directions from the x axis on, in space in yaw and, as far as
    ± π/2, in elevation; None does not round."""
    occlusion: str = "none"
    """What hides neighbours that are behind it: none, obstacles, robots (as discs or spheres of
    radius r/2) or both."""

    def __post_init__(self) -> None:
        """Convert and check every field; see the class for what is raised."""
        if self.range is not None:
            self._keep("range", checks.positive("sensing.range", self.range, "m"))
        angle = checks.real(self.field_of_view)
        if not 0.0 < angle <= _FULL_CIRCLE:
            wanted = "a positive number of at most 2π = 6.283185307179586 rad"
            checks.refuse("sensing.field_of_view", self.field_of_view, wanted)
        self._keep("field_of_view", angle)
        for field, most, unit in (
            ("noise", _FULL_CIRCLE, "rad"),
            ("bias", _FULL_CIRCLE, "rad"),
            ("error", math.pi, "rad"),
            ("dropout", 1.0, ""),
        ):
            value = checks.number(f"sensing.{field}", getattr(self, field), 0.0, most, unit)
            self._keep(field, value + 0.0)
        self._keep("delay", checks.whole("sensing.delay", self.delay, 0, MOST_DELAY))
        if self.sectors is not None:
            sectors = checks.whole("sensing.sectors", self.sectors, 2, MOST_SECTORS)
            self._keep("sectors", sectors)
        checks.choice("sensing.occlusion", self.occlusion, OCCLUSION)

    def _keep(self, field: str, value: Any) -> None:
        object.__setattr__(self, field, value)

    @property
    def exact(self) -> bool:
        """Whether nothing is missed and no bearing is wrong."""
        return self == Sensing()

    def departures(self) -> str:
        """The fields that are not those of an exact sensor, in words."""
        own, ideal = dataclasses.asdict(self), dataclasses.asdict(Sensing())
        return ", ".join(
            f"{field} = {value}" for field, value in own.items() if value != ideal[field]
        )

    def to_plain(self) -> dict[str, Any]:
        """The fields as plain data, as TOML or JSON hold it; None is an absent key."""
        plain = dataclasses.asdict(self)
        return {field: value for field, value in plain.items() if value is not None}


def from_plain(plain: Any) -> Sensing:
    """A sensor from the plain data of ``Sensing.to_plain``.

    Raises:
        ValueError: for what is no table, an unknown key or an impossible value.
    """
    table: Mapping[Any, Any] = checks.mapping("sensing", plain, "a table of its fields")
    checks.known_fields(table, [field.name for field in dataclasses.fields(Sensing)], "sensing")
    return Sensing(**table)
