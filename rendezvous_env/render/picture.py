"""One team as a picture: obstacles and paths, kept from frame to frame, and robots upon them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pygame
from numpy.typing import NDArray

from ..obstacles.obstacle_set import balls, outlines
from ..scenario.scenario import Scenario
from . import ink
from .camera import Area, Floats, fit, nice_step
from .facing import facing
from .history import History, Moment
from .palette import OBSTACLE, OBSTACLE_EDGE, robot_colour

_MARGIN = 18
_ROBOT = 6.5
"""Radius of a robot, pixels; a robot that others have joined is larger."""
_NOSE, _ARROW = 8.0, 17.0
"""How far a nose and the bearings stand out of a robot, pixels."""
_TINT = 0.3
"""Share of white in a path."""
_VEIL = 225
"""Opacity of spheres, of 255: what stands behind one shows through."""
_MOST_HEADS = 60
"""Arrows up to which each has a head."""
_TRANSPARENT = (0, 0, 0, 0)


class TeamPicture:
    """One team's episode in a part of a page; the view stays as it is from the start.

    Space is drawn in three layers: the ground with what spheres hide, the spheres, and the rest.
    In the plane nothing hides anything and the ground is enough.

    Args:
        scenario: of the team.
        history: its episode; its first moment and its obstacles settle the view.
        area: of the page, in pixels.
        unit: pixels of the page that count as one, so that a fine page has no thinner lines.
    """

    def __init__(self, scenario: Scenario, history: History, area: Area, unit: float) -> None:
        self._scenario, self._history, self._area, self._unit = scenario, history, area, unit
        start = history.moments[0].positions
        self.camera = fit(start, history.obstacles, area, _MARGIN * unit)
        self._drawn = 0
        size = area.width, area.height
        self._ground = pygame.Surface(size, depth=32)
        self._ground.fill(ink.WHITE)
        self._draw_grid()
        self._front, self._spheres = self._ground, None
        if scenario.dim == 2:
            self._draw_obstacles()
        elif any(balls(history.obstacles)):
            self._front = pygame.Surface(size, pygame.SRCALPHA)
            self._spheres = pygame.Surface(size, pygame.SRCALPHA)
            self._draw_spheres(self._spheres)

    def draw(self, page: pygame.Surface, weights: Floats, bearings: Floats) -> None:
        """Draw the last moment of the history.

        Args:
            page: to draw on.
            weights: (n, n), who senses whom, m/s.
            bearings: (n, rows, d), what the robots see now, in the global frame; zero rows are
                absent.
        """
        self._extend_paths()
        moment = self._history.moments[-1]
        canvas = page.subsurface(pygame.Rect(self._area))
        canvas.blit(self._ground, (0, 0))
        pixels = self.camera.project(moment.positions)
        hidden = self.camera.hidden(moment.positions, self._history.obstacles)
        self._draw_edges(canvas, pixels, weights, moment.active)
        if self._scenario.dim == 3:
            self._draw_stems(canvas, moment, pixels)
        self._draw_robots(canvas, moment, pixels, bearings, moment.active & hidden)
        if self._spheres is not None:
            canvas.blit(self._spheres, (0, 0))
            canvas.blit(self._front, (0, 0))
        self._draw_robots(canvas, moment, pixels, bearings, moment.active & ~hidden)

    # ---- what does not move -----------------------------------------------------------------

    def _draw_grid(self) -> None:
        """Lines a round number of metres apart, and how many metres they are apart."""
        camera, unit = self.camera, self._unit
        low, high = camera.low[:2], camera.high[:2]
        if self._scenario.dim == 2:
            half = np.array([self._area.width, self._area.height]) / (2 * camera.scale)
            low, high = camera.centre - half, camera.centre + half
        step = nice_step(float((high - low).max()), 8)
        for axis in (0, 1):
            for k in range(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1):
                ends = np.array([low, high])
                ends[:, axis] = k * step
                first, last = camera.project(self._on_ground(ends)).tolist()
                pygame.draw.line(self._ground, ink.GRID, first, last, max(1, round(unit)))
        if self._scenario.dim == 3:
            corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
            outline = camera.project(self._on_ground(corners)).tolist()
            pygame.draw.polygon(self._ground, ink.FRAME, outline, max(1, round(unit)))
        place = 8 * unit, self._area.height - 6 * unit
        text = f"grid {step:g} m"
        ink.write(self._ground, text, place, round(15 * unit), anchor="bottomleft")

    def _on_ground(self, points: Floats) -> Floats:
        """Points (..., 2) of the plane, or of the floor of the scene."""
        if self._scenario.dim == 2:
            return points
        floor = np.full((*points.shape[:-1], 1), self.camera.low[2])
        return np.concatenate([points, floor], axis=-1)

    def _draw_obstacles(self) -> None:
        """Discs and outlines of the plane."""
        edge = max(1, round(self._unit))
        for centre, size, vertices in outlines(self._history.obstacles):
            if len(vertices):
                outline = self.camera.project(vertices).tolist()
                pygame.draw.polygon(self._ground, OBSTACLE, outline)
                pygame.draw.polygon(self._ground, OBSTACLE_EDGE, outline, edge)
            else:
                middle = self.camera.project(centre).tolist()
                radius = float(size * self.camera.scale)
                pygame.draw.circle(self._ground, OBSTACLE, middle, radius)
                pygame.draw.circle(self._ground, OBSTACLE_EDGE, middle, radius, edge)

    def _draw_spheres(self, layer: pygame.Surface) -> None:
        """Spheres from the farthest to the nearest, each a little lighter towards its top."""
        spheres = list(balls(self._history.obstacles))
        nearness = self.camera.nearness(np.array([ball.centre for ball in spheres]))
        edge = max(1, round(self._unit))
        for k in np.argsort(nearness):
            middle = self.camera.project(spheres[k].centre)
            radius = float(spheres[k].radius * self.camera.scale * nearness[k])
            pygame.draw.circle(layer, (*OBSTACLE, _VEIL), middle.tolist(), radius)
            for share in (0.12, 0.24, 0.36):
                light = middle - radius * share * np.array([0.6, 1.0])
                shade = (*ink.tint(OBSTACLE, share), _VEIL)
                pygame.draw.circle(layer, shade, light.tolist(), radius * (0.9 - 1.4 * share))
            pygame.draw.circle(layer, OBSTACLE_EDGE, middle.tolist(), radius, edge)

    # ---- what grows ---------------------------------------------------------------------------

    def _extend_paths(self) -> None:
        """Add to the paths what has happened since the last frame."""
        moments = self._history.moments[max(0, self._drawn - 1) :]
        if not self._drawn:
            self._draw_starts(moments[0].positions)
        self._drawn = len(self._history.moments)
        for before, after in pairwise(moments):
            layers = self._layers(after.positions)
            old, new = self.camera.project(before.positions), self.camera.project(after.positions)
            for i in np.flatnonzero(before.active).tolist():
                shade = ink.tint(robot_colour(i), _TINT)
                ends = old[i].tolist(), new[i].tolist()
                pygame.draw.line(layers[i], shade, *ends, max(1, round(2 * self._unit)))
            for i in np.flatnonzero(after.contact & ~before.contact).tolist():
                ink.ring(layers[i], new[i].tolist(), self._unit)
            for i in np.flatnonzero(before.active & ~after.active).tolist():
                ink.cross(layers[i], new[i].tolist(), self._unit)

    def _draw_starts(self, positions: Floats) -> None:
        """A dot where each path begins."""
        layers, places = self._layers(positions), self.camera.project(positions).tolist()
        for i, place in enumerate(places):
            shade = ink.tint(robot_colour(i), _TINT)
            pygame.draw.circle(layers[i], shade, place, 3.5 * self._unit)

    def _layers(self, positions: Floats) -> list[pygame.Surface]:
        """Where to draw what is at each of these places, behind the spheres or before them."""
        hidden = self.camera.hidden(positions, self._history.obstacles)
        return [self._ground if behind else self._front for behind in hidden.tolist()]

    # ---- what moves ---------------------------------------------------------------------------

    def _draw_edges(
        self, canvas: pygame.Surface, pixels: Floats, weights: Floats, active: NDArray[np.bool_]
    ) -> None:
        """A thin line between robots of which one senses the other."""
        places, width = pixels.tolist(), max(1, round(self._unit))
        linked = (weights > 0) | (weights.T > 0)
        sensed = np.triu(linked & active & active[:, None])
        for i, j in np.argwhere(sensed).tolist():
            pygame.draw.line(canvas, ink.EDGE, places[i], places[j], width)

    def _draw_stems(self, canvas: pygame.Surface, moment: Moment, pixels: Floats) -> None:
        """A plumb line from each robot to the ground, which tells where it is in space."""
        feet = self.camera.project(self._on_ground(moment.positions[:, :2]))
        width, u = max(1, round(self._unit)), self._unit
        for i in np.flatnonzero(moment.active).tolist():
            shade = ink.tint(robot_colour(i), 0.6)
            pygame.draw.line(canvas, shade, pixels[i].tolist(), feet[i].tolist(), width)
            foot = pygame.Rect(0, 0, 8 * u, 4 * u)
            foot.center = round(feet[i, 0]), round(feet[i, 1])
            pygame.draw.ellipse(canvas, shade, foot)

    def _draw_robots(
        self,
        canvas: pygame.Surface,
        moment: Moment,
        pixels: Floats,
        bearings: Floats,
        which: NDArray[np.bool_],
    ) -> None:
        """Robots of a mask, from the farthest to the nearest, with what they see."""
        order = np.flatnonzero(which)
        order = order[np.argsort(self.camera.nearness(moment.positions[order]), kind="stable")]
        sizes = np.bincount(moment.merged_into, minlength=len(which))
        noses = self.camera.directions(moment.positions, self._facing(moment))
        self._draw_bearings(canvas, moment.positions, pixels, bearings, which)
        for i in order.tolist():
            middle, radius = pixels[i], self._radius(int(sizes[i]))
            shade = robot_colour(i)
            ink.wedge(
                canvas, ink.shaded(shade, 0.5), middle, noses[i], (radius, _NOSE * self._unit)
            )
            pygame.draw.circle(canvas, ink.WHITE, middle.tolist(), radius + self._unit)
            pygame.draw.circle(canvas, shade, middle.tolist(), radius)
            if moment.contact[i]:
                ink.ring(canvas, middle.tolist(), self._unit, radius + 3 * self._unit)
            if sizes[i] > 1:
                size = round(2 * radius)
                text, place = str(sizes[i]), (middle[0], middle[1])
                ink.write(canvas, text, place, size, anchor="center", ink=ink.WHITE)

    def _radius(self, members: int) -> float:
        return self._unit * (_ROBOT + min(4.0, 1.5 * math.sqrt(members - 1)))

    def _facing(self, moment: Moment) -> Floats:
        """(n, d), unit vectors along the robots' bodies, or for single integrators, which have
        none, along their last motion; zero for one that has not moved.
        """
        if moment.headings.shape[1]:
            return facing(moment.headings, self._scenario.dim)
        before = self._history.moments[-2:][0].positions
        motion = moment.positions - before
        length = np.linalg.norm(motion, axis=-1, keepdims=True)
        return np.asarray(np.divide(motion, length, out=np.zeros_like(motion), where=length > 0))

    def _draw_bearings(
        self,
        canvas: pygame.Surface,
        positions: Floats,
        pixels: Floats,
        bearings: Floats,
        which: NDArray[np.bool_],
    ) -> None:
        """Short arrows along what robots see: neighbours in their colour, edges of obstacles."""
        layout, unit = self._scenario.observation_layout, self._unit
        lengths = np.linalg.norm(bearings[:, : layout.obstacles.stop], axis=-1)
        robots, rows = np.nonzero((lengths > 0) & which[:, None])
        seen = bearings[robots, rows] / lengths[robots, rows, None]
        along = self.camera.directions(positions[robots], seen)
        tips = pixels[robots] + along * (self._radius(1) + _ARROW * unit)
        others = (rows >= layout.neighbours.stop).tolist()
        middles, ends, width = pixels.tolist(), tips.tolist(), max(1, round(unit))
        for i, other, tip in zip(robots.tolist(), others, ends, strict=True):
            shade = OBSTACLE_EDGE if other else robot_colour(i)
            pygame.draw.line(canvas, shade, middles[i], tip, width)
        if self._scenario.dim == 2 and len(robots) <= _MOST_HEADS:
            for k, i in enumerate(robots.tolist()):
                shade = OBSTACLE_EDGE if others[k] else robot_colour(i)
                ink.arrow_head(canvas, shade, tips[k], along[k], 5 * unit)
