"""Picture of one environment: cached obstacles and paths, and the robots."""

import math

import numpy as np
import pygame

from ..obstacles.moving import moving_slots
from ..obstacles.obstacle_set import outlines
from ..scenario.scenario import Scenario
from . import ink
from .camera import Camera, PixelArea, fit, nice_step
from .history import History, Moment
from .palette import OBSTACLE, OBSTACLE_EDGE, mixed, robot_colour
from .scene import Bools, Floats, ended, facing, sights

_MARGIN = 18  # pixels
_ROBOT = 6.5  # radius of a robot, pixels; larger after merges
_NOSE, _ARROW = 8.0, 17.0  # length of the nose and the bearings beyond a robot, pixels
_TINT = 0.3  # fraction of white in a path
_VEIL = 225  # opacity of spheres, of 255, so that objects behind remain visible
_LIGHTER = (0.12, 0.24, 0.36)  # fractions of white in a sphere, towards its top
_MOST_NUMBERS = 30  # maximum number of robots with visible numbers
_MOST_VIEWS = 12  # maximum number of robots with visible ranges and fields of view
_VIEW = 0.12  # radius of a field of view without a range, relative to the picture's shorter side
_IN_ORDER = 47  # maximum number of robots with one row each, if there are rows for all
_MOST_HEADS = 60  # maximum number of arrows with heads


class TeamPicture:
    """Episode of one environment in an area of a page, with a fixed view.

    3-D scenes have three layers: the ground with everything behind spheres, the spheres, and the
    rest. Planar ones have the ground. ``unit`` scales line widths, pixels. Without a camera the
    view is fitted to the first moment.
    """

    def __init__(
        self,
        scenario: Scenario,
        history: History,
        area: PixelArea,
        unit: float,
        camera: Camera | None = None,
    ) -> None:
        self.history, self.area = history, area
        self._scenario, self._unit = scenario, unit
        self._thin, self._drawn, size = max(1, round(unit)), 0, area[2:]
        start, self._moving = history.moments[0].positions, moving_slots(scenario.obstacles)
        still = np.delete(history.obstacles, self._moving, axis=0)
        self.camera = camera or fit(start, history.obstacles, area, _MARGIN * unit)
        self._ground = pygame.Surface(size, depth=32)
        self._ground.fill(ink.WHITE)
        self._draw_grid()
        self._front, self._spheres = self._ground, None
        if scenario.dim == 2:
            self._draw_obstacles(self._ground, still)
        elif outlines(history.obstacles, 3):
            self._front = pygame.Surface(size, pygame.SRCALPHA)
            self._spheres = pygame.Surface(size, pygame.SRCALPHA)
            self._draw_obstacles(self._spheres, history.obstacles)

    def draw(
        self, page: pygame.Surface, weights: Floats, bearings: Floats, frames: Floats, numbers: bool
    ) -> None:
        """Draw the last moment of the history, with or without the robots' numbers.

        Weights are (n, n), m/s; bearings (n, rows, d) are the robots' observations in the global
        frame; frames (n, d, d) are those of the robots.
        """
        self._extend_paths()
        moment = self.history.moments[-1]
        canvas = page.subsurface(pygame.Rect(self.area))
        canvas.blit(self._ground, (0, 0))
        if self._moving and self._spheres is not None:
            self._spheres.fill((0, 0, 0, 0))
            self._draw_obstacles(self._spheres, moment.obstacles)
        elif self._moving:
            self._draw_obstacles(canvas, moment.obstacles[self._moving])
        pixels = self.camera.project(moment.positions)
        hidden = self.camera.hidden(moment.positions, moment.obstacles)
        self._draw_views(canvas, moment, pixels, frames)
        self._draw_links(canvas, moment, pixels, weights, bearings)
        if self._scenario.dim == 3:
            self._draw_stems(canvas, moment, pixels)
        self._draw_robots(canvas, moment, pixels, bearings, moment.active & hidden)
        if self._spheres is not None:
            canvas.blit(self._spheres, (0, 0))
            canvas.blit(self._front, (0, 0))
        self._draw_robots(canvas, moment, pixels, bearings, moment.active & ~hidden)
        if numbers and len(pixels) <= _MOST_NUMBERS:
            self._draw_numbers(canvas, moment, pixels)

    def _draw_views(
        self, canvas: pygame.Surface, moment: Moment, pixels: Floats, frames: Floats
    ) -> None:
        """Draw limited ranges and fields of view of robots in the plane."""
        sensing, n = self._scenario.sensing, self._scenario.n_robots
        reaches, views = sensing.each("range", n), sensing.each("field_of_view", n)
        limited = np.isfinite(reaches) | (views < 2.0 * math.pi)
        if self._scenario.dim == 3 or not limited.any() or moment.active.sum() > _MOST_VIEWS:
            return
        unlimited = _VIEW * min(self.area[2:])
        radii = np.where(np.isfinite(reaches), reaches * self.camera.scale, unlimited)
        layer = pygame.Surface(canvas.get_size(), pygame.SRCALPHA)
        for i in np.flatnonzero(moment.active & limited).tolist():
            ahead = self.camera.directions(moment.positions[i], frames[i, :, 0])
            middle = math.atan2(ahead[1], ahead[0])
            radius, view = float(radii[i]), float(views[i])
            ink.sector(layer, robot_colour(i), pixels[i], radius, middle, view, self._thin)
        canvas.blit(layer, (0, 0))

    def _draw_links(
        self,
        canvas: pygame.Surface,
        moment: Moment,
        pixels: Floats,
        weights: Floats,
        bearings: Floats,
    ) -> None:
        """Draw a line between robots that observe each other, half of it if only one does."""
        n, layout = len(pixels), self._scenario.observation_layout
        linked = (weights > 0) & moment.active & moment.active[:, None]
        in_order = layout.neighbour_slots >= n - 1 and n <= _IN_ORDER
        seen = sights(bearings[:, layout.neighbours], moment.positions, linked, in_order)
        for i, j in np.argwhere(seen).tolist():
            end = pixels[j] if seen[j, i] else (pixels[i] + pixels[j]) / 2
            if i < j or not seen[j, i]:
                pygame.draw.line(canvas, ink.EDGE, pixels[i].tolist(), end.tolist(), self._thin)

    def _draw_numbers(self, canvas: pygame.Surface, moment: Moment, pixels: Floats) -> None:
        """Draw the number of each robot."""
        sizes = np.bincount(moment.merged_into, minlength=len(pixels)).tolist()
        for i in np.flatnonzero(moment.active).tolist():
            away = 0.8 * self._radius(sizes[i]) + self._unit
            place, shade = pixels[i] - away, mixed(robot_colour(i), ink.BLACK, 0.4)
            ink.write(
                canvas, str(i), tuple(place), 15 * self._unit, anchor="bottomright", colour=shade
            )

    def _draw_grid(self) -> None:
        """Draw grid lines at a round spacing, with its value."""
        camera, ground, unit = self.camera, self._ground, self._unit
        low, high = camera.low[:2], camera.high[:2]
        if self._scenario.dim == 2:
            half = np.array(self.area[2:]) / (2 * camera.scale)
            low, high = camera.centre - half, camera.centre + half
        step = nice_step(float((high - low).max()), 8)
        for axis in (0, 1):
            for k in range(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1):
                ends = np.array([low, high])
                ends[:, axis] = k * step
                first, last = self._on_ground(ends).tolist()
                pygame.draw.line(ground, ink.GRID, first, last, self._thin)
        if self._scenario.dim == 3:
            corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
            pygame.draw.polygon(ground, ink.FRAME, self._on_ground(corners).tolist(), self._thin)
        place = 8 * unit, self.area.height - 6 * unit
        ink.write(ground, f"grid {step:g} m", place, 15 * unit, anchor="bottomleft")

    def _on_ground(self, points: Floats) -> Floats:
        """Pixels of points (..., 2) in the plane, or on the floor in 3-D."""
        if self._scenario.dim == 3:
            floor = np.full((*points.shape[:-1], 1), self.camera.low[2])
            points = np.concatenate([points, floor], axis=-1)
        return self.camera.project(points)

    def _draw_obstacles(self, layer: pygame.Surface, obstacles: Floats) -> None:
        """Draw a table of obstacles from back to front, spheres with a lighter top."""
        camera, draw = self.camera, pygame.draw
        for centre, size, vertices in sorted(
            outlines(obstacles, self._scenario.dim),
            key=lambda shape: float(camera.nearness(shape.centre)),
        ):
            if len(vertices):
                outline = camera.project(vertices).tolist()
                draw.polygon(layer, OBSTACLE, outline)
                draw.polygon(layer, OBSTACLE_EDGE, outline, self._thin)
                continue
            middle = camera.project(centre)
            radius = float(size * camera.scale * camera.nearness(centre))
            opacity = (_VEIL,) if self._scenario.dim == 3 else ()
            draw.circle(layer, (*OBSTACLE, *opacity), middle.tolist(), radius)
            for share in _LIGHTER if opacity else ():
                light = middle - radius * share * np.array([0.6, 1.0])
                shade = (*mixed(OBSTACLE, ink.WHITE, share), _VEIL)
                draw.circle(layer, shade, light.tolist(), radius * (0.9 - 1.4 * share))
            draw.circle(layer, OBSTACLE_EDGE, middle.tolist(), radius, self._thin)

    def _extend_paths(self) -> None:
        """Extend the paths since the last frame, with a dot at their start."""
        moments = self.history.moments[max(0, self._drawn - 1) :]
        positions, active, contact = (
            np.array([getattr(moment, name) for moment in moments])
            for name in ("positions", "active", "contact")
        )
        pixels = self.camera.project(positions).tolist()
        layers = [
            [self._ground if hidden else self._front for hidden in row.tolist()]
            for row in (self.camera.hidden(one.positions, one.obstacles) for one in moments)
        ]
        shades = [mixed(robot_colour(i), ink.WHITE, _TINT) for i in range(len(pixels[0]))]
        for i, place in enumerate(pixels[0]) if not self._drawn else ():
            pygame.draw.circle(layers[0][i], shades[i], place, 3.5 * self._unit)
        self._drawn, width = len(self.history.moments), max(1, round(2 * self._unit))
        for k, i in np.argwhere(active[:-1]).tolist():
            pygame.draw.line(layers[k + 1][i], shades[i], pixels[k][i], pixels[k + 1][i], width)
        for mark, gone in ((ink.ring, ~contact), (ink.cross, active)):
            for k, i in ended(gone).tolist():
                mark(layers[k][i], pixels[k][i], self._unit)

    def _draw_stems(self, canvas: pygame.Surface, moment: Moment, pixels: Floats) -> None:
        """Draw a plumb line from each robot to the ground."""
        feet = self._on_ground(moment.positions[:, :2])
        for i in np.flatnonzero(moment.active).tolist():
            shade = mixed(robot_colour(i), ink.WHITE, 0.6)
            pygame.draw.line(canvas, shade, pixels[i].tolist(), feet[i].tolist(), self._thin)
            foot = pygame.Rect(0, 0, 8 * self._unit, 4 * self._unit)
            foot.center = round(feet[i, 0]), round(feet[i, 1])
            pygame.draw.ellipse(canvas, shade, foot)

    def _draw_robots(
        self, canvas: pygame.Surface, moment: Moment, pixels: Floats, bearings: Floats, which: Bools
    ) -> None:
        """Draw the robots of a mask from the farthest to the nearest, with their bearings."""
        if not which.any():  # none is hidden in the plane
            return
        unit, order = self._unit, np.flatnonzero(which)
        order = order[np.argsort(self.camera.nearness(moment.positions[order]), kind="stable")]
        sizes = np.bincount(moment.merged_into, minlength=len(which)).tolist()
        noses = self.camera.directions(moment.positions, self._facing(moment))
        self._draw_bearings(canvas, moment, pixels, bearings, which)
        for i in order.tolist():
            middle, place, radius = pixels[i], pixels[i].tolist(), self._radius(sizes[i])
            shade, length = robot_colour(i), radius + _NOSE * unit
            tip, dark = middle + length * noses[i], mixed(shade, ink.BLACK, 0.5)
            ink.wedge(canvas, dark, tip, noses[i], length, 0.95 * radius)
            pygame.draw.circle(canvas, ink.WHITE, place, radius + unit)
            pygame.draw.circle(canvas, shade, place, radius)
            if moment.contact[i]:
                ink.ring(canvas, place, unit, radius + 3 * unit)
            if moment.failed[i]:
                ink.square(canvas, place, unit, radius + 4 * unit)
            if sizes[i] > 1:
                number, size = str(sizes[i]), 2 * radius
                ink.write(canvas, number, place, size, anchor="center", colour=ink.WHITE)

    def _radius(self, members: int) -> float:
        return self._unit * (_ROBOT + min(4.0, 1.5 * math.sqrt(members - 1)))

    def _facing(self, moment: Moment) -> Floats:
        """Unit vectors along the body axis, or else the last motion, (n, d); zero if not moved."""
        if moment.headings.shape[1]:
            return facing(moment.headings, self._scenario.dim)
        motion = moment.positions - self.history.moments[-2:][0].positions
        length = np.linalg.norm(motion, axis=-1, keepdims=True)
        return np.asarray(np.divide(motion, length, out=np.zeros_like(motion), where=length > 0))

    def _draw_bearings(
        self, canvas: pygame.Surface, moment: Moment, pixels: Floats, bearings: Floats, which: Bools
    ) -> None:
        """Draw arrows along bearings to neighbours, in their colour, and to obstacle edges."""
        layout, unit = self._scenario.observation_layout, self._unit
        lengths = np.linalg.norm(bearings[:, : layout.obstacles.stop], axis=-1)
        robots, rows = np.nonzero((lengths > 0) & which[:, None])
        seen = bearings[robots, rows] / lengths[robots, rows, None]
        along = self.camera.directions(moment.positions[robots], seen)
        tips = pixels[robots] + along * (self._radius(1) + _ARROW * unit)
        shades = [
            robot_colour(i) if row < layout.neighbours.stop else OBSTACLE_EDGE
            for i, row in zip(robots.tolist(), rows.tolist(), strict=True)
        ]
        for k, i in enumerate(robots.tolist()):
            pygame.draw.line(canvas, shades[k], pixels[i].tolist(), tips[k].tolist(), self._thin)
        if self._scenario.dim == 2 and len(robots) <= _MOST_HEADS:
            for shade, tip, way in zip(shades, tips, along, strict=True):
                ink.wedge(canvas, shade, tip, way, 5 * unit, 2.5 * unit)
