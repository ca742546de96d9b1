"""Fuzzing of obstacles, and of extreme steps among them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fuzzing import EFFORTS, Refused, attempt, explore
from hypothesis import strategies as st
from soup import absurd

import rendezvous_env as rv

SHAPES = {
    rv.Disc: {"centre": (1, 2), "radius": 1},
    rv.Sphere: {"centre": (1, 2, 3), "radius": 1},
    rv.Capsule: {"ends": ((0, 0), (3, 1)), "radius": 1},
    rv.Polygon: {"vertices": ((0, 0), (3, 0), (0, 3))},
    rv.ObstacleField: {"count": 3, "radius": (1, 2), "region": 9, "keep_out": 1, "passage": 1},
    rv.WallField: {
        "layout": "trap",
        "size": (9, 12),
        "opening": (1, 2),
        "thickness": 1,
        "region": 9,
        "keep_out": 1,
    },
}


@pytest.mark.parametrize("effort", EFFORTS)
def test_obstacles(effort):
    def check(shape, name, value, as_data):
        fields = SHAPES[shape] | {name: value} if name in SHAPES[shape] else SHAPES[shape]
        made = attempt(lambda: shape(**fields))
        if not isinstance(made, Refused):
            hash(made)
            attempt(lambda: rv.Scenario(dim=getattr(made, "dim", 2), obstacles=(made,)))
        given = {name: value} if as_data else fields
        for described in (given, [given], {"kind": value, **given}, [value]):
            found = attempt(lambda described=described: rv.Scenario(obstacles=described))
            if not isinstance(found, Refused):
                assert found.replace(obstacles=found.obstacles) == found

    names = sorted({name for fields in SHAPES.values() for name in fields})
    explore(
        check,
        effort * 4,
        st.sampled_from(list(SHAPES)),
        st.sampled_from(names),
        absurd,
        st.booleans(),
    )


@pytest.mark.parametrize("effort", EFFORTS)
def test_extreme_steps_among_obstacles(effort):
    """Any speed, turn rate and step: finite, outside, and over within seconds."""
    ring = 2 * np.pi * np.arange(1000) / 1000
    polygon = rv.Polygon(2.0 * np.stack([np.cos(ring), np.sin(ring)], axis=-1))

    def check(speed, turn_rate, step, seed):
        scenario = rv.Scenario(
            robot_model="unicycle",
            n_robots=3,
            obstacles=(polygon,),
            merge_radius=1e-6,  # who merges within a step is placed on its chord
            max_speed=speed,
            max_turn_rate=turn_rate,
            time_step=step,
            time_limit=max(1.0, 2 * step),
            allow_long_step=True,
        )
        sim = rv.Simulator(scenario, 16)
        sim.reset(seed)
        actions = np.random.default_rng(seed).uniform(-1, 1, (16, 3, 2)) * (speed, turn_rate)
        attempt(lambda: sim.step(actions))
        assert np.isfinite(sim.positions).all()
        distances = np.linalg.norm(sim.positions, axis=-1)
        assert (distances >= 2.0 * math.cos(math.pi / 1000) - 1e-9 * (1 + speed * step)).all()

    wild = st.sampled_from([1e-3, 1.0, 30.0, 1e3, 1e6])
    rv.Simulator(rv.scenarios.get("duo"))  # what is imported late is not timed
    check(1.0, 1.0, 0.1, 0)  # nor what is compiled
    check(1e3, 1e3, 1e3, 0)
    explore(check, effort * 4, wild, wild, wild, st.integers(0, 99))
