"""Fuzzing of obstacles, robot models of one's own, extreme steps and kernels on disk."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from fuzzing import EFFORTS, Refused, attempt, explore
from hypothesis import strategies as st
from soup import absurd, edges, mostly, nearly

import rendezvous_env as rv
from rendezvous_env import compilation, kernel_cache
from rendezvous_env.robots import robot_models

NUMBERS = [float, int, np.float32, np.float64, np.int64, np.int8, np.uint16, np.array]
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


def numeric(value, kind):
    """The same numbers, all of one type."""
    if isinstance(value, dict):
        return {name: numeric(entry, kind) for name, entry in value.items()}
    if isinstance(value, tuple):
        return tuple(numeric(entry, kind) for entry in value)
    return value if isinstance(value, str) else kind(value)


@pytest.mark.parametrize("kind", NUMBERS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_numbers_of_any_type_become_pythons_own(shape, kind):
    usual = shape(**SHAPES[shape])
    if kind is np.array:  # an array of no axes is no number
        with pytest.raises(ValueError, match="obstacles: "):
            shape(**numeric(SHAPES[shape], kind))
        given = {name: np.array(value) for name, value in SHAPES[shape].items()}
        tables = {name: value for name, value in given.items() if value.ndim}
        assert shape(**SHAPES[shape] | tables) == usual
    elif shape is not rv.ObstacleField or issubclass(kind, int | np.integer):
        made = shape(**numeric(SHAPES[shape], kind))
        assert made == usual and hash(made) == hash(usual)
        assert repr(made).replace(".0", "") == repr(usual).replace(".0", "")


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


def pairs(value):
    return st.tuples(value, value)


@pytest.mark.parametrize("effort", EFFORTS)
def test_robot_models_of_ones_own(effort, registry):
    """What is registered moves by finite numbers, and not faster than it says."""

    known = robot_models.ROBOT_MODELS.copy()

    def check(way, length, kept, bent, bounds, name, n_angles):
        class Fuzzed(NamedTuple):
            duration: float
            speed_limit: float

        def propose(model, action, frame, memory):
            x, y = (share * model.duration for share in way)
            return (x * action[0], y * action[1]), length * model.duration * sum(map(abs, action))

        motion = rv.Motion(
            propose=propose,
            displacement_at=lambda model, action, frame, memory, time: tuple(
                part * time / model.duration for part in propose(model, action, frame, memory)[0]
            ),
            chord_error_bound=lambda *_: bent,
            update=lambda *_: kept,
            init=lambda *_: kept,
        )
        rv.describe_motion(Fuzzed, motion)
        model = rv.RobotModel(
            name,
            dims=(2,),
            constants=lambda scenario: Fuzzed(scenario.tau, scenario.speed_limit),
            bounds=lambda scenario: bounds,
            n_angles=n_angles,
        )
        found = attempt(lambda: rv.register_robot_model(model), ValueError, TypeError)
        if isinstance(found, Refused):
            assert robot_models.ROBOT_MODELS == known
            return
        constants = Fuzzed(0.1, rv.Scenario(robot_model=name).speed_limit)
        (x, y), far = propose(constants, bounds, (1.0, 0.0, 0.0, 1.0), kept)
        assert math.hypot(x, y) <= constants.speed_limit * 0.1 * (1 + 1e-6) + 1e-6
        assert far >= 0.0
        del robot_models.ROBOT_MODELS[name]

    two = st.lists(st.floats(0.1, 3.0), min_size=2, max_size=2)
    explore(
        check,
        effort * 10,
        pairs(mostly(st.floats(0.1, 0.5), edges)),
        mostly(st.floats(1.0, 3.0), edges),
        mostly(st.just(()), absurd, st.tuples(edges)),
        nearly(st.floats(0.0, 1.0)),
        nearly(two, [1.0], [1.0] * 3, [-1.0, 1.0]),
        nearly(st.just("fuzzed"), "a b", "", "unicycle"),
        mostly(st.just(0), absurd),
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


@pytest.mark.skipif(not compilation.compiled(), reason="nothing is kept")
@pytest.mark.parametrize("effort", EFFORTS)
def test_damaged_kernels(effort, tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)

    def called():
        @compilation.kernel
        def sevenfold(x):
            return 7.0 * x

        return sevenfold(3.0)

    assert called() == 21.0
    (file,) = tmp_path.glob("sevenfold-*")
    whole = file.read_bytes()

    def check(cut, places, junk):
        damaged = bytearray(whole[: len(whole) - cut])
        for place in places:
            damaged[place % len(damaged)] ^= 1 + place % 255
        file.write_bytes(bytes(damaged) + junk)
        assert called() == 21.0

    explore(
        check,
        effort,
        st.integers(0, 100),
        st.lists(st.integers(0, 2**20), max_size=3),
        st.binary(max_size=8),
    )
