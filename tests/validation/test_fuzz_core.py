"""Fuzzing of scenarios, resets, actions, states, wrappers and obstacles, see ``fuzzing``."""

import dataclasses
import inspect
import math
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import strategies
from conftest import started
from fuzzing import (
    DOORS,
    TEAMS,
    assert_finite,
    attempt,
    fuzzed,
    play,
    start_and_play,
    teams,
)
from geometry import along
from hypothesis import example
from hypothesis import strategies as st
from strategies import absurd, any_table, nearly

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, TimeStepWarning, vector
from rendezvous_env.engine.memory import RUNNING
from rendezvous_env.scenario.start_options import OPTIONS

FILE = Path(tempfile.mkdtemp()) / "any.toml"


@fuzzed(60, strategies.scenario_fields(), fast=False)
def test_fuzz_scenarios(fields):
    plain = isinstance(fields.get("reward"), dict)
    scenario = attempt(lambda: Scenario.from_plain(fields) if plain else Scenario(**fields))
    if isinstance(scenario, Exception):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TimeStepWarning)
        scenario.to_toml(FILE)
        assert Scenario.from_toml(FILE) == scenario
    assert_finite(scenario.action_bounds, scenario.tau, scenario.max_steps)
    certificate = attempt(lambda: rv.certificate(scenario))
    assert not np.isnan(certificate.time_bound)
    start_and_play(Simulator(scenario))


@fuzzed(40, strategies.toml_texts([field.name for field in dataclasses.fields(Scenario)]))
def test_fuzz_toml(text):
    FILE.write_bytes(text)
    scenario = attempt(lambda: Scenario.from_toml(FILE))
    if not isinstance(scenario, Exception):
        scenario.to_toml(FILE)


class Door:
    """One kind of environment, and access to its episode."""

    def __init__(self, name: str, team: str) -> None:
        self.num_envs, make = DOORS[name]
        self.env = env = make(TEAMS[team], self.num_envs)
        self.n = TEAMS[team].n_robots
        self.size = (env.filter if "heading" in name else TEAMS[team]).action_size
        self.simulator = env if isinstance(env, Simulator) else env.unwrapped.simulator

    def state(self) -> Any:
        """State that a rejection must leave unchanged."""
        env = self.env
        if hasattr(env, "get_state"):
            return env.get_state()
        return env.agent_selection, env.rewards, env.unwrapped.get_state()

    def refuses_or_plays(self, call: Callable[[], Any], *kinds: type[Exception]) -> bool:
        """Assert the fuzzing rule; returns whether the call was accepted."""
        before = self.state()
        if isinstance(attempt(call, *kinds), Exception):
            np.testing.assert_equal(self.state(), before)
            return False
        simulator = self.simulator
        assert_finite(simulator.positions, simulator.lyapunov(), simulator.observe())
        return True


door = cache(Door)
"""Created once for all cases."""
NAMES = [name for name in DOORS if not name.endswith(("gains", "links"))]
"""Scenarios with support for all robot models."""
names = st.sampled_from(NAMES)


@st.composite
def options_of(draw: st.DrawFn, team: str, num_envs: int) -> Any:
    """Options of a reset."""
    n, d = TEAMS[team].n_robots, TEAMS[team].dim
    turn = np.eye(d)[::-1] * np.array([1.0] + [-1.0] * (d - 1))[:, None]
    ones = np.ones((n, n)) - np.eye(n)
    values = {
        "positions": any_table(n, d) | any_table(num_envs, n, d),
        "headings": any_table(n, d - 1) | any_table(n) | any_table(num_envs, n, d - 1),
        "frames": any_table(n, d, d) | st.sampled_from([np.tile(turn, (n, 1, 1)), np.eye(d)]),
        "weights": any_table(n, n) | st.sampled_from([ones, 0 * ones, 0.9 * ones, 1e300 * ones]),
        "obstacles": strategies.obstacles(d),
        "position": absurd,
        "else": absurd,
    }
    assert set(OPTIONS) < values.keys()
    keys = draw(st.lists(st.sampled_from(sorted(values)), max_size=3, unique=True))
    options: dict[Any, Any] = {key: draw(values[key]) for key in keys}
    if draw(st.integers(0, 5)) == 0:
        return draw(absurd)
    if draw(st.integers(0, 5)) == 0:
        options[draw(st.sampled_from([5, None, 10**5000, ("a",), 1.5, "\0"]))] = 5
    if draw(st.integers(0, 3)) == 0:
        options["reset_mask"] = draw(absurd | st.lists(st.booleans(), max_size=3))
    return options


@fuzzed(60, names, teams, st.data(), kernels=True)
def test_fuzz_reset_options(name, team, data):
    it = door(name, team)
    it.env.reset(seed=1)
    options = data.draw(options_of(team, it.num_envs))
    reset = lambda: it.env.reset(seed=2, options=options)  # noqa: E731
    if it.refuses_or_plays(reset, ValueError, RuntimeError):
        play(it.simulator, 3)


robots = st.sampled_from(["robot_0", "robot_1", "robot_2", "robot_9", 5, None, ("a",)])


@st.composite
def actions_of(draw: st.DrawFn, it: Door) -> Any:
    """Values in place of actions for an environment."""
    if draw(st.integers(0, 6)) == 0:
        return draw(absurd)
    if hasattr(it.env, "agent_selection"):
        return draw(any_table(it.size))
    if hasattr(it.env, "agents"):
        table = {name: draw(any_table(it.size)) for name in it.env.agents}
        if draw(st.integers(0, 4)) == 0:
            table.pop(draw(robots), None)
        if draw(st.integers(0, 4)) == 0:
            table[draw(robots)] = draw(any_table(it.size))
        return table
    single = () if type(it.env).__name__ == "RendezvousEnv" else (it.num_envs,)
    return draw(any_table(*single, it.n, it.size))


@fuzzed(60, names, teams, st.data(), kernels=True)
def test_fuzz_actions(name, team, data):
    it = door(name, team)
    it.env.reset(seed=data.draw(st.integers(0, 3)))
    for _ in range(data.draw(st.integers(1, 4))):
        actions = data.draw(actions_of(it))
        it.refuses_or_plays(lambda given=actions: it.env.step(given), ValueError, KeyError)


@st.composite
def spoilt(draw: st.DrawFn, state: Any) -> tuple[str, Any]:
    """A state with one entry changed: its name, and the state."""
    if not isinstance(state, dict) or draw(st.integers(0, 19)) == 0:
        return "", draw(absurd)
    name = draw(st.sampled_from(sorted(state)))
    kind = draw(st.sampled_from(["number", "number", "number", "value", "shape", "type", "gone"]))
    changed, value = dict(state), state[name]
    if isinstance(value, dict):
        inner, changed[name] = draw(spoilt(value))
        return inner, changed
    if kind == "gone":
        del changed[name]
    elif kind == "value" or not isinstance(value, np.ndarray) or not value.size:
        changed[name] = draw(absurd)
    elif kind == "shape":
        changed[name] = draw(st.sampled_from([value[None], value[:-1], value.ravel()]))
    elif kind == "type":
        kind = draw(st.sampled_from([object, str, np.float32, np.int8]))
        with np.errstate(all="ignore"):
            changed[name] = value.astype(kind)
    else:
        changed[name] = value.copy()
        place = draw(st.integers(0, value.size - 1))
        wrong = draw(strategies.edges) if value.dtype.kind == "f" else draw(_whole(value.dtype))
        with np.errstate(all="ignore"):
            changed[name].flat[place] = wrong
    return name, changed


def _whole(dtype: np.dtype) -> st.SearchStrategy:
    if dtype == np.bool_:
        return st.booleans()
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    return st.sampled_from([0, 1, 2, 5, 10**9, low, high]) | st.integers(low, high)


@fuzzed(
    40, st.sampled_from([name for name in NAMES if name != "aec"]), teams, st.data(), kernels=True
)
def test_fuzz_states(name, team, data):
    it = door(name, team)
    it.env.reset(seed=data.draw(st.integers(0, 3)))
    play(it.simulator, data.draw(st.integers(0, 2)))
    entry, state = data.draw(spoilt(it.state()))
    before = it.state()
    accepted = attempt(lambda: it.env.set_state(state))
    if isinstance(accepted, Exception):
        message, related = str(accepted), ("weights", "status", "merged_into")
        assert (entry or "state") in message or any(name in message for name in related)
        np.testing.assert_equal(it.state(), before)
    else:
        play(it.simulator, 20)
        assert (it.simulator.status >= RUNNING).all()


margins = st.floats(0.01, 0.99)
WRAPPER = {
    "min_alignment": nearly(margins, 0, 1),
    "max_turn_rate": nearly(strategies.lengths, 0),
    "frame": nearly(st.sampled_from(["net_bearing", "local"]), "body"),
    "decision_period": nearly(st.sampled_from([1, 3]), 0, 2.0),
    "certified": nearly(st.booleans(), 1),
    "budget": nearly(strategies.lengths, -1e-9),
    "observe_level": nearly(st.booleans(), 1),
    "min_gain": nearly(st.none() | strategies.lengths, 0.0, np.nan),
    "max_gain": nearly(st.none() | strategies.lengths, -1.0),
    "share": nearly(st.floats(0.01, 1.0), 0.0, 1.1),
    "bearing_error": nearly(st.floats(0.0, 1.5), -0.1, 2.0),
}
"""Settings of guarantees; each uses those among its arguments."""
WRAPPERS = ("HeadingVectorWrapper", "EnergyTankWrapper", "GainWrapper", "LinkKeepingWrapper")


@fuzzed(60, teams, st.booleans(), st.sampled_from(WRAPPERS), st.data())
def test_fuzz_wrapper_arguments(team, alone, name, data):
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
    "dead_zone": nearly(strategies.lengths),
    "max_turn": nearly(strategies.lengths, np.inf),
}


@fuzzed(
    30, st.tuples(*[any_table(2) | any_table(3)] * 3), st.fixed_dictionaries(CONSTANTS),
    nearly(margins), st.sampled_from(list(TEAMS.values())) | absurd,
)  # fmt: skip
def test_fuzz_headings_and_certificates(vectors, given, margin, scenario):
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
def test_fuzz_obstacles(shape, name, value, as_data):
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


@fuzzed(4, wild, wild, wild, st.integers(0, 99), fast=False)
@example(1e3, 1e3, 1e3, 0)
def test_fuzz_extreme_steps_among_obstacles(speed, turn_rate, step, seed):
    """Any speed, turn rate and step: finite, outside of obstacles, and fast."""
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
