"""Properties of many random motions among obstacles."""

import math
from functools import cache

import numpy as np
import pytest
import shapely
from geometry import arc, body_frame, mean_body_axis, world
from parameters import slow
from test_contact import MICRON, move_one_curved, move_one_straight

from rendezvous_env.obstacles.capsule import Capsule
from rendezvous_env.obstacles.contact import SLIDE, STOP
from rendezvous_env.obstacles.disc import Disc, Sphere
from rendezvous_env.obstacles.polygon import Polygon

N_SCENES, N_STRAIGHT, N_CURVED = 50, 1000, 100
MODES = SLIDE, STOP


def move_all(move_one, worlds, starts, inputs, mode):
    """Displacements (S, N, d) and contacts (S, N) of starts (S, N, d) in S worlds."""
    out, contact = np.empty_like(starts), np.empty(starts.shape[:2], dtype=bool)
    for s, i in np.ndindex(*starts.shape[:2]):
        out[s, i], contact[s, i] = move_one(starts[s, i], inputs[s, i], worlds[s], mode)
    return out, contact


def depths(obstacles, points):
    """Penetration depths of points, (P,), without this project's code.

    Outside of all obstacles, it is minus the distance to the nearest one, or less beyond a corner.
    """
    deepest = np.full(len(points), -np.inf)
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            corners = np.array(obstacle.vertices)
            edges = np.roll(corners, -1, axis=0) - corners
            normals = np.c_[edges[:, 1], -edges[:, 0]] / np.linalg.norm(edges, axis=1)[:, None]
            depth = -(points @ normals.T - np.sum(corners * normals, axis=1)).max(axis=1)
        elif isinstance(obstacle, Capsule):
            axis = shapely.LineString(obstacle.ends)
            depth = obstacle.radius - shapely.distance(axis, shapely.points(points))
        else:
            depth = obstacle.radius - np.linalg.norm(points - obstacle.centre, axis=1)
        deepest = np.maximum(deepest, depth)
    return deepest


def goes_deeper(obstacles, starts, ends, depth):
    """Whether each straight segment goes deeper than ``depth`` into any obstacle, (P,)."""
    deeper = np.zeros(len(starts), dtype=bool)
    run = ends - starts
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            core = shapely.Polygon(obstacle.vertices).buffer(-depth, join_style="mitre")
            shapely.prepare(core)
            deeper |= shapely.intersects(core, shapely.linestrings(np.stack([starts, ends], 1)))
        elif isinstance(obstacle, Capsule):
            ways = shapely.linestrings(np.stack([starts, ends], 1))
            axis = shapely.LineString(obstacle.ends)
            deeper |= shapely.distance(axis, ways) < obstacle.radius - depth
        else:
            o = np.array(obstacle.centre) - starts
            square = np.maximum(np.sum(run**2, axis=1), 1e-300)
            nearest = np.clip(np.sum(o * run, axis=1) / square, 0, 1)
            miss = np.linalg.norm(o - nearest[:, None] * run, axis=1)
            deeper |= miss < obstacle.radius - depth
    return deeper


def random_scene(rng, dim):
    """Eight overlapping obstacles: spheres, or discs, polygons and capsules."""
    scene = []
    for k in range(8):
        centre, size = rng.uniform(-4, 4, dim), rng.uniform(0.3, 1.5)
        if dim == 3:
            scene.append(Sphere(tuple(centre), size))
        elif k % 3 == 1:
            scene.append(Disc(tuple(centre), size))
        elif k % 3 == 2:
            way = rng.uniform(-1, 1, 2)
            scene.append(Capsule((tuple(centre - way), tuple(centre + way)), 0.5 * size))
        else:
            corners = int(rng.integers(3, 7))
            angles = rng.uniform(0, 7) + 2 * math.pi * np.arange(corners) / corners
            stretch = size * rng.uniform(0.2, 1, 2)
            points = centre + stretch * np.c_[np.cos(angles), np.sin(angles)]
            scene.append(Polygon(tuple(map(tuple, points))))
    return scene


def random_starts(rng, scene, dim, count):
    """Points outside all obstacles, (count, dim); half of them on a surface, within rounding."""
    anywhere = rng.uniform(-5, 5, (3 * count, dim))
    rays = rng.normal(size=(3 * count, dim))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    on_surface = np.empty_like(anywhere)
    for k, obstacle in enumerate(scene):
        here = slice(k, None, len(scene))
        if isinstance(obstacle, Polygon):
            boundary = shapely.Polygon(obstacle.vertices).boundary
            along = rng.uniform(0, boundary.length, len(on_surface[here]))
            on_surface[here] = shapely.get_coordinates(
                shapely.line_interpolate_point(boundary, along)
            )
        elif isinstance(obstacle, Capsule):  # inside beside the first end: these are left out
            on_surface[here] = obstacle.ends[0] + obstacle.radius * rays[here]
        else:
            on_surface[here] = obstacle.centre + obstacle.radius * rays[here]
    halves = [
        points[depths(scene, points) < 1e-13][: count // 2] for points in (anywhere, on_surface)
    ]
    return np.concatenate(halves)


def many(dim, count):
    """Scenes, their worlds and starts (S, count, dim)."""
    rng = np.random.default_rng(dim)
    scenes = [random_scene(rng, dim) for _ in range(N_SCENES)]
    worlds = [world(scene, 9) for scene in scenes]
    starts = np.stack([random_starts(rng, scene, dim, count) for scene in scenes])
    return rng, scenes, worlds, starts


def sample_arc(start, inputs, count):
    """Points (count, d) evenly along a free arc, the first at its start."""
    speed, yaw, pitch, yaw_rate, pitch_rate, duration = inputs
    times = duration * np.linspace(0, 1, count)
    axes = mean_body_axis(yaw_rate, pitch_rate, pitch, times) @ body_frame(3, yaw, pitch).T
    return start + speed * times[:, None] * axes[:, : len(start)]


@cache
def straight(dim):
    """2 · 10⁵ motions: scenes, starts (S, N, d), inputs, and unobstructed displacements.

    For each contact mode, also the displacements and contacts (S, N).
    """
    rng, scenes, worlds, starts = many(dim, N_STRAIGHT)
    directions = rng.normal(size=starts.shape)
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    ways = 10 ** rng.uniform(-3, 1, (*starts.shape[:2], 1)) * directions
    moved = {mode: move_all(move_one_straight, worlds, starts, ways, mode) for mode in MODES}
    return scenes, starts, ways, ways, moved


@cache
def curved(dim):
    """As above with 2 · 10⁴ motions."""
    rng, scenes, worlds, starts = many(dim, N_CURVED)
    shape = starts.shape[:2]
    inputs = np.zeros((*shape, 6))
    inputs[..., 0] = rng.choice([-1, 1], shape) * 10 ** rng.uniform(-2, 0.5, shape)
    inputs[..., 1] = rng.uniform(-math.pi, math.pi, shape)
    inputs[..., 3] = rng.normal(0, 2, shape)
    inputs[..., 5] = 10 ** rng.uniform(-2, 0, shape)
    if dim == 3:
        inputs[..., 2] = rng.uniform(-1.5, 1.5, shape)
        inputs[..., 4] = rng.normal(0, 2, shape)
    free = np.array([arc(dim, *row) for row in inputs.reshape(-1, 6)]).reshape(starts.shape)
    moved = {mode: move_all(move_one_curved, worlds, starts, inputs, mode) for mode in MODES}
    return scenes, starts, inputs, free, moved


in_both = pytest.mark.parametrize("dim", [2, 3])
of_both = pytest.mark.parametrize("motions", [straight, curved])


@in_both
@of_both
def test_motion_never_ends_inside(motions, dim):
    scenes, starts, _, _, moved = motions(dim)
    for outs, _ in moved.values():
        for scene, start, out in zip(scenes, starts, outs, strict=True):
            assert depths(scene, start + out).max() < 1e-12


@in_both
@of_both
def test_free_motion_equals_request(motions, dim):
    _, _, _, free, moved = motions(dim)
    for out, contact in moved.values():
        exact = np.all(out == free, axis=2)
        assert np.mean(exact[~contact]) > 0.999  # the rest grazed, and were put on the surface
        assert np.linalg.norm(out - free, axis=2)[~contact].max() < 2e-3


@in_both
def test_contact_requires_depth_of_one_micron(dim):
    scenes, starts, ways, _, moved = straight(dim)
    for s, scene in enumerate(scenes):
        ends = starts[s] + ways[s]
        surely = goes_deeper(scene, starts[s], ends, MICRON * 1.001)
        perhaps = goes_deeper(scene, starts[s], ends, MICRON * 0.999)
        for _, contact in moved.values():
            assert np.all(contact[s] >= surely)
            assert np.all(contact[s] <= perhaps)


@in_both
def test_stop_mode_stops_at_first_surface(dim):
    scenes, starts, _, _, moved = straight(dim)
    stopped, contact = moved[STOP]
    for s, scene in enumerate(scenes):
        ends = starts[s] + stopped[s]
        assert not np.any(goes_deeper(scene, starts[s], ends, MICRON * 1.001))
        assert np.all(depths(scene, ends)[contact[s]] > -1e-12)
    assert 0.2 < contact.mean() < 0.9


@pytest.mark.parametrize("dim", [slow(2), 3])
def test_curved_contact_matches_dense_sampling(dim):
    scenes, starts, inputs, _, moved = curved(dim)
    stopped, contact = moved[STOP]
    for s, scene in enumerate(scenes):
        for i in range(0, N_CURVED, 5):
            path = sample_arc(starts[s, i], inputs[s, i], 2001)
            depth = depths(scene, path)
            if depth.max() > MICRON * 1.001:
                assert contact[s, i]
            if not contact[s, i]:
                continue
            end = starts[s, i] + stopped[s, i]
            spacing = abs(inputs[s, i, 0]) * inputs[s, i, 5] / 2000
            assert depth.max() > 0.7 * MICRON - spacing
            assert depths(scene, end[None]) > -2e-7
            before = np.argmax(depth > MICRON * 1.001) if depth.max() > MICRON * 1.001 else -1
            gaps = np.linalg.norm(path[:before] - end, axis=1)
            assert gaps.min(initial=np.inf) < spacing + 2e-6
