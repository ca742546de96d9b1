"""Robots among capsules: contacts in all modes, no tunnelling, what they see of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import baselines
from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator
from rendezvous_env.obstacles.obstacle_set import distance_to, pack, world_of

BAR = Capsule(((-2.0, 0.0), (2.0, 0.0)), 0.5)
BEAM = Capsule(((-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 0.5)
MIXED = (
    BAR,
    Polygon(((3.0, -1.0), (5.0, -1.0), (5.0, 2.0), (3.0, 2.0))),
    Disc((-4.0, 2.0), 1.0),
    Capsule(((0.0, 2.0), (2.0, 4.0)), 0.3),
)


def team(**changes: object) -> Scenario:
    given = {"n_robots": 2, "obstacles": (BAR,), "local_frames": "global", "time_step": 0.1}
    return Scenario(**given | {"max_speed": 50.0, "time_limit": 100.0} | changes)


def one_step(scenario: Scenario, start, velocity):
    """Where a step leads robot 0 to, and whether it touched anything."""
    sim = Simulator(scenario)
    sim.reset(0, {"positions": [start, [40.0] * scenario.dim]})
    out = sim.step([[velocity, [0.0] * scenario.dim]])
    return sim.positions[0, 0], bool(out.contact[0, 0])


@pytest.mark.parametrize(
    ("mode", "end", "touched"),
    [("slide", (2.0, 0.5), True), ("stop", (0.5, 0.5), True), ("ignore", (2.0, -1.0), False)],
)
def test_contact_modes_by_hand(mode, end, touched):
    """From (0, 1) towards (2, −1): the bar's flat side is met at (0.5, 0.5)."""
    found, contact = one_step(team(obstacle_contact=mode), (0.0, 1.0), (20.0, -20.0))
    np.testing.assert_allclose(found, end, atol=1e-6)
    assert contact == touched
    solid = team(dim=3, obstacles=(BEAM,), obstacle_contact=mode)
    found, contact = one_step(solid, (0.0, 0.0, 1.0), (20.0, 0.0, -20.0))
    np.testing.assert_allclose(found, (end[0], 0.0, end[1]), atol=1e-6)
    assert contact == touched


@pytest.mark.parametrize("mode", ["slide", "stop"])
def test_nobody_tunnels_through_a_thin_one(mode):
    """50 m/s against a bar of 1 mm, square on: 5 m in a step."""
    thin = Capsule(((-2.0, 0.0), (2.0, 0.0)), 0.001)
    end, contact = one_step(
        team(obstacles=(thin, MIXED[1]), obstacle_contact=mode), (0.0, 2.0), (0.0, -50.0)
    )
    assert contact and end == pytest.approx((0.0, 0.001), abs=1e-9)


def test_leaving_and_gliding_along_are_no_contacts():
    for velocity in ((10.0, 0.0), (0.0, 10.0), (-3.0, 2.0)):
        end, contact = one_step(team(), (0.0, 0.5), velocity)
        assert not contact
        np.testing.assert_allclose(end, np.array((0.0, 0.5)) + 0.1 * np.array(velocity))


def test_random_walks_among_all_kinds_stay_outside():
    scenario = team(n_robots=4, obstacles=MIXED, merge_radius=1e-3, allow_long_step=True)
    sim, random = Simulator(scenario, 4), np.random.default_rng(0)
    sim.reset(0)
    world, touched = world_of(pack(MIXED, 4)), 0
    for _ in range(150):
        pull = -5 * sim.positions
        out = sim.step(pull + random.normal(0, 20, (4, 4, 2)))
        touched += out.contact.sum()
        for (x, y), clearance, active in zip(
            sim.positions.reshape(-1, 2), out.clearance.flat, sim.active.flat, strict=True
        ):
            if active:
                nearest = min(distance_to(world, m, (x, y, 0.0)) for m in range(4))
                assert nearest >= -1e-9
                assert clearance == pytest.approx(nearest, abs=1e-12)
    assert touched > 100


def test_what_is_seen_beside_other_kinds():
    """A bar seen from its end: both edges touch the round end."""
    scenario = team(obstacles=MIXED, obstacle_range=0.6)
    sim = Simulator(scenario)
    sim.reset(0, {"positions": [[-3.0, 0.0], [40.0, 0.0]]})
    seen = scenario.observation_layout.split(sim.observe()).obstacles[0, 0]
    angle = math.asin(0.5)
    np.testing.assert_allclose(seen[0, 0], (math.cos(angle), 0.5), atol=1e-6)
    np.testing.assert_allclose(seen[0, 1], (math.cos(angle), -0.5), atol=1e-6)
    assert (seen[1:] == 0).all()  # farther than the range


@pytest.mark.parametrize("name", ["tangent", "tangent-blocking", "tangent-joined"])
def test_avoidance_rules_find_their_way_round_one(name):
    scenario = Scenario(n_robots=2, obstacles=(BAR, MIXED[1]), time_limit=40.0)
    start = {"positions": [[-1.0, 2.5], [0.5, -2.5]]}
    sim, policy = Simulator(scenario), baselines.make(name, scenario)
    seen = sim.reset(0, start)
    while not sim.ended[0]:
        seen = sim.step(policy(seen, sim.time)).observations
    assert sim.status[0] == 1 and sim.min_clearance[0] >= -1e-9


def test_the_joined_rule_finds_its_way_round_a_beam():
    scenario = Scenario(n_robots=2, dim=3, obstacles=(BEAM,), time_limit=40.0)
    sim, policy = Simulator(scenario), baselines.make("tangent-joined", scenario)
    seen = sim.reset(0, {"positions": [[0.3, 0.1, 2.5], [-0.2, 0.0, -2.5]]})
    while not sim.ended[0]:
        seen = sim.step(policy(seen, sim.time)).observations
    assert sim.status[0] == 1 and sim.contacts[0] == 0
