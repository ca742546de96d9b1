"""Robots among capsules beside other obstacles: they stay outside, and what they see of them."""

from __future__ import annotations

import numpy as np
import pytest
from test_inertia import clearance

from rendezvous_env import Capsule, Disc, Polygon, Scenario, Simulator

MIXED = (
    Capsule(((-2.0, 0.0), (2.0, 0.0)), 0.5),
    Polygon(((3.0, -1.0), (5.0, -1.0), (5.0, 2.0), (3.0, 2.0))),
    Disc((-4.0, 2.0), 1.0),
    Capsule(((0.0, 2.0), (2.0, 4.0)), 0.3),
)
AMONG = {"obstacles": MIXED, "local_frames": "global", "time_step": 0.1, "allow_long_step": True}


def test_random_walks_among_all_kinds_stay_outside():
    scenario = Scenario(n_robots=4, merge_radius=1e-3, max_speed=50.0, **AMONG)
    sim, random, touched = Simulator(scenario, 4), np.random.default_rng(0), 0
    sim.reset(0)
    for _ in range(150):
        out = sim.step(-5 * sim.positions + random.normal(0, 20, (4, 4, 2)))
        touched += out.contact.sum()
        for team, robot in np.argwhere(sim.active):
            nearest = clearance(scenario, sim.positions[team, robot])
            assert nearest >= -1e-9
            assert out.clearance[team, robot] == pytest.approx(nearest, abs=1e-12)
    assert touched > 100
