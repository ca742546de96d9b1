"""Robots among capsules beside other obstacles: they stay outside, and what they see of them."""

from __future__ import annotations

import numpy as np
import pytest

from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator
from rendezvous_env.obstacles.obstacle_set import distance_to, pack, world_of

MIXED = (
    Capsule(((-2.0, 0.0), (2.0, 0.0)), 0.5),
    Polygon(((3.0, -1.0), (5.0, -1.0), (5.0, 2.0), (3.0, 2.0))),
    Disc((-4.0, 2.0), 1.0),
    Capsule(((0.0, 2.0), (2.0, 4.0)), 0.3),
)
AMONG = {"obstacles": MIXED, "local_frames": "global", "time_step": 0.1, "allow_long_step": True}


def test_random_walks_among_all_kinds_stay_outside():
    scenario = Scenario(n_robots=4, merge_radius=1e-3, max_speed=50.0, **AMONG)
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
