"""Motion among obstacles: hand-computed contacts, and properties of very many random ones."""

import math

import numpy as np
import pytest
import scipy.optimize
import shapely
from tuples import arc, triple, world

from rendezvous_env.obstacles.contact import (
    CONTACT_DEPTH,
    IGNORE,
    SLIDE,
    STOP,
    move_curved,
    move_straight,
)
from rendezvous_env.obstacles.disc import Disc, Sphere
from rendezvous_env.obstacles.polygon import Polygon
from rendezvous_env.robots.nonholonomic_3d import Nonholonomic3D
from rendezvous_env.robots.unicycle import Unicycle

MICRON = 1e-6
N_SCENES, N_STRAIGHT, N_CURVED = 50, 1000, 100
WALL = Polygon(((-20, 0), (20, 0), (20, 2), (-20, 2)))  # free below y = 0


def move_one_straight(start, displacement, scene, mode):
    """Displacement (d,) executed and contact of one straight motion in a world."""
    normals = np.empty((2 * len(scene.kinds), 3))
    contact, moved = move_straight(triple(start), triple(displacement), scene, mode, normals)
    return np.array(moved)[: len(start)], contact


def move_one_curved(start, inputs, scene, mode):
    """The same for inputs v, yaw, pitch, their rates and the duration."""
    speed, yaw, pitch, yaw_rate, pitch_rate, duration = map(float, inputs)
    if len(start) == 2:
        model = Unicycle(duration, abs(speed), abs(yaw_rate))
        action, frame, memory = (speed, yaw_rate), (0.0,) * 4, (yaw,)
    else:
        model = Nonholonomic3D(duration, abs(speed), abs(yaw_rate), abs(pitch_rate))
        action, frame, memory = (speed, yaw_rate, pitch_rate), (0.0,) * 9, (yaw, pitch)
    way, normals = triple(arc(len(start), *inputs)), np.empty((2 * len(scene.kinds), 3))
    contact, moved = move_curved(
        triple(start), way, model, action, frame, memory, scene, mode, normals
    )
    return np.array(moved)[: len(start)], contact


def move_all(move_one, worlds, starts, inputs, mode):
    """Displacements (S, N, d) and contacts (S, N) of starts (S, N, d) in S worlds."""
    out, contact = np.empty_like(starts), np.empty(starts.shape[:2], dtype=bool)
    for s, i in np.ndindex(*starts.shape[:2]):
        out[s, i], contact[s, i] = move_one(starts[s, i], inputs[s, i], worlds[s], mode)
    return out, contact


def free_arcs(inputs, dim):
    """Free displacements (N, d) for inputs (N, 6)."""
    return np.array([arc(dim, *row) for row in inputs])


def straight(position, displacement, obstacles, mode=SLIDE):
    """End point and contact of one straight motion."""
    scene = world(obstacles, len(obstacles) + 1)
    moved, contact = move_one_straight(position, displacement, scene, mode)
    return np.array(position, dtype=float) + moved, contact


def curved(position, speed, yaw, yaw_rate, duration, obstacles, mode=SLIDE):
    """Displacement and contact of one unicycle motion."""
    scene = world(obstacles, len(obstacles) + 1)
    return move_one_curved(position, (speed, yaw, 0.0, yaw_rate, 0.0, duration), scene, mode)


def signed_distances(obstacles, points):
    """Distance (P, M) of points to the surfaces, negative inside, without this project's code."""
    columns = []
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            shape, at = shapely.Polygon(obstacle.vertices), shapely.points(points)
            depth = shapely.distance(shape.boundary, at)
            columns.append(np.where(shapely.contains(shape, at), -depth, depth))
        else:
            columns.append(np.linalg.norm(points - obstacle.centre, axis=1) - obstacle.radius)
    return np.stack(columns, axis=1)


def depths(obstacles, points):
    """How deep inside the deepest obstacle points are, (P,); negative outside of all."""
    deepest = np.full(len(points), -np.inf)
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            corners, normals = polygon_edges(obstacle)
            depth = -(points @ normals.T - np.sum(corners * normals, axis=1)).max(axis=1)
        else:
            depth = obstacle.radius - np.linalg.norm(points - obstacle.centre, axis=1)
        deepest = np.maximum(deepest, depth)
    return deepest


def polygon_edges(polygon):
    """First corners and outward normals of all edges, each (V, 2)."""
    corners = np.array(polygon.vertices)
    edges = np.roll(corners, -1, axis=0) - corners
    return corners, np.c_[edges[:, 1], -edges[:, 0]] / np.linalg.norm(edges, axis=1)[:, None]


def goes_deeper(obstacles, starts, ends, depth):
    """Whether each straight segment goes deeper than ``depth`` into any obstacle, (P,)."""
    deeper = np.zeros(len(starts), dtype=bool)
    run = ends - starts
    for obstacle in obstacles:
        if isinstance(obstacle, Polygon):
            core = shapely.Polygon(obstacle.vertices).buffer(-depth, join_style="mitre")
            shapely.prepare(core)
            deeper |= shapely.intersects(core, shapely.linestrings(np.stack([starts, ends], 1)))
        else:
            o = np.array(obstacle.centre) - starts
            square = np.maximum(np.sum(run**2, axis=1), 1e-300)
            nearest = np.clip(np.sum(o * run, axis=1) / square, 0, 1)
            miss = np.linalg.norm(o - nearest[:, None] * run, axis=1)
            deeper |= miss < obstacle.radius - depth
    return deeper


def random_scene(rng, dim):
    """Eight overlapping obstacles: spheres, or discs and polygons."""
    scene = []
    for k in range(8):
        centre, size = rng.uniform(-4, 4, dim), rng.uniform(0.3, 1.5)
        if dim == 3:
            scene.append(Sphere(tuple(centre), size))
        elif k % 2:
            scene.append(Disc(tuple(centre), size))
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


@pytest.fixture(scope="module", params=[2, 3])
def straight_motions(request):
    """Random straight motions in both contact modes: 2 · 10⁵ in all."""
    dim = request.param
    rng, scenes, worlds, starts = many(dim, N_STRAIGHT)
    directions = rng.normal(size=starts.shape)
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    lengths = 10 ** rng.uniform(-3, 1, (*starts.shape[:2], 1))
    displacements = lengths * directions
    moved = {
        mode: move_all(move_one_straight, worlds, starts, displacements, mode)
        for mode in (SLIDE, STOP)
    }
    return scenes, worlds, starts, displacements, moved


class TestManyStraightMotions:
    @pytest.mark.parametrize("mode", [SLIDE, STOP])
    def test_none_ends_inside(self, straight_motions, mode):
        scenes, _, starts, _, moved = straight_motions
        for scene, start, out in zip(scenes, starts, moved[mode][0], strict=True):
            assert signed_distances(scene, start + out).min() > -1e-12

    def test_contact_is_a_path_deeper_than_a_micron(self, straight_motions):
        scenes, _, starts, displacements, moved = straight_motions
        for s, scene in enumerate(scenes):
            ends = starts[s] + displacements[s]
            surely = goes_deeper(scene, starts[s], ends, MICRON * 1.001)
            perhaps = goes_deeper(scene, starts[s], ends, MICRON * 0.999)
            for _, contact in moved.values():
                assert np.all(contact[s] >= surely)
                assert np.all(contact[s] <= perhaps)

    def test_a_robot_that_stops_stops_at_the_first_surface(self, straight_motions):
        scenes, _, starts, _, moved = straight_motions
        stopped, contact = moved[STOP]
        for s, scene in enumerate(scenes):
            ends = starts[s] + stopped[s]
            assert not np.any(goes_deeper(scene, starts[s], ends, MICRON * 1.001))
            distances = signed_distances(scene, ends).min(axis=1)
            assert np.all(distances[contact[s]] < 1e-12)
        assert 0.2 < contact.mean() < 0.9

    def test_free_motion_is_exactly_what_was_asked(self, straight_motions):
        _, _, _, displacements, moved = straight_motions
        for out, contact in moved.values():
            free = ~contact
            exact = np.all(out == displacements, axis=2)
            assert np.mean(exact[free]) > 0.999  # the rest grazed, and were put on the surface
            shift = np.linalg.norm(out - displacements, axis=2)
            assert shift[free].max() < 2e-3

    def test_sliding_follows_the_free_part_of_the_motion(self, straight_motions):
        """Redo it leg by leg: stop, project with nonnegative least squares, go on."""
        scenes, worlds, starts, displacements, moved = straight_motions
        slid, contact = moved[SLIDE]
        checked = 0
        for s, scene in enumerate(scenes):
            for i in np.flatnonzero(contact[s])[:60]:
                corners = leg_by_leg(scene, worlds[s], starts[s, i], displacements[s, i])
                np.testing.assert_allclose(corners[-1], starts[s, i] + slid[s, i], atol=1e-6)
                depth = MICRON * 1.001
                assert not np.any(goes_deeper(scene, corners[:-1], corners[1:], depth))
                checked += len(corners) > 3
        assert checked > 30  # of several legs

    def test_sliding_never_goes_against_the_motion(self, straight_motions):
        _, _, _, displacements, moved = straight_motions
        slid = moved[SLIDE][0]
        lengths = np.linalg.norm(displacements, axis=2)
        along = np.sum(slid * displacements, axis=2) / lengths
        assert along.min() > -2 * MICRON
        assert np.all(np.linalg.norm(slid, axis=2) <= lengths + 2 * MICRON)


def leg_by_leg(scene, packed, start, displacement):
    """Corners (L, d) of the path of a sliding robot."""
    corners, left, leg = [start], 1.0, displacement
    for _ in range(16):
        out, contact = move_one_straight(corners[-1], leg, packed, STOP)
        corners.append(corners[-1] + out)
        length = np.linalg.norm(leg)
        if not contact or length == 0:
            break
        left *= 1 - np.linalg.norm(out) / length
        leg = left * free_part(scene, corners[-1], displacement)
    return np.array(corners)


def free_part(scene, point, velocity):
    """The direction nearest to the velocity that enters nothing touched: v + Σ λₖ nₖ, λ ≥ 0."""
    normals = []
    for obstacle in scene:
        if isinstance(obstacle, Polygon):
            if signed_distances([obstacle], point[None])[0, 0] < CONTACT_DEPTH:
                normals.append(polygon_normal(obstacle, point))
        elif np.linalg.norm(point - obstacle.centre) - obstacle.radius < CONTACT_DEPTH:
            normals.append((point - obstacle.centre) / np.linalg.norm(point - obstacle.centre))
    if not normals:
        return velocity
    basis = np.array(normals).T
    push, _ = scipy.optimize.nnls(basis, -velocity)
    return velocity + basis @ push


def polygon_normal(polygon, point):
    """Outward normal of the edge whose line is the farthest out at the point."""
    corners, normals = polygon_edges(polygon)
    return normals[np.argmax(np.sum((point - corners) * normals, axis=1))]


@pytest.fixture(scope="module", params=[2, 3])
def curved_motions(request):
    """Random arcs in both contact modes: 2 · 10⁴ in all."""
    dim = request.param
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
    moved = {
        mode: move_all(move_one_curved, worlds, starts, inputs, mode) for mode in (SLIDE, STOP)
    }
    return scenes, starts, inputs, moved


def sample_arc(start, inputs, count):
    """Points (count, d) evenly along a free arc, the first at its start."""
    repeated = np.repeat(inputs[None], count, axis=0)
    repeated[:, 5] *= np.linspace(0, 1, count)
    return start + free_arcs(repeated, len(start))


class TestManyCurvedMotions:
    @pytest.mark.parametrize("mode", [SLIDE, STOP])
    def test_none_ends_inside(self, curved_motions, mode):
        scenes, starts, _, moved = curved_motions
        for scene, start, out in zip(scenes, starts, moved[mode][0], strict=True):
            assert signed_distances(scene, start + out).min() > -1e-12

    def test_free_arcs_are_exact(self, curved_motions):
        _, starts, inputs, moved = curved_motions
        free_ends = free_arcs(inputs.reshape(-1, 6), starts.shape[2]).reshape(starts.shape)
        for out, contact in moved.values():
            exact = np.all(out == free_ends, axis=2)
            assert np.mean(exact[~contact]) > 0.999

    def test_contact_and_stop_agree_with_a_dense_sample_of_the_arc(self, curved_motions):
        scenes, starts, inputs, moved = curved_motions
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
                assert signed_distances(scene, end[None]).min() < 2e-7
                before = np.argmax(depth > MICRON * 1.001) if depth.max() > MICRON * 1.001 else -1
                gaps = np.linalg.norm(path[:before] - end, axis=1)
                assert gaps.min(initial=np.inf) < spacing + 2e-6


class TestStraightByHand:
    """A disc of radius 1 at (3, 0) and a wall with its face on y = 0, robots below it."""

    DISC = Disc((3, 0), 1)

    @pytest.mark.parametrize(
        ("mode", "end", "contact"),
        [(SLIDE, (2, 0), True), (STOP, (2, 0), True), (IGNORE, (5, 0), False)],
    )
    def test_head_on_into_a_disc(self, mode, end, contact):
        found, touched = straight((0, 0), (5, 0), [self.DISC], mode)
        np.testing.assert_allclose(found, end, atol=1e-12)
        assert touched == contact

    def test_slide_on_a_disc_leaves_along_the_tangent(self):
        # meets the disc at (3, 1) + (-s, -s), s = 0.5^0.5, moving right; tangent (1, 1)/√2
        start = np.array([0.0, math.sqrt(0.5)])
        touch = np.array([3 - math.sqrt(0.5), math.sqrt(0.5)])
        end, contact = straight(start, (5, 0), [self.DISC])
        left = 5 - touch[0]
        np.testing.assert_allclose(end, touch + left * np.array([0.5, 0.5]), atol=1e-12)
        assert contact

    @pytest.mark.parametrize(
        ("mode", "end", "contact"),
        [
            (SLIDE, (4, 0), True),
            (STOP, (1, 0), True),
            (IGNORE, (4, 3), False),
        ],
    )
    def test_diagonally_into_a_wall(self, mode, end, contact):
        found, touched = straight((0, -1), (4, 4), [WALL], mode)
        np.testing.assert_allclose(found, end, atol=1e-12)
        assert touched == contact

    @pytest.mark.parametrize("mode", [SLIDE, STOP])
    def test_at_the_surface_outward_and_along_are_free(self, mode):
        for displacement in ((1, 0), (-1, 0), (1, -1), (0, -3)):
            end, contact = straight((0.1, 0), displacement, [WALL], mode)
            assert tuple(end) == (0.1 + displacement[0], displacement[1])
            assert not contact
        for displacement in ((0, 1), (0, -1), (-1, 1), (-1, -1)):
            end, contact = straight((2, 0), displacement, [self.DISC], mode)
            assert tuple(end) == (2 + displacement[0], displacement[1])
            assert not contact

    def test_at_the_surface_inward_stops_or_slides(self):
        end, contact = straight((0.1, 0), (1, 1), [WALL], STOP)
        assert tuple(end) == (0.1, 0.0)
        assert contact
        end, contact = straight((0.1, 0), (1, 1), [WALL], SLIDE)
        np.testing.assert_allclose(end, (1.1, 0), atol=1e-12)
        assert contact

    def test_past_the_end_of_an_edge_it_goes_straight_on(self):
        end, contact = straight((14, -1), (10, 2), [WALL])
        np.testing.assert_allclose(end, (24, 0), atol=1e-12)
        assert contact

    @pytest.mark.parametrize(
        ("depth", "contact"), [(0.99e-6, False), (1.01e-6, True), (-1e-9, False)]
    )
    def test_a_micron_is_the_limit(self, depth, contact):
        across = straight((-1, 1 - depth), (8, 0), [self.DISC])
        assert across[1] == contact
        if not contact:
            assert tuple(across[0]) == (7, 1 - depth)
        end, touched = straight((-1, -1), (2, 1 + depth), [WALL])
        assert touched == contact
        if not contact:
            np.testing.assert_allclose(end, (1, min(0, depth)), atol=1e-12)

    def test_a_robot_creeping_into_a_surface_never_sinks_in(self):
        position = np.array([0.0, 0.0])
        for _ in range(50):
            position, contact = straight(position, (0.01, 0.5e-6), [WALL])
            assert not contact
        np.testing.assert_allclose(position, (0.5, 0), atol=1e-12)

    @pytest.mark.parametrize("opening", [10, 60, 90, 120, 170])
    def test_in_a_corner_of_two_walls_it_rests(self, opening):
        half = math.radians(opening) / 2
        walls = [half_plane(math.pi / 2 - half), half_plane(math.pi / 2 + half, left=False)]
        position = np.array([0.0, 3.0])
        for push in ((0, -5), (0.2, -5), (-0.1, -5), (0, -5), (0, -5)):
            position, contact = straight(position, push, walls)
            assert contact
        gap = CONTACT_DEPTH / math.sin(half)
        np.testing.assert_allclose(position, (0, 0), atol=4 * gap)
        out, contact = straight(position, (0, 1), walls)
        np.testing.assert_allclose(out - position, (0, 1))
        assert not contact

    def test_in_an_obtuse_corner_it_slides_from_one_wall_onto_the_other(self):
        floor = Polygon(((-9, -1), (9, -1), (9, 0), (-9, 0)))
        ramp = Polygon(((0, 0), (9, -1), (9, 9)))
        end, contact = straight((-1, 0), (3, -1e-3), [floor, ramp])
        np.testing.assert_allclose(end, np.full(2, 1.0 - 0.5e-3 * 2 / 3), atol=1e-6)
        assert contact

    def test_between_two_spheres_it_slides_out_along_the_common_tangent(self):
        spheres = [Sphere((0, 1, 0), math.sqrt(2)), Sphere((0, -1, 0), math.sqrt(2))]
        end, contact = straight((1, 0, 0), (-1, 0, 0.3), spheres)
        np.testing.assert_allclose(end, (1, 0, 0.3), atol=1e-9)
        assert contact
        spheres.append(Sphere((1, 0, 1), 1.0))
        end, contact = straight((1, 0, 0), (-1, 0, 0.3), spheres)
        np.testing.assert_allclose(end, (1, 0, 0), atol=1e-9)
        assert contact

    def test_nothing_is_fast_enough_to_pass_through(self):
        thin = Polygon(((-50, 0), (50, 0), (50, 1e-3), (-50, 1e-3)))
        for length in (1e-2, 1, 1e3, 1e6):
            end, contact = straight((0.3, -1e-3), (0, length), [thin])
            np.testing.assert_allclose(end, (0.3, 0), atol=1e-9)
            assert contact
            end, contact = straight((-1, 0.1), (length + 2, 0), [Disc((0, 0.1), 1e-3)])
            np.testing.assert_allclose(end, (-1e-3, 0.1), atol=1e-9)
            assert contact


def half_plane(angle, left=True):
    """A big triangle-like block whose edge is the ray at an angle from the origin.

    The free side is on the left of the ray (or else on its right).
    """
    along = 50 * np.array([math.cos(angle), math.sin(angle)])
    across = np.array([along[1], -along[0]]) * (1 if left else -1)
    corners = [-along, along, along + across, -along + across]
    return Polygon(tuple(map(tuple, corners)))


class TestCurvedByHand:
    DISC = Disc((0, 0), 1)

    def test_a_straight_arc_stops_where_the_line_does(self):
        for mode in (SLIDE, STOP):
            out, contact = curved((-3, 0), 2.0, 0.0, 0.0, 2.0, [self.DISC], mode)
            np.testing.assert_allclose(out, (2, 0), atol=1e-12)
            assert contact
        out, contact = curved((-3, 0), 2.0, 0.0, 0.0, 2.0, [self.DISC], IGNORE)
        assert tuple(out) == (4, 0)
        assert not contact

    def test_quarter_circle_into_a_wall(self):
        # radius 2 about (0, -1): starts at (0, -3) to the right, meets y = -0.5 at sin φ = 1/4
        wall = Polygon(((0, -0.5), (9, -0.5), (9, 5), (0, 5)))
        out, contact = curved((0, -3), 2.0, 0.0, 1.0, math.pi, [wall], STOP)
        np.testing.assert_allclose(out, (2 * math.sqrt(15 / 16), 2.5), atol=2e-7)
        assert contact
        # free end (0, 1): the chord from the contact to it is cut to its part along the wall
        out, contact = curved((0, -3), 2.0, 0.0, 1.0, math.pi, [wall], SLIDE)
        np.testing.assert_allclose(out, (0, 2.5), atol=4e-7)
        assert contact

    @pytest.mark.parametrize("speed", [0.5, -0.5])
    @pytest.mark.parametrize("turn", [0.0, -3.0, 0.4])
    def test_a_touching_unicycle_drives_away(self, speed, turn):
        """Tangentially: straight on, turning away, or on a wider circle than the disc's."""
        position, yaw = np.array([0.0, -1.0]), 0.0
        out, contact = curved(position, speed, yaw, turn * np.sign(speed), 0.5, [self.DISC])
        expected = arc(2, speed, yaw, 0.0, turn * np.sign(speed), 0.0, 0.5)
        assert tuple(out) == tuple(expected)
        assert not contact

    def test_outwards_is_free_whatever_the_turn(self):
        for yaw in np.linspace(-math.pi + 0.3, -0.3, 9):
            out, contact = curved((0, -1), 0.3, yaw, 0.5, 0.5, [self.DISC])
            assert np.linalg.norm(out) > 0.14
            assert not contact

    def test_circling_along_the_surface_keeps_its_pace(self):
        """A unicycle whose circle is the disc itself neither sinks in nor sticks."""
        position, yaw, duration = np.array([0.0, -1.0]), 0.0, 0.05
        for step in range(1, 41):
            out, contact = curved(position, 1.0, yaw, 1.0, duration, [self.DISC])
            position, yaw = position + out, yaw + duration
            assert not contact
            turned = duration * step
            np.testing.assert_allclose(position, (math.sin(turned), -math.cos(turned)), atol=1e-9)

    def test_pressing_into_a_surface_slides_on(self):
        """A tighter circle than the disc's makes contact, and still moves at nearly full speed."""
        out, contact = curved((0, -1), 1.0, 0.0, 1.5, 0.1, [self.DISC])
        assert contact
        assert 0.09 < np.linalg.norm(out) <= 0.1 + 1e-6
        out, contact = curved((0, -1), 1.0, 0.0, 1.5, 0.1, [self.DISC], STOP)
        assert contact
        assert np.linalg.norm(out) < 0.01

    def test_turning_on_the_spot_is_no_contact(self):
        out, contact = curved((0, -1), 0.0, 1.0, 30.0, 1.0, [self.DISC])
        assert tuple(out) == (0, 0)
        assert not contact

    def test_a_fast_spiral_in_space_does_not_pass_a_sphere(self):
        position = np.array([-3.0, 0.0, 0.0])
        inputs = (1000.0, 0.1, 0.2, 0.3, -0.4, 1.0)
        out, contact = move_one_curved(position, inputs, world([Sphere((0, 0, 0), 1.0)]), STOP)
        assert contact
        assert np.linalg.norm(position + out) == pytest.approx(1.0, abs=2e-7)
        assert out[0] < 3
