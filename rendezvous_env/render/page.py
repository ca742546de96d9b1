"""A whole picture: one team with a header and a strip of V(t), or a tile of teams."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pygame

from ..simulator import Simulator
from . import ink
from .camera import Area, cell, columns_of, nice_step
from .history import History
from .palette import ROBOTS
from .picture import TeamPicture
from .scene import Floats, in_contact

_FINE = 2  # a picture is drawn so many times as large, then made smaller: smooth edges
_DESIGN = 600  # pixels of the shorter side for which lines and letters were chosen
_HEADER, _STRIP, _CAPTION = 30, 118, 20  # heights, pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 16, 16, 34  # margins within the strip, pixels


class Page:
    """Draws teams; keeps what does not change from frame to frame.

    Args:
        simulator: the teams.
        size: width and height in pixels.
        horizon: first length of the time axis, s; None is a tenth of the limit.
    """

    def __init__(self, simulator: Simulator, size: tuple[int, int], horizon: float | None) -> None:
        self._simulator = simulator
        limit = simulator.max_steps * simulator.scenario.tau
        self._horizon = limit / 10 if horizon is None else horizon
        self._unit = _FINE * min(size) / _DESIGN
        self._fine = pygame.Surface((_FINE * size[0], _FINE * size[1]), depth=32)
        self._surface = pygame.Surface(size, depth=32)
        self._pictures: list[TeamPicture] = []
        self._strip: Strip | None = None

    def draw(self, histories: list[History]) -> pygame.Surface:
        """The present moment of the first teams; the next call draws over the surface."""
        self._fine.fill(ink.WHITE)
        self._keep_pictures(histories)
        weights = self._simulator.weights
        seen = self._simulator.observe()[: len(histories)].astype(np.float64)
        frames = self._simulator.frames[: len(histories)]
        bearings = np.einsum("bnij,bnrj->bnri", frames, seen)  # in the global frame
        for team, picture in enumerate(self._pictures):
            picture.draw(self._fine, weights[team], bearings[team])
            if self._strip is None:
                self._draw_caption(team, histories[team])
        if self._strip is not None:
            self._strip.draw(self._fine)
            self._draw_header(histories[0])
        pygame.transform.smoothscale(self._fine, self._surface.get_size(), self._surface)
        return self._surface

    def pixels(self, positions: Floats, team: int = 0) -> Floats:
        """Where points (..., d) of a team stand in the last picture: (..., 2), x and y."""
        picture = self._pictures[team]
        places = picture.camera.project(positions) + np.array(picture.area[:2])
        return np.asarray(places / _FINE - 0.5)

    def _keep_pictures(self, histories: list[History]) -> None:
        """A new picture, with a view of its own, for every new episode."""
        kept, count = {id(picture.history): picture for picture in self._pictures}, len(histories)
        unit = self._unit * (max(0.5, 1.4 / columns_of(count)) if count > 1 else 1.0)
        below = round(_STRIP * self._unit) if count == 1 else 0
        above = round((_HEADER if count == 1 else _CAPTION) * self._unit)
        self._pictures = []
        for team, history in enumerate(histories):
            left, top, width, height = cell(team, count, *self._fine.get_size())
            area = Area(left, top + above, width, height - above - below)
            if id(history) not in kept and count == 1:
                strip = Area(0, area.top + area.height, width, below)
                self._strip = Strip(history, strip, self._unit, self._horizon)
            self._pictures.append(
                kept.get(id(history)) or TeamPicture(self._simulator.scenario, history, area, unit)
            )

    def _draw_header(self, history: History) -> None:
        """Scenario, time, number of robots left; what the marks mean; contacts."""
        moment, unit, page = history.moments[-1], self._unit, self._fine
        n, left = len(moment.merged_into), int(moment.active.sum())
        name, middle, size = self._simulator.scenario.name, 16 * unit, 21 * unit
        text = f"{name}    t = {moment.time:.2f} s    {left} of {n} robots"
        ink.write(page, text, (12 * unit, middle), size, anchor="midleft")
        x = page.get_width() - 12 * unit
        marks = [("merge", ink.cross)]
        if np.isfinite(self._simulator.min_clearance[0]):
            marks.append(("contact", ink.ring))
            area, said = self._pictures[0].area, in_contact(int(self._simulator.contacts[0]))
            corner = area.width - 8 * unit, area.top + area.height - 6 * unit
            ink.write(page, said, corner, 15 * unit, anchor="bottomright")
        for word, mark in marks:
            x -= ink.write(page, word, (x, middle), size, anchor="midright") + 10 * unit
            mark(page, (x, middle), unit)
            x -= 20 * unit

    def _draw_caption(self, team: int, history: History) -> None:
        """Number and time of a team above its picture, and a frame about both."""
        area, moment, unit = self._pictures[team].area, history.moments[-1], self._unit
        caption = round(_CAPTION * unit)
        left = int(moment.active.sum())
        text = f"{team}    {moment.time:.1f} s    {f'{left} robots' if left > 1 else 'met'}"
        place = area.left + 8 * unit, area.top - caption / 2 + unit
        ink.write(self._fine, text, place, 16 * unit, anchor="midleft")
        frame = (area.left, area.top - caption, area.width + 1, area.height + caption + 1)
        pygame.draw.rect(self._fine, ink.FRAME, frame, max(1, round(unit / 2)))


class Strip:
    """V(t) of one episode in a part of a page.

    The time axis is first ``horizon`` long, s, up to a round number; when the episode goes on, one
    at least twice as long takes its place. ``unit`` pixels of the page count as one.
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
        self._draw_axes(step, math.ceil(horizon / step - 1e-9))

    def draw(self, page: pygame.Surface) -> None:
        """Draw the curve up to the last moment of the history."""
        moments, colour = self._history.moments, ROBOTS[0]
        if moments[-1].time > self._end * (1 + 1e-9):
            self._draw_axes(nice_step(2 * moments[-1].time, 6), 6)
        points = [self._place(m.time, m.lyapunov) for m in moments[max(0, self._drawn - 1) :]]
        for start, end in pairwise(points):
            pygame.draw.line(self._sheet, colour, start, end, round(2 * self._unit))
        self._drawn = len(moments)
        page.blit(self._sheet, self._area[:2])
        x, y = points[-1]
        pygame.draw.circle(page, colour, (x + self._area.left, y + self._area.top), 4 * self._unit)

    def _place(self, time: float, lyapunov: float) -> tuple[float, float]:
        """Pixel of the strip; V above its start stays at the upper edge."""
        up, box = min(lyapunov / self._highest, 1.06), self._box
        return box.left + box.width * time / self._end, box.bottom - box.height * up

    def _draw_axes(self, step: float, ticks: int) -> None:
        """Empty axes with so many ticks, a step in s apart."""
        self._end, self._drawn = step * ticks, 0
        unit, box, sheet = self._unit, self._box, self._sheet
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
