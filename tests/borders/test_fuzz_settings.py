"""Fuzzing of wrappers, headings, certificates and obstacles, see ``fuzzing``."""

import inspect
import math

import numpy as np
import soup
from conftest import started
from fuzzing import TEAMS, assert_finite, attempt, fuzzed, teams
from hypothesis import example
from hypothesis import strategies as st
from soup import absurd, any_table, nearly
from tuples import along

import rendezvous_env as rv
from rendezvous_env import vector

margins = st.floats(0.01, 0.99)
WRAPPER = {
    "min_alignment": nearly(margins, 0, 1),
    "max_turn_rate": nearly(soup.lengths, 0),
    "frame": nearly(st.sampled_from(["net_bearing", "local"]), "body"),
    "decision_period": nearly(st.sampled_from([1, 3]), 0, 2.0),
    "certified": nearly(st.booleans(), 1),
    "budget": nearly(soup.lengths, -1e-9),
    "observe_level": nearly(st.booleans(), 1),
    "min_gain": nearly(st.none() | soup.lengths, 0.0, np.nan),
    "max_gain": nearly(st.none() | soup.lengths, -1.0),
    "share": nearly(st.floats(0.01, 1.0), 0.0, 1.1),
    "bearing_error": nearly(st.floats(0.0, 1.5), -0.1, 2.0),
}
"""Settings of guarantees; each takes those that it has an argument for."""
WRAPPERS = ("HeadingVectorWrapper", "EnergyTankWrapper", "GainWrapper", "LinkKeepingWrapper")


@fuzzed(60, teams, st.booleans(), st.sampled_from(WRAPPERS), st.data())
def test_arguments_of_wrappers(team, alone, name, data):
    scenario = TEAMS[team]
    base = rv.parallel_env(scenario) if alone else rv.make_vec(scenario, 2, max_cycles=3)
    wrap = getattr(rv if alone else vector, name)
    own = inspect.signature(wrap).parameters.keys() & WRAPPER.keys()
    some = st.fixed_dictionaries({}, optional={key: WRAPPER[key] for key in sorted(own)})
    arguments = data.draw(some)
    if data.draw(st.integers(0, 9)) == 0:
        base = data.draw(absurd)
    env = attempt(lambda: wrap(base, **arguments), ValueError, TypeError)
    if isinstance(env, Exception):
        return
    env.reset(seed=0)
    size, simulator = env.filter.action_size, env.unwrapped.simulator
    for k in range(3):
        raw = np.full(size, (1.0, -3e38, 1e-40)[k])
        if alone:
            env.step({name: raw for name in env.agents})
        else:
            env.step(np.tile(raw, (2, scenario.n_robots, 1)))
        assert_finite(simulator.positions, simulator.lyapunov(), simulator.observe())


CONSTANTS = {
    "min_alignment": nearly(margins),
    "dead_zone": nearly(soup.lengths),
    "max_turn": nearly(soup.lengths, np.inf),
}


@fuzzed(
    30, st.tuples(*[any_table(2) | any_table(3)] * 3), st.fixed_dictionaries(CONSTANTS),
    nearly(margins), st.sampled_from(list(TEAMS.values())) | absurd,
)  # fmt: skip
def test_headings_and_certificates(vectors, given, margin, scenario):
    heading = attempt(lambda: rv.certified_heading(*vectors, **given))
    if not isinstance(heading, Exception):
        assert np.allclose(np.linalg.norm(heading, axis=-1), 1.0)
    certificate = attempt(lambda: rv.certificate(scenario, margin))
    if not isinstance(certificate, Exception):
        assert not np.isnan(certificate.time_bound)


SHAPES = {
    rv.Disc: {"centre": (1, 2), "radius": 1},
    rv.Sphere: {"centre": (1, 2, 3), "radius": 1},
    rv.Capsule: {"ends": ((0, 0), (3, 1)), "radius": 1},
    rv.Polygon: {"vertices": ((0, 0), (3, 0), (0, 3))},
    rv.ObstacleField: {"count": 3, "radius": (1, 2), "region": 9, "keep_out": 1, "passage": 1},
    rv.WallField: {
        "layout": "trap", "size": (9, 12), "opening": (1, 2), "thickness": 1, "region": 9,
        "keep_out": 1,
    },
}  # fmt: skip


fields_of_shapes = st.sampled_from(sorted({name for fields in SHAPES.values() for name in fields}))


@fuzzed(4, st.sampled_from(list(SHAPES)), fields_of_shapes, absurd, st.booleans())
def test_obstacles(shape, name, value, as_data):
    fields = SHAPES[shape] | {name: value} if name in SHAPES[shape] else SHAPES[shape]
    made = attempt(lambda: shape(**fields))
    if not isinstance(made, Exception):
        hash(made)
        attempt(lambda: rv.Scenario(dim=getattr(made, "dim", 2), obstacles=(made,)))
    given = {name: value} if as_data else fields
    for described in (given, [given], {"kind": value, **given}, [value]):
        found = attempt(lambda described=described: rv.Scenario(obstacles=described))
        if not isinstance(found, Exception):
            assert found.replace(obstacles=found.obstacles) == found


ROUND = rv.Polygon(2.0 * along(*0.36 * np.arange(1000)))
wild = st.sampled_from([1e-3, 1.0, 30.0, 1e3, 1e6])


@fuzzed(4, wild, wild, wild, st.integers(0, 99))
@example(1e3, 1e3, 1e3, 0)
def test_extreme_steps_among_obstacles(speed, turn_rate, step, seed):
    """Any speed, turn rate and step: finite, outside, and over within seconds."""
    scenario = rv.Scenario(
        robot_model="unicycle",
        n_robots=3,
        obstacles=(ROUND,),
        merge_radius=1e-6,  # who merges within a step is placed on its chord
        max_speed=speed,
        max_turn_rate=turn_rate,
        time_step=step,
        time_limit=max(1.0, 2 * step),
        allow_long_step=True,
    )
    sim = started(scenario, 16, seed=seed)
    actions = np.random.default_rng(seed).uniform(-1, 1, (16, 3, 2)) * (speed, turn_rate)
    attempt(lambda: sim.step(actions))
    assert np.isfinite(sim.positions).all()
    distances = np.linalg.norm(sim.positions, axis=-1)
    assert (distances >= 2.0 * math.cos(math.pi / 1000) - 1e-9 * (1 + speed * step)).all()
