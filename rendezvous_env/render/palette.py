"""Colours with the same meaning in all pictures.

The colour-blind safe palette of Okabe and Ito, with yellow replaced by dark red for contrast.
"""

from typing import Final

Rgb = tuple[int, int, int]

OBSTACLE: Final[Rgb] = (0xE6, 0x9F, 0x00)
"""Orange, as in the paper; reserved for obstacles."""
OBSTACLE_EDGE: Final[Rgb] = (0x8A, 0x5F, 0x00)
"""Outlines of obstacles, and bearings to their edges."""
ROBOTS: Final[tuple[Rgb, ...]] = (
    (0x00, 0x72, 0xB2),  # blue
    (0xD5, 0x5E, 0x00),  # vermilion
    (0x00, 0x9E, 0x73),  # green
    (0xCC, 0x79, 0xA7),  # purple
    (0x56, 0xB4, 0xE9),  # sky blue
    (0x88, 0x22, 0x55),  # dark red
    (0x00, 0x00, 0x00),
)
"""Colours of robots by index, repeating after seven."""


def robot_colour(index: int) -> Rgb:
    """Colour of a robot as red, green, blue."""
    return ROBOTS[index % len(ROBOTS)]


def mixed(colour: Rgb, other: Rgb, share: float) -> Rgb:
    """Colour mixed with a fraction of another."""
    red, green, blue = (
        round((1 - share) * one + share * two) for one, two in zip(colour, other, strict=True)
    )
    return red, green, blue


def code(colour: Rgb) -> str:
    """Colour as "#RRGGBB"."""
    return "#{:02X}{:02X}{:02X}".format(*colour)
