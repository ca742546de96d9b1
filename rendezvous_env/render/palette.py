"""Colours that mean the same in every picture of this project.

Those of Okabe and Ito, which colour-blind readers can tell apart; yellow, too faint on white, is
replaced by a dark red.
"""

from typing import Final

Rgb = tuple[int, int, int]

OBSTACLE: Final[Rgb] = (0xE6, 0x9F, 0x00)
"""Orange, as in the paper; nothing else has it."""
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
"""Of the robots, by index; the eighth has the colour of the first again."""


def robot_colour(index: int) -> Rgb:
    """Red, green and blue of a robot."""
    return ROBOTS[index % len(ROBOTS)]


def mixed(colour: Rgb, other: Rgb, share: float) -> Rgb:
    """A colour with a share of another mixed in."""
    red, green, blue = (
        round((1 - share) * one + share * two) for one, two in zip(colour, other, strict=True)
    )
    return red, green, blue


def code(colour: Rgb) -> str:
    """A colour as "#RRGGBB"."""
    return "#{:02X}{:02X}{:02X}".format(*colour)
