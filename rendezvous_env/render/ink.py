"""Text, marks and greys of rendered pictures."""

from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar

import numpy as np
import pygame

from .palette import Rgb
from .scene import Floats

Place = tuple[float, float] | list[float]
_Result = TypeVar("_Result")

WHITE: Rgb = (255, 255, 255)
BLACK: Rgb = (0, 0, 0)
GRID: Rgb = (235, 235, 235)
FRAME: Rgb = (190, 190, 190)
EDGE: Rgb = (205, 205, 205)
_TEXT: Rgb = (60, 60, 60)


@lru_cache
def _font(size: int) -> pygame.font.Font:
    pygame.font.init()
    return pygame.font.Font(None, size)


def _with_font(size: float, use: Callable[[pygame.font.Font], _Result]) -> _Result:
    """Result of a function of the font of a height, pixels."""
    try:
        return use(_font(round(size)))
    except pygame.error:  # other code has quit pygame, and with it all fonts
        _font.cache_clear()
        return use(_font(round(size)))


def write(
    surface: pygame.Surface,
    text: str,
    place: tuple[float, float],
    size: float,
    *,
    anchor: str = "topleft",
    colour: Rgb = _TEXT,
) -> int:
    """Draw a line of text, ``size`` pixels high, with a pygame ``anchor`` at a pixel.

    Returns the width, pixels.
    """
    letters = _with_font(size, lambda font: font.render(text, True, colour))
    surface.blit(letters, letters.get_rect(**{anchor: (round(place[0]), round(place[1]))}))
    return letters.get_width()


def width_of(text: str, size: float) -> int:
    """Width of a line of text, pixels."""
    return _with_font(size, lambda font: font.size(text)[0])


def cross(surface: pygame.Surface, place: Place, unit: float) -> None:
    """Draw the mark of a merge."""
    (x, y), arm, width = place, 4 * unit, max(1, round(1.5 * unit))
    pygame.draw.line(surface, BLACK, (x - arm, y - arm), (x + arm, y + arm), width)
    pygame.draw.line(surface, BLACK, (x - arm, y + arm), (x + arm, y - arm), width)


def ring(surface: pygame.Surface, place: Place, unit: float, radius: float = 0.0) -> None:
    """Draw the mark of a contact, around a robot if a radius is given."""
    pygame.draw.circle(surface, BLACK, place, radius or 4 * unit, max(1, round(1.5 * unit)))


def square(surface: pygame.Surface, place: Place, unit: float, radius: float = 0.0) -> None:
    """Draw the mark of a failed robot, around it if its radius is given."""
    half, width = radius or 5 * unit, max(1, round(1.5 * unit))
    box = pygame.Rect(0, 0, round(2 * half), round(2 * half))
    box.center = round(place[0]), round(place[1])
    pygame.draw.rect(surface, BLACK, box, width)


def sector(
    layer: pygame.Surface,
    shade: Rgb,
    place: Floats,
    radius: float,
    middle: float,
    view: float,
    width: int,
) -> None:
    """Draw a field of view on a transparent layer: an angle, rad, about its middle, or a circle."""
    if view >= 2.0 * np.pi:
        pygame.draw.circle(layer, (*shade, 110), place.tolist(), radius, width)
        return
    angles = middle + view * np.linspace(-0.5, 0.5, max(3, round(8 * view)))
    arc = place + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    outline = [place.tolist(), *arc.tolist()]
    pygame.draw.polygon(layer, (*shade, 30), outline)
    pygame.draw.polygon(layer, (*shade, 110), outline, width)


def arrow(surface: pygame.Surface, shade: Rgb, place: Place, unit: float) -> None:
    """Draw a bearing in the legend."""
    (x, y), half = place, 8 * unit
    pygame.draw.line(surface, shade, (x - half, y), (x + half, y), max(1, round(unit)))
    tip, along = np.array([x + half, y]), np.array([1.0, 0.0])
    wedge(surface, shade, tip, along, 5 * unit, 2.5 * unit)


def wedge(
    surface: pygame.Surface, shade: Rgb, tip: Floats, along: Floats, length: float, half: float
) -> None:
    """Draw the nose of a robot or an arrow head of half-width ``half``.

    ``along`` is the projected unit direction, foreshortened in 3-D.
    """
    norm = float(np.hypot(*along))
    if norm > 0:
        foot, across = tip - length * along, half * np.array([-along[1], along[0]]) / norm
        corners = [corner.tolist() for corner in (foot + across, tip, foot - across)]
        pygame.draw.polygon(surface, shade, corners)
