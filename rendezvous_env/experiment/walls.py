"""Straight walls of the plane that are drawn anew for every episode, by layout."""

from __future__ import annotations

from dataclasses import dataclass

from .checks import nearest_word, shown
from .obstacle_checks import check_length, check_radius, check_range

LAYOUTS = {"trap": 3, "corridor": 2, "rooms": 8}
"""Names of layouts, and the boxes that each consists of."""
_LEAST_PIECES = 3.0
"""Thicknesses that a wall of rooms is longer than its door: both pieces beside it are walls."""


@dataclass(frozen=True)
class WallField:
    """Walls of a layout, at a place and at an angle that are drawn anew for every episode.

    A trap is a U; a corridor two walls side by side; rooms are the four quarters between four walls
    that meet in the middle, with a door in each. None of them closes anything in, wherever it
    stands, so every start is possible; but a robot that may not walk away from the others, as under
    law (4), is caught.
    """

    layout: str
    """trap, corridor or rooms."""
    size: tuple[float, float]
    """Range that the length of each arm of the trap, or of each other wall, is drawn from, m."""
    opening: tuple[float, float]
    """Range of the mouth of the trap, of the width of the corridor, or of each door, m."""
    thickness: float
    """Of all walls, m."""
    region: float
    """Edge length of the square about the origin in which the middle of the layout lies, m."""
    keep_out: float
    """No robot starts nearer than this to a surface, m."""
    dim = 2

    def __post_init__(self) -> None:
        if not isinstance(self.layout, str) or self.layout not in LAYOUTS:
            near = nearest_word(self.layout, LAYOUTS)
            hint = f"did you mean {near!r}?" if near else f"it must be one of {', '.join(LAYOUTS)}"
            raise ValueError(f"obstacles: layout {shown(self.layout)} of a WallField: {hint}")
        for field in ("size", "opening"):
            pair = check_range("WallField", field, getattr(self, field))
            object.__setattr__(self, field, pair)
        thickness = check_radius("WallField", self.thickness, "thickness")
        object.__setattr__(self, "thickness", thickness)
        for field in ("region", "keep_out"):
            value = check_length("WallField", field, getattr(self, field))
            object.__setattr__(self, field, value)
        least = self.opening[1] + _LEAST_PIECES * self.thickness
        if self.layout == "rooms" and self.size[0] < least:
            raise ValueError(
                f"obstacles: size {shown(self.size)} of a WallField must be at least {least:g} m, "
                "so that a wall is left on both sides of a door"
            )

    @property
    def boxes(self) -> int:
        """Number of obstacles."""
        return LAYOUTS[self.layout]
