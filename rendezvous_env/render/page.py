"""A whole picture: one team with its heading and the strip of V(t), or a tile of teams."""

from __future__ import annotations

import numpy as np
import pygame
from numpy.typing import NDArray

from ..scenario.scenario import Scenario
from ..simulator import Simulator
from . import ink
from .camera import Area, Floats
from .history import History
from .picture import TeamPicture
from .strip import Strip
from .tile import cell, columns_of

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
        self._simulator, self._size = simulator, size
        limit = simulator.max_steps * simulator.scenario.tau
        self._horizon = limit / 10 if horizon is None else horizon
        self._unit = _FINE * min(size) / _DESIGN
        self._fine = pygame.Surface((_FINE * size[0], _FINE * size[1]), depth=32)
        self._surface = pygame.Surface(size, depth=32)
        self._pictures: list[tuple[History, TeamPicture, Strip | None]] = []

    def draw(self, histories: list[History]) -> pygame.Surface:
        """The present moment of every history; the surface is drawn over by the next call.

        Args:
            histories: of the first teams of the simulator.
        """
        self._fine.fill(ink.WHITE)
        self._keep_pictures(histories)
        weights = self._simulator.weights
        bearings = _global_bearings(self._simulator, len(histories))
        for team, (history, picture, strip) in enumerate(self._pictures):
            picture.draw(self._fine, weights[team], bearings[team])
            if strip is not None:
                strip.draw(self._fine)
                self._draw_header(history)
            else:
                self._draw_caption(team, history)
        pygame.transform.smoothscale(self._fine, self._size, self._surface)
        return self._surface

    def pixels(self, positions: Floats, team: int = 0) -> Floats:
        """Where points (..., d) of a team that has been drawn stand in the picture: (..., 2), x
        and y.
        """
        area = self._area(team)
        places = self._pictures[team][1].camera.project(positions)
        return np.asarray((places + np.array(area[:2])) / _FINE - 0.5)

    def _keep_pictures(self, histories: list[History]) -> None:
        """A new picture, with a view of its own, for every episode that has begun anew."""
        kept = {id(history): entry for entry in self._pictures for history in entry[:1]}
        scenario = self._simulator.scenario
        self._count = len(histories)
        self._pictures = [
            kept.get(id(history)) or self._new_picture(scenario, history, team)
            for team, history in enumerate(histories)
        ]

    def _new_picture(
        self, scenario: Scenario, history: History, team: int
    ) -> tuple[History, TeamPicture, Strip | None]:
        area, unit = self._area(team), self._unit
        if self._count > 1:
            unit *= max(0.5, 1.4 / columns_of(self._count))
            return history, TeamPicture(scenario, history, area, unit), None
        height = round(_STRIP * unit)
        below = Area(0, area.top + area.height, area.width, height)
        strip = Strip(history, below, unit, self._horizon)
        return history, TeamPicture(scenario, history, area, unit), strip

    def _area(self, team: int) -> Area:
        """Where a team is drawn, in fine pixels."""
        width, height = self._fine.get_size()
        if self._count == 1:
            top, bottom = round(_HEADER * self._unit), round(_STRIP * self._unit)
            return Area(0, top, width, height - top - bottom)
        caption = round(_CAPTION * self._unit)
        left, top, right, bottom = cell(team, self._count, width, height)
        return Area(left, top + caption, right - left, bottom - top - caption)

    def _draw_header(self, history: History) -> None:
        """Scenario, time, how many robots are left, contacts; what the marks mean."""
        moment, unit = history.moments[-1], self._unit
        n, left = len(moment.merged_into), int(moment.active.sum())
        place, size = (12 * unit, 16 * unit), round(21 * unit)
        name = self._simulator.scenario.name
        text = f"{name}    t = {moment.time:.2f} s    {left} of {n} robots"
        ink.write(self._fine, text, place, size, anchor="midleft")
        x = self._fine.get_width() - 12 * unit
        marks = [("merge", ink.cross)]
        if np.isfinite(self._simulator.min_clearance[0]):
            contacts = int(self._simulator.contacts[0])
            marks.append((f"contact ({contacts})", ink.ring))
        for word, mark in marks:
            x -= ink.write(self._fine, word, (x, place[1]), size, anchor="midright") + 10 * unit
            mark(self._fine, (x, place[1]), unit)
            x -= 20 * unit

    def _draw_caption(self, team: int, history: History) -> None:
        """Number and time of a team above its picture, and a frame about both."""
        area, moment = self._area(team), history.moments[-1]
        caption = round(_CAPTION * self._unit)
        left = int(moment.active.sum())
        many = f"{left} robots" if left > 1 else "met"
        text = f"{team}    {moment.time:.1f} s    {many}"
        place = area.left + 8 * self._unit, area.top - caption / 2 + self._unit
        ink.write(self._fine, text, place, round(16 * self._unit), anchor="midleft")
        frame = pygame.Rect(
            area.left, area.top - caption, area.width + 1, area.height + caption + 1
        )
        pygame.draw.rect(self._fine, ink.FRAME, frame, max(1, round(self._unit / 2)))


def _global_bearings(simulator: Simulator, teams: int) -> NDArray[np.float64]:
    """(teams, n, rows, d), what the robots see, turned into the global frame."""
    seen = simulator.observe()[:teams].astype(np.float64)
    return np.asarray(np.einsum("bnij,bnrj->bnri", simulator.frames[:teams], seen))
