"""The strip below a picture: V against time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pygame

from . import ink
from .camera import Area, nice_step
from .history import History
from .palette import ROBOTS

_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 16, 16, 34
"""Margins within the strip, pixels."""


class Strip:
    """V(t) of one episode in a part of a page.

    The time axis ends at a round number; when the episode goes on, one twice as long or longer
    takes its place.

    Args:
        history: the episode.
        area: of the page, in pixels.
        unit: pixels of the page that count as one.
        horizon: how long the time axis is to begin with, s.
    """

    def __init__(self, history: History, area: Area, unit: float, horizon: float) -> None:
        self._history, self._area, self._unit = history, area, unit
        self._highest = history.initial_lyapunov or 1.0
        self._box = pygame.Rect(
            round(_LEFT * unit),
            round(_TOP * unit),
            area.width - round((_LEFT + _RIGHT) * unit),
            area.height - round((_TOP + _BOTTOM) * unit),
        )
        self._drawn = 0
        step = nice_step(max(horizon, 1e-6), 6)
        self._begin(step, math.ceil(horizon / step - 1e-9))

    def draw(self, page: pygame.Surface) -> None:
        """Draw the curve up to the last moment of the history."""
        moments = self._history.moments
        if moments[-1].time > self._end * (1 + 1e-9):
            self._begin(nice_step(2 * moments[-1].time, 6), 6)
        points = [self._place(m.time, m.lyapunov) for m in moments[max(0, self._drawn - 1) :]]
        for start, end in pairwise(points):
            pygame.draw.line(self._sheet, ROBOTS[0], start, end, round(2 * self._unit))
        self._drawn = len(moments)
        page.blit(self._sheet, (self._area.left, self._area.top))
        x, y = self._place(moments[-1].time, moments[-1].lyapunov)
        place = x + self._area.left, y + self._area.top
        pygame.draw.circle(page, ROBOTS[0], place, 4 * self._unit)

    def _place(self, time: float, lyapunov: float) -> tuple[float, float]:
        """Pixel of the strip; V above its start stays at the upper edge."""
        up = min(lyapunov / self._highest, 1.06)
        box = self._box
        return box.left + box.width * time / self._end, box.bottom - box.height * up

    def _begin(self, step: float, ticks: int) -> None:
        """Empty axes with so many ticks, a step in s apart."""
        self._end = step * ticks
        self._drawn = 0
        unit, box = self._unit, self._box
        self._sheet: pygame.Surface = pygame.Surface(
            (self._area.width, self._area.height), depth=32
        )
        self._sheet.fill(ink.WHITE)
        for number, text in ((0.0, "0"), (self._highest, f"{self._highest:.4g}")):
            _, y = self._place(0.0, number)
            pygame.draw.line(self._sheet, ink.GRID, (box.left, y), (box.right, y), round(unit))
            place = box.left - 6 * unit, y
            ink.write(self._sheet, text, place, round(17 * unit), anchor="midright")
        for time in np.linspace(0.0, self._end, ticks + 1).tolist():
            x, _ = self._place(time, 0.0)
            pygame.draw.line(self._sheet, ink.FRAME, (x, box.bottom), (x, box.bottom + 4 * unit))
            place = x, box.bottom + 7 * unit
            ink.write(self._sheet, f"{time:g}", place, round(17 * unit), anchor="midtop")
        pygame.draw.line(self._sheet, ink.FRAME, box.bottomleft, box.bottomright, round(unit))
        names = (
            ("V", (box.left - 6 * unit, box.centery - 9 * unit)),
            ("m²/s", (box.left - 6 * unit, box.centery + 9 * unit)),
        )
        for text, place in names:
            ink.write(self._sheet, text, place, round(17 * unit), anchor="midright")
        place = box.right, box.bottom + 20 * unit
        ink.write(self._sheet, "time / s", place, round(17 * unit), anchor="topright")
