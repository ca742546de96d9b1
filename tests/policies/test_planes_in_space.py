"""Cones of space as intervals of a plane, and the tank rule that goes by them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.obstacle_rules.planes_in_space import (
    PASSABLE,
    headings_in_planes,
    kept_azimuth,
    lies_outside,
    widened_rays,
)
from baselines.obstacle_rules.turning_robots import FLAT
from rendezvous_env import Simulator
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.trajectory import run

X, Y, Z = np.eye(3)
SLAB = rv.scenarios.get("slab-3d")


def cone(centre, half_angle):
    """Eight boundary rays of a round cone."""
    centre = np.asarray(centre) / np.linalg.norm(centre)
    across = np.cross(centre, Z if abs(centre[2]) < 0.9 else X)
    across /= np.linalg.norm(across)
    rest = np.cross(centre, across)
    around = np.arange(8)[:, None] * math.pi / 4
    aside = np.cos(around) * across + np.sin(around) * rest
    return math.cos(half_angle) * centre + math.sin(half_angle) * aside


def azimuth(cones, before=(0.0, 0.0, 0.0), keeps=0.0, clearance=0.0):
    """The azimuth about the x axis, whether it was kept, and what its plane cuts of the cones."""
    silhouettes = np.array(cones)
    rays, cut = np.zeros_like(silhouettes), np.zeros((len(cones), 2, 2))
    seen = widened_rays(silhouettes, clearance, rays)
    views = rays[:seen], cut[:seen], np.zeros((seen, 2))
    aside, kept = kept_azimuth((1.0, 0.0, 0.0), tuple(before), keeps, clearance, views)
    return np.array(aside), kept, cut[:seen]


def angles(cut):
    return np.arctan2(cut[..., 1], cut[..., 0])


def test_a_plane_through_its_centre_cuts_a_cone_at_its_half_angle():
    _, kept, cut = azimuth([cone(X, 0.4)], before=Y, keeps=math.inf)
    assert kept
    # between rays the cone is taken to be flat: half angles from atan(tan 0.4 cos 22.5°) to 0.4
    assert angles(cut)[0, 0] == pytest.approx(0.39, abs=0.02)
    assert angles(cut)[0, 1] == pytest.approx(-0.39, abs=0.02)
    widened = azimuth([cone(X, 0.4)], before=Y, keeps=math.inf, clearance=0.1)[2]
    assert angles(widened)[0, 0] == pytest.approx(0.49, abs=0.02)


def test_a_plane_is_kept_while_what_is_free_there_is_near_enough():
    """A row of cones along y closes the plane of f and y on both sides, not that of f and z."""
    row = [cone((math.cos(a), math.sin(a), 0.0), 0.4) for a in (-1.2, -0.6, 0.0, 0.6, 1.2)]
    for keeps, stays in ((1.7, True), (1.4, False)):
        aside, kept, cut = azimuth(row, before=Y, keeps=keeps)
        assert kept == stays and (abs(aside @ np.array(Y)) > 0.99) == stays
    assert angles(cut).max() < 1.0


def test_a_plane_beside_its_centre_cuts_less_of_it_and_one_beyond_it_nothing():
    """cos ψ = cos θ / cos δ at the elevation δ of the centre above the plane."""
    seen = cone((math.cos(0.3), 0.0, math.sin(0.3)), 0.4)
    cut = azimuth([seen], before=Y, keeps=math.inf)[2]
    expected = math.acos(math.cos(0.4) / math.cos(0.3))
    assert angles(cut)[0] == pytest.approx([expected, -expected], abs=0.04)
    beyond = cone((math.cos(0.5), 0.0, math.sin(0.5)), 0.4)
    assert not azimuth([beyond], before=Y, keeps=math.inf)[2].any()


def test_the_azimuth_is_the_one_with_least_to_turn():
    """A cone whose nearest edge lies along y, and one that closes that way."""
    seen = cone((math.cos(0.3), -math.sin(0.3), 0.0), 0.4)
    aside, kept, _ = azimuth([seen], before=Z)
    assert not kept and aside @ Y > 0.9
    beside = cone((math.cos(0.6), math.sin(0.6), 0.0), 0.55)
    closed, _, _ = azimuth([seen, beside], before=Z)
    assert abs(closed @ Y) < 0.8


def test_a_kept_plane_that_is_closed_all_round_is_left():
    ring = [cone((math.cos(a), math.sin(a), 0.0), 0.7) for a in np.arange(6) * math.pi / 3]
    aside, kept, _ = azimuth(ring, before=Y, keeps=math.inf)
    assert not kept and abs(aside @ Z) > 0.7


def test_along_its_x_axis_there_is_an_azimuth_too():
    for cones in ([], [np.broadcast_to(X, (8, 3))]):
        aside, _, _ = azimuth(np.array(cones).reshape(-1, 8, 3))
        assert abs(aside @ X) < 1e-12 and np.linalg.norm(aside) == pytest.approx(1.0)


# ---- the tuned rule -----------------------------------------------------------------------------


def heading_of(cones, carried=(0.0, 0.0, 0.0), aside=(0.0, 0.0, 0.0), clearance=0.2):
    """Where the rule leads from f along the x axis, and the azimuth that it keeps to."""
    out, asides = np.zeros((1, 3)), np.array([aside], float)
    silhouettes = np.array(cones, float).reshape(1, -1, 8, 3)
    arguments = clearance, np.array([carried], float), 0.5, asides, out
    headings_in_planes(np.array([2.0 * X]), silhouettes, *arguments)
    return out[0], asides[0]


def test_the_tuned_rule_keeps_to_its_plane_and_side_while_something_is_before_f():
    """Of a cone to pass at −y the edge lies at 0.1 rad, widened by 0.1 within a clearance of 0.2;
    who has begun at +y goes on there, who keeps to z passes in that plane.
    """
    seen = [cone((math.cos(0.3), math.sin(0.3), 0.0), 0.4)]
    heading, aside = heading_of(seen)
    assert math.acos(heading[0]) == pytest.approx(0.1 + 0.1 + 0.2, abs=0.03) and heading[1] < -0.3
    again, kept = heading_of(seen, heading, aside)
    np.testing.assert_allclose([again, kept], [heading, aside], atol=1e-12)
    nearly = [cone((math.cos(0.1), math.sin(0.1), 0.0), 0.4)]
    stays, _ = heading_of(nearly, carried=[0.3, 0.95, 0.0], aside=Y)
    assert math.acos(stays[0]) == pytest.approx(0.5 + 0.1 + 0.2, abs=0.03) and stays[1] > 0.6
    above, kept = heading_of(seen, aside=Z)
    assert abs(above[2]) > 0.4 and above[1] == 0.0 and kept == pytest.approx(Z)
    free, forgotten = heading_of([cone(Y, 0.4)], aside=Z)
    np.testing.assert_array_equal([free, forgotten], [X, 0 * X])


def test_the_tuned_rule_leaves_a_plane_in_which_law_4_would_hardly_move_it():
    row = [cone((math.cos(a), math.sin(a), 0.0), 0.4) for a in (-1.2, -0.6, 0.0, 0.6, 1.2)]
    heading, aside = heading_of(row, aside=Y)
    assert math.acos(heading[0]) < PASSABLE and abs(aside @ Y) < 0.5


@pytest.mark.parametrize("field", ["slab-3d", "clutter-3d-96"])
def test_v_never_rises_under_the_tuned_rule(field):
    """Theorem C, until robots merge; and all that move keep the margin."""
    scenario = rv.scenarios.get(field).replace(time_limit=25.0, obstacle_contact="ignore")
    simulator, policy = Simulator(scenario, 24), baselines.make("tangent-joined-tuned", scenario)
    observations, before, checked, aside = simulator.reset(0), np.inf, 0, 0
    while (on := simulator.status == RUNNING).any():
        f = scenario.observation_layout.net_bearing(observations)
        active = simulator.active
        outcome = simulator.step(policy(observations, simulator.time))
        strength = np.linalg.norm(f, axis=-1)
        cosines = np.sum(policy.headings * f, axis=-1) / np.where(strength > 0.0, strength, 1.0)
        moving = active & on[:, None] & (strength > 2.0 * scenario.dead_zone)
        assert (cosines[moving] >= 0.05 - 1e-6).all()
        observations, now = outcome.observations, simulator.lyapunov()
        assert (now <= before * (1 + 1e-7)).all()
        before, checked = now, checked + int(moving.sum())
        aside += int((cosines[moving] < 0.5).sum())
    assert checked > 10_000 and aside > 500


def test_a_slab_is_rounded_by_the_tank_and_not_by_a_heading():
    met = {}
    for name in ("tangent-joined", "tank-joined"):
        simulator = Simulator(SLAB, 24)
        for _ in run(simulator, baselines.make(name, SLAB), simulator.reset(0)):
            pass
        met[name] = np.mean((simulator.status == RENDEZVOUS) & (simulator.contacts == 0))
    assert met["tangent-joined"] < 0.5 and met["tank-joined"] > 0.9


# ---- robots of space that turn ------------------------------------------------------------------

UAV = rv.scenarios.get("uav-clutter-16")


@pytest.mark.parametrize("half_angle", [0.05, 0.4, 0.77, 1.0, 1.4])
def test_widened_by_flat_eight_rays_hold_the_round_cone(half_angle):
    """Hardly more than it where the cone is widest between two rays."""
    for turn, share in ((0.0, 1.0), (math.pi / 8, 0.999)):
        rays = np.array([cone(X, half_angle)])
        out = np.zeros_like(rays)
        assert widened_rays(rays, FLAT, out) == 1
        first, second = rays[0, 0] - math.cos(half_angle) * X, rays[0, 2] - math.cos(half_angle) * X
        edge = math.cos(turn) * first + math.sin(turn) * second + math.cos(half_angle) * X
        inside = share * (edge - X) + X
        assert not lies_outside(tuple(inside), out)


@pytest.mark.parametrize("name", ["tangent-joined", "tangent-joined-tuned"])
def test_no_rule_drives_into_what_it_sees(name):
    """A sphere seen under half an angle θ about c is before an axis h with ∠(h, c) < θ."""
    simulator, policy = Simulator(UAV.replace(time_limit=30.0), 16), baselines.make(name, UAV)
    rested = drove = 0
    for step in run(simulator, policy, simulator.reset(0)):
        rays = UAV.observation_layout.split(step.observations).obstacles.astype(float)
        middles = rays.sum(axis=-2)
        lengths = np.linalg.norm(middles, axis=-1)
        within = middles[..., 0] > lengths**2 / 8 * (1 + 1e-4)  # cos ∠ > cos θ = ‖Σ rays‖/8
        before = (within & (lengths > 0.0)).any(axis=-1) & step.running[:, None]
        assert (step.actions[..., 0][before] == 0.0).all()
        rested += int(before.sum())
        drove += int((step.actions[..., 0] > 0.0).sum())
    assert rested > 500 and drove > 5000
    assert not simulator.contacts.any()
    assert np.mean(simulator.status == RENDEZVOUS) > 0.7


def test_a_direction_lies_outside_a_cone_or_within():
    rays = np.array([cone(X, 0.4)])
    for angle, outside in [(0.0, False), (0.35, False), (0.42, True), (math.pi, True)]:
        assert lies_outside((math.cos(angle), math.sin(angle), 0.0), rays) == outside
