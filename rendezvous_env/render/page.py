"""A whole picture: one team with its heading and the strip of V(t), or a tile of teams."""

from __future__ import annotations

import numpy as np
import pygame

from ..simulator import Simulator
from . import ink
from .camera import Area, cell, columns_of
from .history import History
from .picture import TeamPicture
from .scene import Floats, in_contact
from .strip import Strip

_FINE = 2
"""A picture is drawn so many times as large and then made smaller, which smooths every edge."""
_DESIGN = 600
"""Pixels of the shorter side for which lines and letters were chosen; they grow with it."""
_HEADER, _STRIP, _CAPTION = 30, 118, 20


class Page:
    """Draws teams; keeps what does not change from frame to frame.

    Args:
        simulator: the teams.
        size: width and height in pixels.
        horizon: how long the time axis is to begin with, s; None begins with a tenth of the limit.
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
        """The present moment of every history; the surface is drawn over by the next call.

        Args:
            histories: of the first teams of the simulator.
        """
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
        """Where points (..., d) of a team that has been drawn stand in the picture: (..., 2), x
        and y.
        """
        picture = self._pictures[team]
        places = picture.camera.project(positions) + np.array(picture.area[:2])
        return np.asarray(places / _FINE - 0.5)

    def _keep_pictures(self, histories: list[History]) -> None:
        """A new picture, with a view of its own, for every episode that has begun anew."""
        kept = {id(picture.history): picture for picture in self._pictures}
        if len(histories) == 1 and id(histories[0]) not in kept:
            area = self._area(0, 1)
            below = Area(0, area.top + area.height, area.width, round(_STRIP * self._unit))
            self._strip = Strip(histories[0], below, self._unit, self._horizon)
        self._pictures = [
            kept.get(id(history)) or self._new_picture(history, team, len(histories))
            for team, history in enumerate(histories)
        ]

    def _new_picture(self, history: History, team: int, count: int) -> TeamPicture:
        unit = self._unit * (max(0.5, 1.4 / columns_of(count)) if count > 1 else 1.0)
        return TeamPicture(self._simulator.scenario, history, self._area(team, count), unit)

    def _area(self, team: int, count: int) -> Area:
        """Where a team is drawn, in fine pixels."""
        whole = cell(team, count, *self._fine.get_size())
        above = round((_HEADER if count == 1 else _CAPTION) * self._unit)
        below = round(_STRIP * self._unit) if count == 1 else 0
        return Area(whole.left, whole.top + above, whole.width, whole.height - above - below)

    def _draw_header(self, history: History) -> None:
        """Scenario, time, how many robots are left; what the marks mean; contacts."""
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
