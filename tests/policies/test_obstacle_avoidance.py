"""Headings at obstacle edges, by hand and against a brute-force oracle over angles."""

import math

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import baselines
from baselines.obstacle_rules.obstacle_avoidance import (
    tangent_blocking_heading,
    tangent_heading,
    tangent_merged_heading,
)
from rendezvous_env.scenario.scenario import Scenario
from train.verify.monitors import unit

pytestmark = pytest.mark.kernels

CLEARANCE = 0.05
DEGREE = math.pi / 180
CLEAR = CLEARANCE / DEGREE
RULES = {
    "tangent": tangent_heading,
    "tangent-blocking": tangent_blocking_heading,
    "tangent-merged": tangent_merged_heading,
}


def polar(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def edges(*intervals, slots=6):
    """Silhouettes (slots, 2, 2) of intervals (clockwise, counter-clockwise edge) in degrees."""
    points = np.zeros((slots, 2, 2))
    for slot, (low, high) in enumerate(intervals):
        points[slot] = polar(np.radians([high, low]))
    return points


def ring(centre, half, towards=(1.0, 0.0, 0.0)):
    """Eight boundary rays of a cone; azimuth 0 points to the part of ``towards`` across."""
    centre = unit(np.array(centre, dtype=float))
    first = unit(towards - centre * (centre @ np.array(towards)))
    second, turn = np.cross(centre, first), np.arange(8)[:, None] * math.pi / 4
    return math.cos(half) * centre + math.sin(half) * (np.cos(turn) * first + np.sin(turn) * second)


@pytest.mark.parametrize(
    ("intervals", "literal", "blocking", "joined"),
    [
        ([], 0, 0, 0),
        ([(-10, 30)], -10, -10, -10 - CLEAR),
        ([(-30, 10)], 10, 10, 10 + CLEAR),
        ([(20, 70)], 20, 0, 0),  # beside the way
        ([(1, 70)], 1, 0, 1 - CLEAR),  # within the clearance
        ([(-70, -1)], -1, 0, -1 + CLEAR),
        ([(-10, 30), (60, 160)], 60, -10, -10 - CLEAR),  # the wide one is not in the way
        ([(-10, 30), (-40, -5)], -10, -10, 30 + CLEAR),  # joined: -40 … 30
        ([(-40, -5), (-10, 30)], -10, -10, 30 + CLEAR),
        ([(-10, 30), (25, 50), (45, 90)], 45, -10, -10 - CLEAR),
        ([(-20, 5), (1, 60), (-70, -10)], -10, 5, 60 + CLEAR),
        ([(-40, -1), (2, 40)], -1, 0, 0.5),  # a gap of 3°: its middle
        ([(-20, 5), (9, 60)], 9, 5, 7),  # a gap of 4° beside what is in the way
        ([(165, 190)], 165, 0, 0),  # behind
        ([(-60, 61), (50, 170), (160, 297)], -63, -60, -61.5),  # 3° free: its middle
        ([(-60, 61), (50, 200), (190, 310)], 50, -60, 0),  # nothing free
    ],
)
@pytest.mark.parametrize("tilt", [0, 100, 180, 275])
def test_planar_rules_match_hand_computation(intervals, literal, blocking, joined, tilt):
    points = edges(*((low + tilt, high + tilt) for low, high in intervals))
    f = 2 * polar(np.radians(tilt))
    for rule, expected in zip(RULES.values(), (literal, blocking, joined), strict=True):
        np.testing.assert_allclose(rule(f, points), polar(np.radians(expected + tilt)), atol=1e-9)


def by_brute_force(intervals, clearance, samples=7200):
    """Merged-interval rule about f = 0 on a fine grid of directions.

    Walk from f both ways through covered directions; an edge is where the cover ends. Returns the
    angle of the heading, or None if the grid is too coarse to tell.
    """
    step = math.tau / samples
    grid = step * np.arange(samples)
    covered = np.zeros(samples, bool)
    for low, high in intervals:
        covered |= (grid - low) % math.tau <= high - low
    if covered.all() or not covered.any():
        return 0.0
    at = 0
    if not covered[0]:
        ahead, behind = int(np.argmax(covered)), int(np.argmax(covered[::-1])) + 1
        if abs(ahead - behind) <= 2:
            return None
        at = ahead if ahead < behind else -behind
        if abs(abs(at) * step - clearance) < 2 * step:
            return None
        if abs(at) * step > clearance:
            return 0.0
    up, down = (next(k for k in range(samples) if not covered[(at + s * k) % samples])
                for s in (1, -1))  # fmt: skip
    high, low = (at + up) * step, (at - down) * step
    if abs(abs(high) - abs(low)) < 4 * step:
        return None
    side, edge, last = (1, high, at + up) if abs(high) < abs(low) else (-1, low, at - down)
    gap = next(k for k in range(1, samples + 1) if covered[(last + side * k) % samples]) * step
    return edge + side * min(clearance, gap / 2)


def test_merged_interval_rule_matches_brute_force():
    random = np.random.default_rng(11)
    compared = turned = 0
    for _ in range(1000):
        count, widest = random.integers(0, 9), random.choice([0.3, 1.0, 2.5])
        low = random.uniform(-math.pi, math.pi, count)
        high = low + random.uniform(0.02, widest, count)
        points = np.zeros((10, 2, 2))
        slots = random.permutation(10)[:count]
        points[slots] = np.stack([polar(high), polar(low)], axis=1)
        tilt = random.uniform(-math.pi, math.pi)
        c, s = polar(tilt)
        points = points @ np.array([[c, s], [-s, c]])
        heading = tangent_merged_heading(polar(tilt), points, clearance=CLEARANCE)
        expected = by_brute_force(list(zip(low, high, strict=True)), CLEARANCE)
        if expected is None:
            continue
        compared += 1
        turned += expected != 0
        np.testing.assert_allclose(heading, polar(tilt + expected), atol=0.004)
    assert compared > 850 and turned > 300


def test_rules_in_3d_match_hand_computation():
    """A blocking cone, passed at its edge nearest to f, and a wider one next to it."""
    f, beside, offset, half = np.array([1.0, 0, 0]), ring([0, 0, 1], 0.7), math.atan(0.2), 0.5
    points = np.zeros((4, 8, 3))
    points[0] = ring([1, 0.2, 0], half)
    leave, wider = ([*polar(offset - half - more), 0.0] for more in (0.0, CLEARANCE))
    up = [math.sin(0.7), 0.0, math.cos(0.7)]
    for there, expected in ((0 * beside, (leave, leave, wider)), (beside, (up, leave, wider))):
        points[1] = there
        for rule, heading in zip(RULES.values(), expected, strict=True):
            np.testing.assert_allclose(rule(f, points), heading, atol=1e-12)
    for rule in (tangent_blocking_heading, tangent_merged_heading):
        np.testing.assert_array_equal(rule(f, np.stack([beside, 0 * beside])), f)


def test_merged_cone_rule_takes_nearest_free_direction():
    """Candidate rays of each cone that overlaps the blocking one, directly or through others."""
    random = np.random.default_rng(2)
    left = through = 0
    for _ in range(400):
        f, count = random.normal(size=3), random.integers(1, 16)
        towards = f / np.linalg.norm(f)
        centres = unit(towards + 0.5 * random.normal(size=(count, 3)))
        halves = random.uniform(0.1, 0.5, count)
        at_start = np.arccos(centres @ towards) - halves
        overlap = np.arccos(np.clip(centres @ centres.T, -1, 1)) < halves + halves[:, None]
        groups = connected_components(overlap)[1]
        rays = np.stack([ring(c, a + CLEARANCE, towards)
                         for c, a in zip(centres, halves, strict=True)])  # fmt: skip
        others = ~np.eye(count, dtype=bool)[:, None]
        free = ~((rays @ centres.T > np.cos(halves)) & others).any(axis=-1)
        free &= (groups == groups[at_start.argmin()])[:, None]
        nearest = np.where(free, rays @ towards, -2.0)
        points = np.stack([ring(c, a, towards) for c, a in zip(centres, halves, strict=True)])
        heading = tangent_merged_heading(f, points)
        if at_start.min() >= CLEARANCE or not free.any():
            np.testing.assert_allclose(heading, towards, atol=1e-12)
            continue
        assert heading @ towards == pytest.approx(nearest.max(), abs=1e-9)  # rays lie in pairs
        assert np.linalg.norm(rays[free] - heading, axis=-1).min() < 1e-9
        left += 1
        through += not overlap[at_start.argmin(), nearest.argmax() // rays.shape[1]]
    assert left > 100 and through > 5


@pytest.mark.parametrize("dim", [2, 3])
def test_touching_robot_leaves_along_f_without_pressing(dim):
    """Its silhouette is half of all directions, and opposite points sum to zero."""
    random = np.random.default_rng(3)
    axes = [*np.eye(dim), *-np.eye(dim)]
    for towards in [*axes, *unit(random.normal(size=(40, dim)))]:
        along = np.roll(towards, 1) - towards * (np.roll(towards, 1) @ towards)
        f = random.normal() * along - random.uniform(0.1, 2.0) * towards
        if dim == 2:
            left = np.array([-towards[1], towards[0]], np.float32)
            points = np.stack([left, -left])[None] + np.float32(0)  # as observations, never −0
        else:
            points = ring(towards, math.pi / 2, f).astype(np.float32)[None]
        for rule, clear in ((tangent_blocking_heading, 0.0), (tangent_merged_heading, CLEARANCE)):
            away, into = rule(f, points), rule(-f, points)
            if f @ towards < -np.linalg.norm(f) * math.sin(clear):
                np.testing.assert_allclose(away, f / np.linalg.norm(f), atol=1e-12)
            assert into @ towards == pytest.approx(-math.sin(clear), abs=1e-6)
            assert np.linalg.norm(into) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("swapped", [-0.1, -1e-7, 1e-7, 0.1])
def test_touched_obstacle_with_swapped_edges_still_blocks(swapped):
    """From rounding or sensor errors: the obstacle at +x covers about half of all directions."""
    angles = 0.5 * math.pi * np.array([1.0, -1.0]) + 0.5 * swapped * np.array([1.0, -1.0])
    points = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[None]
    heading = tangent_merged_heading(np.array([1.0, 0.3]), points, clearance=CLEARANCE)
    assert heading[0] == pytest.approx(-math.sin(CLEARANCE + 0.5 * swapped), abs=1e-6)


CLUTTER = Scenario(n_robots=4, obstacle_slots=6, time_step=0.05, allow_long_step=True)
LAYOUT = CLUTTER.observation_layout


def team_view(random, leading):
    """Random observations: unit neighbour rows and some obstacles."""
    observations = np.zeros((*leading, CLUTTER.n_robots, *LAYOUT.shape), np.float32)
    shape = (*leading, CLUTTER.n_robots)
    observations[..., LAYOUT.neighbours, :] = polar(random.uniform(-4, 4, (*shape, 3)))
    low = random.uniform(-4, 4, (*shape, 6))
    both = np.stack([polar(low + random.uniform(0.1, 1, low.shape)), polar(low)], axis=-2)
    both *= (random.random(low.shape) < 0.6)[..., None, None]
    observations[..., LAYOUT.obstacles, :] = both.reshape(*shape, 12, 2)
    return observations


@pytest.mark.parametrize("name", RULES)
def test_velocities_follow_law_4(name):
    observations = team_view(np.random.default_rng(4), (5,))
    f = LAYOUT.net_bearing(observations)
    h = RULES[name](f, LAYOUT.split(observations).obstacles)
    found = baselines.make(name, CLUTTER)(observations, 0.0)
    np.testing.assert_allclose(found, h * np.sum(h * f, -1, keepdims=True), atol=1e-6)


@pytest.mark.parametrize("name", RULES)
def test_certified_forms_keep_margin_and_turn_limit(name):
    random = np.random.default_rng(6)
    policy = baselines.make(f"{name}-certified", CLUTTER, min_alignment=0.3, max_turn_rate=2.0)
    observations = team_view(random, (8,))
    f = LAYOUT.net_bearing(observations)
    strength = np.linalg.norm(f, axis=-1)
    needed = 0.3 * np.clip(strength / CLUTTER.dead_zone - 1, 0, 1) * strength
    before = None
    for _ in range(30):
        view = team_view(random, (8,))  # obstacles flicker, the neighbours stay
        view[..., LAYOUT.neighbours, :] = observations[..., LAYOUT.neighbours, :]
        velocities = policy(view, 0.0)
        h = policy.headings
        assert (np.sum(h * f, axis=-1) >= needed - 1e-12).all()
        if before is not None:
            assert (np.sum(h * before, axis=-1) >= math.cos(2.0 * 0.05) - 1e-12).all()
        before = h
    scale = min(1.0, 0.2 / (2 * 3 * 0.05))  # three unit rows: D = 3 m/s
    np.testing.assert_allclose(velocities, scale * h * np.sum(h * f, -1, keepdims=True), atol=1e-6)


def test_certified_forms_flip_heading_to_f():
    view = np.zeros((4, *LAYOUT.shape), np.float32)
    view[:, 0] = [1, 0]
    view[:, LAYOUT.obstacles] = edges((165, 190)).reshape(12, 2)
    policy = baselines.make("tangent-certified", CLUTTER)
    for _ in range(3):
        policy(view, 0.0)
    np.testing.assert_allclose(policy.headings, np.tile(polar(-15 * DEGREE), (4, 1)), atol=1e-6)
