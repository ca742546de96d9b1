"""Cones in 3-D as intervals of a plane, and the tuned rule for them."""

import math

import numpy as np
import pytest
from test_obstacle_avoidance import ring

from baselines.obstacle_rules.obstacle_avoidance import FLAT
from baselines.obstacle_rules.planes_in_space import (
    PASSABLE,
    headings_in_planes,
    kept_azimuth,
    lies_outside,
    widened_rays,
)
from train.verify.monitors import unit

pytestmark = pytest.mark.kernels

X, Y, Z = np.eye(3)
NONE = (0.0, 0.0, 0.0)


def at(yaw, elevation=0.0):
    """Unit vector from angles, rad."""
    level = math.cos(elevation)
    return np.array([level * math.cos(yaw), level * math.sin(yaw), math.sin(elevation)])


def cone(centre, half_angle):
    """Eight boundary rays of a round cone."""
    return ring(centre, half_angle, np.cross(centre, Z if abs(centre[2]) < 0.9 else X))


ROW = [cone(at(yaw), 0.4) for yaw in (-1.2, -0.6, 0.0, 0.6, 1.2)]
"""Obstacle along y, which blocks both sides of the plane of f and y, not that of f and z."""


def azimuth(cones, before=NONE, keeps=0.0, clearance=0.0):
    """Azimuth about the x axis, whether it was kept, and edges, rad.

    The edges are intersections of the plane with the cones; (0, 0) without one.
    """
    silhouettes = np.array(cones)
    rays, cut = np.zeros_like(silhouettes), np.zeros((len(cones), 2, 2))
    seen = widened_rays(silhouettes, clearance, rays)
    views = rays[:seen], cut[:seen], np.zeros((seen, 2))
    aside, kept = kept_azimuth((1.0, 0.0, 0.0), tuple(before), keeps, clearance, views)
    return np.array(aside), kept, np.arctan2(cut[:seen, :, 1], cut[:seen, :, 0])


def test_plane_cuts_cone_within_half_angle():
    """Between rays a cone is flat: half angles from atan(tan 0.4 cos 22.5°) to 0.4.

    At the elevation δ of the centre above the plane cos ψ = cos θ / cos δ; beyond the cone there is
    no intersection.
    """
    for elevation, clearance, half in (
        (0.0, 0.0, 0.39), (0.0, 0.1, 0.49), (0.3, 0.0, math.acos(math.cos(0.4) / math.cos(0.3))),
        (0.5, 0.0, 0.0),
    ):  # fmt: skip
        seen = cone(at(0.0, elevation), 0.4)
        _, kept, edges = azimuth([seen], before=Y, keeps=math.inf, clearance=clearance)
        assert kept and edges[0] == pytest.approx([half, -half], abs=0.04 if elevation else 0.02)


def test_plane_is_kept_while_free_direction_is_near():
    for keeps, stays in ((1.7, True), (1.4, False)):
        aside, kept, edges = azimuth(ROW, before=Y, keeps=keeps)
        assert kept == stays and (abs(aside @ Y) > 0.99) == stays
    assert edges.max() < 1.0
    ring = [cone(at(yaw), 0.7) for yaw in np.arange(6) * math.pi / 3]  # closed all round
    aside, kept, _ = azimuth(ring, before=Y, keeps=math.inf)
    assert not kept and abs(aside @ Z) > 0.7


def test_azimuth_minimises_turn():
    """A cone with its nearest edge along y, and one that blocks that direction."""
    seen = cone(at(-0.3), 0.4)
    aside, kept, _ = azimuth([seen], before=Z)
    assert not kept and aside @ Y > 0.9
    closed, _, _ = azimuth([seen, cone(at(0.6), 0.55)], before=Z)
    assert abs(closed @ Y) < 0.8
    for cones in ([], [np.broadcast_to(X, (8, 3))]):  # along its x axis there is one too
        aside, _, _ = azimuth(np.array(cones).reshape(-1, 8, 3))
        assert abs(aside @ X) < 1e-12 and np.linalg.norm(aside) == pytest.approx(1.0)


@pytest.mark.parametrize("half_angle", [0.05, 0.4, 0.77, 1.0, 1.4])
def test_widened_eight_rays_contain_cone(half_angle):
    """Slightly larger than the round cone where it is widest between two rays."""
    for turn, share in ((0.0, 1.0), (math.pi / 8, 0.999)):
        rays = np.array([cone(X, half_angle)])
        out = np.zeros_like(rays)
        assert widened_rays(rays, FLAT, out) == 1
        first, second = (rays[0, k] - math.cos(half_angle) * X for k in (0, 2))
        edge = math.cos(turn) * first + math.sin(turn) * second + math.cos(half_angle) * X
        assert not lies_outside(tuple(share * (edge - X) + X), out)


def test_lies_outside_matches_geometry():
    rays = np.array([cone(X, 0.4)])
    for angle, outside in [(0.0, False), (0.35, False), (0.42, True), (math.pi, True)]:
        assert lies_outside(tuple(at(angle)), rays) == outside


def heading_of(cones, carried=NONE, aside=NONE):
    """Heading of the tuned rule for f along the x axis, and its kept azimuth."""
    out, asides = np.zeros((1, 3)), np.array([aside], float)
    silhouettes = np.array(cones, float).reshape(1, -1, 8, 3)
    arguments = 0.2, np.array([carried], float), 0.5, asides, out
    headings_in_planes(np.array([2.0 * X]), silhouettes, *arguments)
    return out[0], asides[0]


@pytest.mark.slow
def test_tuned_rule_keeps_plane_and_side_while_blocked():
    """The edge of a cone is at 0.1 rad on the side −y, widened by 0.1 with a clearance of 0.2.

    A robot that started at +y stays on that side, and one that keeps z passes in that plane.
    """
    seen = [cone(at(0.3), 0.4)]
    heading, aside = heading_of(seen)
    assert math.acos(heading[0]) == pytest.approx(0.1 + 0.1 + 0.2, abs=0.03) and heading[1] < -0.3
    again, kept = heading_of(seen, heading, aside)
    np.testing.assert_allclose([again, kept], [heading, aside], atol=1e-12)
    stays, _ = heading_of([cone(at(0.1), 0.4)], carried=[0.3, 0.95, 0.0], aside=Y)
    assert math.acos(stays[0]) == pytest.approx(0.5 + 0.1 + 0.2, abs=0.03) and stays[1] > 0.6
    above, kept = heading_of(seen, aside=Z)
    assert abs(above[2]) > 0.4 and above[1] == 0.0 and kept == pytest.approx(Z)
    free, forgotten = heading_of([cone(Y, 0.4)], aside=Z)
    np.testing.assert_array_equal([free, forgotten], [X, 0 * X])
    heading, aside = heading_of(ROW, aside=Y)  # where law (4) would hardly move it
    assert math.acos(heading[0]) < PASSABLE and abs(aside @ Y) < 0.5


def test_robot_touching_sphere_leaves_without_pressing():
    """Eight rays in a plane sum to zero up to rounding."""
    random = np.random.default_rng(4)
    for centre in unit(random.normal(size=(60, 3))):
        rays = cone(centre, math.pi / 2).astype(np.float32)[None]
        seen = np.zeros(rays.shape)
        widened_rays(rays, 0.1, seen)
        assert lies_outside(tuple(-centre), seen) and not lies_outside(tuple(centre), seen)
        out, asides = np.zeros((1, 3)), np.zeros((1, 3))
        silhouettes = rays[None].astype(float)
        for f in (-centre, centre + 0.5 * np.cross(centre, X)):
            headings_in_planes(f[None], silhouettes, 0.2, np.zeros((1, 3)), 0.5, 0 * asides, out)
            if f @ centre < 0:
                np.testing.assert_allclose(out[0], f, atol=1e-12)
            else:
                assert -0.21 < out[0] @ centre < -0.15  # out by the clearance, in its plane
