"""Sensor imperfections of a scenario; none by default."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Annotated, Any, Literal

from .. import checks
from ..checks import Metres
from ..field_docs import lists_fields
from ..limits import MAX_DELAY, MAX_SECTORS
from .custom_sensors import as_custom

_FULL_CIRCLE = 2.0 * math.pi


def _check_view(field: str, value: Any) -> float:
    if not 0.0 < checks.to_float(value) <= _FULL_CIRCLE:
        checks.raise_invalid(
            field, value, "a positive number of at most 2π = 6.283185307179586 rad"
        )
    return checks.to_float(value)


_Deviation = Annotated[float, partial(checks.number, least=0.0, most=_FULL_CIRCLE, unit="rad")]


@lists_fields
@checks.names_unknown_fields("sensing")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Sensing:
    """Sensor model: differences from exact sensors, which measure the bearing of every neighbour.

    Links, merges and V follow the graph, regardless of missed detections. A missing row is zero;
    all others keep their length. Random numbers depend on seed, episode, step and ordered pair, so
    an episode is the same in any batch.

    There is no constant error of a robot's compass: it turns what the robot measures and the
    velocity that it commands alike, and cancels for laws without memory of directions. With such a
    compass robots move as with random ``Scenario.local_frames``.

    Raises:
        ValueError: naming the field, its value and the allowed values.
        UnknownFieldError: for an unknown field, naming the nearest one.
    """

    range: Metres | None = None
    """Maximum distance of detected neighbours, m; None is unlimited."""
    field_of_view: Annotated[float, _check_view] = _FULL_CIRCLE
    """Full angle of the field of view around the body or local x axis, rad. An obstacle is visible
    while one of its edge points is inside."""
    noise: _Deviation = 0.0
    """Standard deviation of white angular noise per ordered pair and step, rad; in 3-D about a
    random axis perpendicular to the bearing."""
    bias: _Deviation = 0.0
    """Standard deviation of a constant error of each bearing, drawn once for every ordered pair and
    episode, rad. Pairs differ, so unlike the error of a compass it does not cancel."""
    error: Annotated[float, partial(checks.number, least=0.0, most=math.pi, unit="rad")] = 0.0
    """Adversarial error: bearings are rotated by this angle in the direction that increases L most,
    rad (theorem N; guarantees, section 11)."""
    dropout: Annotated[float, partial(checks.number, least=0.0, most=1.0)] = 0.0
    """Probability that a neighbour is not detected in a step."""
    delay: Annotated[int, partial(checks.check_int, least=0, most=MAX_DELAY)] = 0
    """Delay of observations, steps; the first observation is held until then."""
    sectors: Annotated[int, partial(checks.check_int, least=2, most=MAX_SECTORS)] | None = None
    """Number of sectors to which bearings are quantised, in 3-D in yaw and elevation (± π/2); None
    disables quantisation."""
    occlusion: Literal["none", "obstacles", "robots", "both"] = "none"
    """Occluding objects: none, obstacles, robots (discs or spheres of radius r/2) or both."""
    custom: Annotated[tuple[str, ...], as_custom] = ()
    """Names of custom imperfections (``sensor_imperfection``), applied last in this order."""

    def __post_init__(self) -> None:
        checks.check_fields(self, "sensing.{}")

    @classmethod
    def camera(cls) -> Sensing:
        """Errors of four rendered 64 × 64 pixel cameras and a lamp detector (docs/worlds.md)."""
        return cls(noise=0.0075, dropout=0.03, occlusion="both")

    @property
    def exact(self) -> bool:
        """True if the sensor has no imperfection."""
        return self == _EXACT

    @property
    def built_in_exact(self) -> bool:
        """True if the sensor has no built-in imperfection."""
        return dataclasses.replace(self, custom=()).exact

    def departures(self) -> str:
        """Names and values of the imperfections, as text."""
        own, ideal = dataclasses.asdict(self), dataclasses.asdict(_EXACT)
        return ", ".join(f"{field} = {own[field]}" for field in own if own[field] != ideal[field])

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML or JSON; None is an absent key."""
        plain = {**dataclasses.asdict(self), "custom": list(self.custom) or None}
        return {field: value for field, value in plain.items() if value is not None}


_EXACT = Sensing()
