"""Page layout: one environment with header and V(t), or a grid of environments."""

import math
from itertools import pairwise

import numpy as np
import pygame

from ..engine.memory import RENDEZVOUS
from ..simulator import Simulator
from . import ink
from .camera import Camera, PixelArea, cell, columns_of, nice_step
from .history import History
from .palette import OBSTACLE_EDGE, ROBOTS, mixed
from .picture import TeamPicture
from .scene import Floats, in_contact

_FINE = 2  # factor of supersampling, for smooth edges
_DESIGN = 600  # reference size of the shorter side for lines and letters, pixels
_HEADER, _LEGEND, _STRIP, _CAPTION = 30, 20, 118, 20  # heights, pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 16, 16, 34  # margins within the strip, pixels


class Page:
    """Page of ``size`` pixels with cached static parts.

    ``horizon`` is the initial length of the time axis, s; None is a tenth of the time limit.
    """

    def __init__(self, simulator: Simulator, size: tuple[int, int], horizon: float | None) -> None:
        self._simulator = simulator
        limit = simulator.max_steps * simulator.scenario.tau
        self._horizon = limit / 10 if horizon is None else horizon
        self._unit = _FINE * min(size) / _DESIGN
        self._fine = pygame.Surface((_FINE * size[0], _FINE * size[1]), depth=32)
        self._surface = pygame.Surface(size, depth=32)
        self._pictures: dict[int, TeamPicture] = {}  # by environment
        self.keeps_view = False
        """True if the view of an environment is kept when a new history starts."""

    def draw(self, histories: list[History], policy: str = "") -> pygame.Surface:
        """Draw the current moment of the first environments, with the policy's name in the header.

        The next call draws over the surface.
        """
        count = len(histories)
        self._fine.fill(ink.WHITE)
        weights = self._simulator.weights
        seen = self._simulator.observe()[:count].astype(np.float64)
        frames = self._simulator.frames[:count]
        bearings = np.einsum("bnij,bnrj->bnri", frames, seen)  # in the global frame
        for team, history in enumerate(histories):
            picture = self._pictures.get(team)
            if picture is None or picture.history is not history:  # a view for every episode
                camera = picture.camera if picture is not None and self.keeps_view else None
                picture = self._new_picture(team, count, history, camera)
                self._pictures[team] = picture
            picture.draw(self._fine, weights[team], bearings[team], frames[team], count == 1)
            if count > 1:
                self._draw_caption(team, history)
        if count == 1:
            self._draw_strip(histories[0])
            self._draw_header(histories[0], policy)
            self._draw_legend(histories[0])
        pygame.transform.smoothscale(self._fine, self._surface.get_size(), self._surface)
        return self._surface

    def pixels(self, positions: Floats, team: int = 0) -> Floats:
        """Pixels (..., 2) of points (..., d) of an environment in the last picture."""
        picture = self._pictures[team]
        places = picture.camera.project(positions) + np.array(picture.area[:2])
        return np.asarray(places / _FINE - 0.5)

    def points(self, pixels: Floats, team: int = 0) -> Floats:
        """Points (..., 2), m, of pixels (..., 2) in the last picture of a planar environment."""
        picture = self._pictures[team]
        places = (np.asarray(pixels) + 0.5) * _FINE - np.array(picture.area[:2])
        return picture.camera.unproject(places)

    def _new_picture(
        self, team: int, count: int, history: History, camera: Camera | None
    ) -> TeamPicture:
        left, top, width, height = cell(team, count, *self._fine.get_size())
        unit = self._unit * (max(0.5, 1.4 / columns_of(count)) if count > 1 else 1.0)
        below = round(_STRIP * self._unit) if count == 1 else 0
        above = round((_HEADER + _LEGEND if count == 1 else _CAPTION) * self._unit)
        area = PixelArea(left, top + above, width, height - above - below)
        return TeamPicture(self._simulator.scenario, history, area, unit, camera)

    def _draw_header(self, history: History, policy: str) -> None:
        """Draw scenario, policy, time, number of active robots, legend of marks, contacts."""
        moment, unit, page = history.moments[-1], self._unit, self._fine
        n, left = len(moment.merged_into), int(moment.active.sum())
        middle, size = 16 * unit, 21 * unit
        x = page.get_width() - 12 * unit
        marks = [("merge", ink.cross)]
        if np.isfinite(self._simulator.min_clearance[0]):
            marks.append(("contact", ink.ring))
            area, said = self._pictures[0].area, in_contact(int(self._simulator.contacts[0]))
            corner = area.width - 8 * unit, area.top + area.height - 6 * unit
            ink.write(page, said, corner, 17 * unit, anchor="bottomright")
        if self._simulator.scenario.events.fails:
            marks.append(("failed", ink.square))
        for word, mark in marks:
            x -= ink.write(page, word, (x, middle), size, anchor="midright") + 10 * unit
            mark(page, (x, middle), unit)
            x -= 20 * unit
        name = self._simulator.scenario.name + (f" under {policy}" if policy else "")
        text = f"{name}    t = {moment.time:.2f} s    {left} of {n} robots"
        size *= min(1.0, (x - 12 * unit) / ink.width_of(text, size))
        ink.write(page, text, (12 * unit, middle), size, anchor="midleft")

    def _draw_legend(self, history: History) -> None:
        """Draw the legend of wedges, arrows, lines and fields of view."""
        unit, page, scenario = self._unit, self._fine, self._simulator.scenario
        middle, shade = (_HEADER + 0.4 * _LEGEND) * unit, ROBOTS[0]
        sensing, thin = scenario.sensing, max(1, round(unit))

        def robot(x: float) -> None:
            tip = np.array([x + 8 * unit, middle])
            ink.wedge(
                page, mixed(shade, ink.BLACK, 0.5), tip, np.array([1.0, 0.0]), 8 * unit, 4 * unit
            )
            pygame.draw.circle(page, shade, (x, middle), 4 * unit)

        def line(x: float) -> None:
            ends = (x - 8 * unit, middle), (x + 8 * unit, middle)
            pygame.draw.line(page, ink.EDGE, *ends, 2 * thin)

        def sight(x: float) -> None:
            corner, side = (int(x - 10 * unit), int(middle - 10 * unit)), math.ceil(20 * unit) + 1
            layer = pygame.Surface((side, side), pygame.SRCALPHA)
            place, radius = np.array([x, middle]) - corner, 6 * unit
            if narrow:
                place, radius = place - np.array([5 * unit, 0.0]), 13 * unit
            view = 0.3 * np.pi if narrow else 2 * np.pi
            ink.sector(layer, shade, place, radius, 0.0, view, thin)
            page.blit(layer, corner)

        limited = math.isfinite(sensing.smallest("range"))
        turns, narrow = scenario.model.n_angles > 0, sensing.smallest("field_of_view") < 2 * np.pi
        marks = [
            ("heading" if turns else "last motion", robot),
            ("bearing to a robot", lambda x: ink.arrow(page, shade, (x, middle), unit)),
            ("see each other", line),
        ]
        if len(history.obstacles):
            edge = "to an obstacle's edge"
            marks.insert(2, (edge, lambda x: ink.arrow(page, OBSTACLE_EDGE, (x, middle), unit)))
        if scenario.dim == 2 and (limited or narrow):
            marks.append(("field of view" if narrow else "range", sight))
        x, size = 12 * unit, 16 * unit
        for word, mark in marks:
            mark(x + 8 * unit)
            x += 21 * unit
            x += ink.write(page, word, (x, middle), size, anchor="midleft") + 14 * unit

    def _draw_caption(self, team: int, history: History) -> None:
        """Draw index and time of an environment above its picture, and a frame."""
        area, moment, unit = self._pictures[team].area, history.moments[-1], self._unit
        caption = round(_CAPTION * unit)
        met = self._simulator.status[team] == RENDEZVOUS
        left = "met" if met else f"{int(moment.active.sum())} robots"
        text = f"{team}    {moment.time:.1f} s    {left}"
        place = area.left + 8 * unit, area.top - caption / 2 + unit
        ink.write(self._fine, text, place, 16 * unit, anchor="midleft")
        frame = (area.left, area.top - caption, area.width + 1, area.height + caption + 1)
        pygame.draw.rect(self._fine, ink.FRAME, frame, max(1, round(unit / 2)))

    def _draw_strip(self, history: History) -> None:
        """Draw V(t) below the picture; the time axis at least doubles when exceeded."""
        sheet, unit, moments = self._fine, self._unit, history.moments
        above = self._pictures[0].area
        box = pygame.Rect(
            round(_LEFT * unit),
            above.top + above.height + round(_TOP * unit),
            above.width - round((_LEFT + _RIGHT) * unit),
            round(_STRIP * unit) - round((_TOP + _BOTTOM) * unit),
        )
        step = nice_step(max(self._horizon, 1e-6), 6)
        end = step * math.ceil(self._horizon / step - 1e-9)
        for moment in moments:
            if moment.time > end * (1 + 1e-9):
                step = nice_step(2 * moment.time, 6)
                end = 6 * step
        highest = history.initial_lyapunov or 1.0

        def place(time: float, lyapunov: float) -> tuple[float, float]:
            """Pixel of a value; V above its initial value is clipped."""
            up = min(lyapunov / highest, 1.06)
            return box.left + box.width * time / end, box.bottom - box.height * up

        for number, text in ((0.0, "0"), (highest, f"{highest:.4g}")):
            _, y = place(0.0, number)
            pygame.draw.line(sheet, ink.GRID, (box.left, y), (box.right, y), round(unit))
            ink.write(sheet, text, (box.left - 6 * unit, y), 17 * unit, anchor="midright")
        for time in np.linspace(0.0, end, round(end / step) + 1).tolist():
            x, _ = place(time, 0.0)
            pygame.draw.line(sheet, ink.FRAME, (x, box.bottom), (x, box.bottom + 4 * unit))
            ink.write(sheet, f"{time:g}", (x, box.bottom + 7 * unit), 17 * unit, anchor="midtop")
        pygame.draw.line(sheet, ink.FRAME, box.bottomleft, box.bottomright, round(unit))
        for text, down in (("V", -9), ("(m²/s)", 9)):
            beside = box.left - 6 * unit, box.centery + down * unit
            ink.write(sheet, text, beside, 17 * unit, anchor="midright")
        corner = box.right, box.bottom + 20 * unit
        ink.write(sheet, "time (s)", corner, 17 * unit, anchor="topright")
        curve = [place(moment.time, moment.lyapunov) for moment in moments]
        for one, other in pairwise(curve):
            pygame.draw.line(sheet, ROBOTS[0], one, other, round(2 * unit))
        pygame.draw.circle(sheet, ROBOTS[0], curve[-1], 4 * unit)
