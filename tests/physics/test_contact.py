"""Motion among obstacles: contacts computed by hand."""

import math

import numpy as np
import pytest
from geometry import arc, triple, world

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
from rendezvous_env.robots.nonholonomic_3d import Nonholonomic3D, body_frame_3d
from rendezvous_env.robots.unicycle import Unicycle, body_frame_2d

pytestmark = pytest.mark.kernels

MICRON, HALF = 1e-6, math.sqrt(0.5)
WALL = Polygon(((-20, 0), (20, 0), (20, 2), (-20, 2)))  # free below y = 0
FLOOR, UPWARDS = Polygon(((-9, -1), (9, -1), (9, 0), (-9, 0))), Polygon(((0, 0), (9, -1), (9, 9)))
DOWNWARDS = Polygon(((4, 0), (14, -10), (14, 10), (4, 10)))
SPHERES = [Sphere((0, 1, 0), 2**0.5), Sphere((0, -1, 0), 2**0.5), Sphere((1, 0, 1), 1.0)]


def move_one_straight(start, displacement, scene, mode):
    """Executed displacement (d,) and contact of one straight motion in a world."""
    normals = np.empty((2 * len(scene.kinds), 3))
    contact, moved = move_straight(triple(start), triple(displacement), scene, mode, normals)
    return np.array(moved)[: len(start)], contact


def move_one_curved(start, inputs, scene, mode):
    """The same for inputs v, yaw, pitch, their rates and the duration."""
    speed, yaw, pitch, yaw_rate, pitch_rate, duration = map(float, inputs)
    if len(start) == 2:
        model = Unicycle(duration, abs(speed), abs(yaw_rate))
        action, frame, memory = (speed, yaw_rate), body_frame_2d(yaw), (yaw,)
    else:
        model = Nonholonomic3D(duration, abs(speed), abs(yaw_rate), abs(pitch_rate))
        action, memory = (speed, yaw_rate, pitch_rate), (yaw, pitch)
        frame = body_frame_3d(yaw, pitch)
    way, normals = triple(arc(len(start), *inputs)), np.empty((2 * len(scene.kinds), 3))
    contact, moved = move_curved(
        triple(start), way, model, action, frame, memory, scene, mode, normals
    )
    return np.array(moved)[: len(start)], contact


def straight(position, displacement, obstacles, mode=SLIDE):
    """End point and contact of one straight motion; one slot is empty."""
    scene = world(obstacles, len(obstacles) + 1)
    moved, contact = move_one_straight(position, displacement, scene, mode)
    return np.array(position, dtype=float) + moved, contact


def curved(position, speed, yaw, yaw_rate, duration, obstacle, mode=SLIDE):
    """Displacement and contact of one unicycle motion; one slot is empty."""
    inputs = speed, yaw, 0.0, yaw_rate, 0.0, duration
    return move_one_curved(position, inputs, world([obstacle], 2), mode)


class TestStraightByHand:
    """A disc of radius 1 at (3, 0) and a wall with its face on y = 0, robots below it."""

    DISC = Disc((3, 0), 1)

    @pytest.mark.parametrize(
        ("start", "displacement", "obstacle", "mode", "end", "contact"),
        [
            ((0, 0), (5, 0), DISC, SLIDE, (2, 0), True),  # head on
            ((0, 0), (5, 0), DISC, STOP, (2, 0), True),
            ((0, 0), (5, 0), DISC, IGNORE, (5, 0), False),
            # it meets the disc at (3, 1) + (−s, −s), s = √½, and leaves along (1, 1)/√2
            ((0, HALF), (5, 0), DISC, SLIDE, (4 - HALF / 2, 1 + 1.5 * HALF), True),
            ((0, -1), (4, 4), WALL, SLIDE, (4, 0), True),  # diagonally
            ((0, -1), (4, 4), WALL, STOP, (1, 0), True),
            ((0, -1), (4, 4), WALL, IGNORE, (4, 3), False),
            ((0.1, 0), (1, 1), WALL, STOP, (0.1, 0), True),  # inward at the surface
            ((0.1, 0), (1, 1), WALL, SLIDE, (1.1, 0), True),
            ((14, -1), (10, 2), WALL, SLIDE, (24, 0), True),  # past the end of an edge
        ],
    )
    def test_straight_motion_against_disc_and_wall(
        self, start, displacement, obstacle, mode, end, contact
    ):
        found, touched = straight(start, displacement, [obstacle], mode)
        np.testing.assert_allclose(found, end, atol=1e-12)
        assert touched == contact

    @pytest.mark.parametrize("mode", [SLIDE, STOP])
    def test_motion_along_or_away_from_surface_is_free(self, mode):
        for x, obstacle, ways in (
            (0.1, WALL, ((1, 0), (-1, 0), (1, -1), (0, -3))),
            (2.0, self.DISC, ((0, 1), (0, -1), (-1, 1), (-1, -1))),
        ):
            for way in ways:
                end, contact = straight((x, 0), way, [obstacle], mode)
                assert tuple(end) == (x + way[0], way[1]) and not contact

    @pytest.mark.parametrize(
        ("depth", "contact"), [(0.99e-6, False), (1.01e-6, True), (-1e-9, False)]
    )
    def test_contact_tolerance_is_one_micron(self, depth, contact):
        across = straight((-1, 1 - depth), (8, 0), [self.DISC])
        assert across[1] == contact
        if not contact:
            assert tuple(across[0]) == (7, 1 - depth)
        end, touched = straight((-1, -1), (2, 1 + depth), [WALL])
        assert touched == contact
        if not contact:
            np.testing.assert_allclose(end, (1, min(0, depth)), atol=1e-12)

    def test_slow_robot_never_sinks_into_surface(self):
        position = np.array([0.0, 0.0])
        for _ in range(50):
            position, contact = straight(position, (0.01, 0.5e-6), [WALL])
            assert not contact
        np.testing.assert_allclose(position, (0.5, 0), atol=1e-12)

    @pytest.mark.parametrize("opening", [10, 60, 90, 120, 170])
    def test_robot_stops_in_corner(self, opening):
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

    @pytest.mark.parametrize(
        ("start", "displacement", "obstacles", "end", "atol"),
        [
            # in an obtuse corner it slides from one wall onto the other
            ((-1, 0), (3, -1e-3), [FLOOR, UPWARDS], [1 - 1e-3 / 3] * 2, 1e-6),
            # a quarter of the way to the wall, a third of the rest along that, half of (2, −2)
            ((0, -1), (8, 4), [WALL, DOWNWARDS], (5, -1), 1e-5),
            # between two spheres along the common tangent, which a third one may close
            ((1, 0, 0), (-1, 0, 0.3), SPHERES[:2], (1, 0, 0.3), 1e-9),
            ((1, 0, 0), (-1, 0, 0.3), SPHERES, (1, 0, 0), 1e-9),
        ],
    )
    def test_motion_between_obstacles_uses_remaining_path(
        self, start, displacement, obstacles, end, atol
    ):
        found, contact = straight(start, displacement, obstacles)
        np.testing.assert_allclose(found, end, atol=atol)
        assert contact

    def test_no_speed_tunnels_through_obstacle(self):
        thin = Polygon(((-50, 0), (50, 0), (50, 1e-3), (-50, 1e-3)))
        for length in (1e-2, 1, 1e3, 1e6):
            for start, way, obstacle, wanted in (
                ((0.3, -1e-3), (0, length), thin, (0.3, 0)),
                ((-1, 0.1), (length + 2, 0), Disc((0, 0.1), 1e-3), (-1e-3, 0.1)),
            ):
                end, contact = straight(start, way, [obstacle])
                np.testing.assert_allclose(end, wanted, atol=1e-9)
                assert contact


def half_plane(angle, left=True):
    """Large block with an edge on the ray at an angle from the origin, free on one side."""
    along = 50 * np.array([math.cos(angle), math.sin(angle)])
    across = np.array([along[1], -along[0]]) * (1 if left else -1)
    corners = [-along, along, along + across, -along + across]
    return Polygon(tuple(map(tuple, corners)))


class TestCurvedByHand:
    DISC, BLOCK = Disc((0, 0), 1), Polygon(((0, -0.5), (9, -0.5), (9, 5), (0, 5)))

    # a quarter circle of radius 2 about (0, −1) starts at (0, −3) to the right and meets y = −0.5
    # at sin φ = 1/4; its free end is (0, 1), and the chord to it is cut to its part along the wall
    @pytest.mark.parametrize(
        ("start", "turn", "obstacle", "mode", "way", "contact"),
        [
            ((-3, 0), 0.0, DISC, SLIDE, (2, 0), True),
            ((-3, 0), 0.0, DISC, STOP, (2, 0), True),
            ((-3, 0), 0.0, DISC, IGNORE, (2 * math.pi, 0), False),
            ((0, -3), 1.0, BLOCK, STOP, (2 * math.sqrt(15 / 16), 2.5), True),
            ((0, -3), 1.0, BLOCK, SLIDE, (0, 2.5), True),
        ],
    )
    def test_curved_motion_matches_hand_computation(
        self, start, turn, obstacle, mode, way, contact
    ):
        out, touched = curved(start, 2.0, 0.0, turn, math.pi, obstacle, mode)
        np.testing.assert_allclose(out, way, atol=4e-7 if turn else 1e-12)
        assert touched == contact

    @pytest.mark.parametrize("speed", [0.5, -0.5])
    @pytest.mark.parametrize("turn", [0.0, -3.0, 0.4])
    def test_touching_unicycle_drives_away(self, speed, turn):
        """Tangential motion: straight, turning away, or on a wider circle than the disc's."""
        position, yaw = np.array([0.0, -1.0]), 0.0
        out, contact = curved(position, speed, yaw, turn * np.sign(speed), 0.5, self.DISC)
        expected = arc(2, speed, yaw, 0.0, turn * np.sign(speed), 0.0, 0.5)
        assert tuple(out) == tuple(expected) and not contact

    def test_turning_outwards_or_in_place_is_free(self):
        for yaw in np.linspace(-math.pi + 0.3, -0.3, 9):
            out, contact = curved((0, -1), 0.3, yaw, 0.5, 0.5, self.DISC)
            assert np.linalg.norm(out) > 0.14 and not contact
        out, contact = curved((0, -1), 0.0, 1.0, 30.0, 1.0, self.DISC)
        assert tuple(out) == (0, 0) and not contact

    def test_circling_along_surface_keeps_pace(self):
        """A unicycle on the circle of the disc neither penetrates nor sticks."""
        position, yaw, duration = np.array([0.0, -1.0]), 0.0, 0.05
        for step in range(1, 41):
            out, contact = curved(position, 1.0, yaw, 1.0, duration, self.DISC)
            position, yaw = position + out, yaw + duration
            assert not contact
            turned = duration * step
            np.testing.assert_allclose(position, (math.sin(turned), -math.cos(turned)), atol=1e-9)

    def test_pressing_unicycle_slides(self):
        """A tighter circle than the disc's causes contact, at nearly full speed."""
        for mode, least, most in ((SLIDE, 0.09, 0.1 + 1e-6), (STOP, 0.0, 0.01)):
            out, contact = curved((0, -1), 1.0, 0.0, 1.5, 0.1, self.DISC, mode)
            assert contact and least <= np.linalg.norm(out) <= most

    def test_fast_spiral_does_not_pass_sphere(self):
        position = np.array([-3.0, 0.0, 0.0])
        inputs = (1000.0, 0.1, 0.2, 0.3, -0.4, 1.0)
        out, contact = move_one_curved(position, inputs, world([Sphere((0, 0, 0), 1.0)]), STOP)
        assert contact
        assert np.linalg.norm(position + out) == pytest.approx(1.0, abs=2e-7)
        assert out[0] < 3
