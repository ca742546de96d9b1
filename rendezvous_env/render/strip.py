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
        self._sheet, self._drawn = pygame.Surface(area[2:], depth=32), 0
        step = nice_step(max(horizon, 1e-6), 6)
        self._begin(step, math.ceil(horizon / step - 1e-9))

    def draw(self, page: pygame.Surface) -> None:
        """Draw the curve up to the last moment of the history."""
        moments, colour = self._history.moments, ROBOTS[0]
        if moments[-1].time > self._end * (1 + 1e-9):
            self._begin(nice_step(2 * moments[-1].time, 6), 6)
        points = [self._place(m.time, m.lyapunov) for m in moments[max(0, self._drawn - 1) :]]
        for start, end in pairwise(points):
            pygame.draw.line(self._sheet, colour, start, end, round(2 * self._unit))
        self._drawn = len(moments)
        page.blit(self._sheet, self._area[:2])
        x, y = points[-1]
        pygame.draw.circle(page, colour, (x + self._area.left, y + self._area.top), 4 * self._unit)

    def _place(self, time: float, lyapunov: float) -> tuple[float, float]:
        """Pixel of the strip; V above its start stays at the upper edge."""
        up = min(lyapunov / self._highest, 1.06)
        box = self._box
        return box.left + box.width * time / self._end, box.bottom - box.height * up

    def _begin(self, step: float, ticks: int) -> None:
        """Empty axes with so many ticks, a step in s apart."""
        self._end, self._drawn = step * ticks, 0
        unit, box = self._unit, self._box
        sheet = self._sheet
        sheet.fill(ink.WHITE)
        for number, text in ((0.0, "0"), (self._highest, f"{self._highest:.4g}")):
            _, y = self._place(0.0, number)
            pygame.draw.line(sheet, ink.GRID, (box.left, y), (box.right, y), round(unit))
            ink.write(sheet, text, (box.left - 6 * unit, y), 17 * unit, anchor="midright")
        for time in np.linspace(0.0, self._end, ticks + 1).tolist():
            x, _ = self._place(time, 0.0)
            pygame.draw.line(sheet, ink.FRAME, (x, box.bottom), (x, box.bottom + 4 * unit))
            ink.write(sheet, f"{time:g}", (x, box.bottom + 7 * unit), 17 * unit, anchor="midtop")
        pygame.draw.line(sheet, ink.FRAME, box.bottomleft, box.bottomright, round(unit))
        for text, down in (("V", -9), ("m²/s", 9)):
            place = box.left - 6 * unit, box.centery + down * unit
            ink.write(sheet, text, place, 17 * unit, anchor="midright")
        corner = box.right, box.bottom + 20 * unit
        ink.write(sheet, "time / s", corner, 17 * unit, anchor="topright")
