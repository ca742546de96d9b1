"""Benchmark cases: the environments, a peer and a bare kernel."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import MultiDiscrete
from numba import njit

import rendezvous_env as rv
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env

from ..checks import installed

EPISODE = 200
"""Episode length in the case with episode ends, steps."""
_LANES = 64
_FEATURES: dict[str, Mapping[str, Any]] = {
    "periodic clocks": {"activation": "periodic"},
    "random clocks": {"activation": "random"},
    "adversarial clocks": {"activation": "bounded"},
    "adversarial clocks, stop": {"activation": "bounded", "hold": "stop"},
    "crash": {"events": {"crashes": [[0, 0.0]]}},
    "sensor failure": {"events": {"sensor_failures": [[0, 0.0, 1e9]]}},
    "adversary": {"events": {"adversaries": [[0, 0.0]]}},
    "slip": {"events": {"slip": 0.2}},
    "disturbance": {"events": {"disturbance": 0.1}},
    "Gaussian disturbance": {"events": {"disturbance_noise": 0.1}},
    "compass drift": {"events": {"compass_drift": 0.1}},
    "compass walk": {"events": {"compass_walk": 0.1}},
}
"""Scenario fields of clocks and failures by the names of rows."""
_SENSORS = {
    "exact sensor": rv.Sensing(),
    "noise": rv.Sensing(noise=0.1),
    "noise, dropout, range": rv.Sensing(noise=0.1, dropout=0.1, range=1e6),
}


class Running(NamedTuple):
    """A prepared case, ready to be timed."""

    step: Callable[[], Any]
    intact: Callable[[], bool] = lambda: True
    """() → whether no robot has merged, so that every step did the same work."""


@dataclass(frozen=True)
class Case:
    """One row of the table, before it is measured."""

    name: str
    group: str  # one of bench.GROUPS
    n_robots: int
    num_envs: int  # B, environments that step together
    per_step: int  # count of one step, in ``unit``
    unit: str  # "team steps" (environment steps), "decisions", or "samples"
    build: Callable[[], Running]
    against: str = ""  # reference case, timed alternately, by whose rate this one is divided


class Size(NamedTuple):
    """Settings shared by the rows of a batch size."""

    num_envs: int
    num_threads: int | None


Builds = Mapping[str, Callable[[], Running]]


def in_turns(
    group: str, n_robots: int, count: int, builds: Builds, unit: str = "team steps"
) -> list[Case]:
    """Cases that are timed alternately, relative to the first."""
    first = next(iter(builds))
    return [
        Case(name, group, n_robots, count, count, unit, build, "" if name == first else first)
        for name, build in builds.items()
    ]


def spread_out(n_robots: int, **fields: Any) -> rv.Scenario:
    """Scenario with a complete graph and robots too far apart to merge while timed."""
    fields = {"spawn_size": 2000.0 * n_robots, "time_limit": 1e9} | fields
    return rv.Scenario(name=f"spread-out-{n_robots}", n_robots=n_robots, **fields)


def among_discs() -> rv.Scenario:
    """Scenario with four slow robots among 8 discs, without merges or contacts while timed."""
    places = [(6.0 * math.cos(k * math.pi / 4), 6.0 * math.sin(k * math.pi / 4)) for k in range(8)]
    return rv.Scenario(
        name="among-discs",
        n_robots=4,
        start_positions=((-3.0, 0.0), (3.0, 0.0), (0.0, 3.0), (0.0, -3.0)),
        obstacles=tuple(rv.Disc(centre=place, radius=1.0) for place in places),
        obstacle_range=20.0,
        max_speed=1e-6,
        time_limit=1e9,
    )


def one_team(group: str, scenario: rv.Scenario, size: Size | None = None) -> list[Case]:
    """PettingZoo step of one environment, relative to MPE2's ``simple_spread_v3`` if installed."""
    builds = {"PettingZoo": partial(_in_dicts, partial(rv.parallel_env, scenario))}
    if installed("mpe2") and not scenario.obstacles:
        peer = partial(_in_dicts, partial(_mpe2, scenario.n_robots), 0.0)
        builds = {"MPE2 simple_spread_v3": peer} | builds
    return in_turns(group, scenario.n_robots, 1, builds)


def batched(group: str, scenario: rv.Scenario, size: Size) -> list[Case]:
    """Batched steps, relative to the bare kernel in scenarios without obstacles."""
    builds = {
        "Simulator": partial(simulator_of, scenario, size),
        "make_vec": partial(_vector, scenario, size),
        f"make_vec, episodes of {EPISODE} steps": partial(_vector, scenario, size, EPISODE),
    }
    if not scenario.obstacles:
        limit = partial(_limit, scenario.n_robots, size.num_envs)
        builds = {"limit, 1 thread": limit} | builds
    return in_turns(group, scenario.n_robots, size.num_envs, builds)


def wrapped(n: int, size: Size) -> list[Case]:
    """Batched steps with random actions under a safety filter, relative to no filter."""
    # filtered robots approach each other, unlike with random actions
    scenario = spread_out(n, spawn_size=1e6 * n)

    def build(wrap: Callable[[Any], Any]) -> Running:
        return stepping(wrap(rv.make_vec(scenario, size.num_envs, num_threads=size.num_threads)))

    builds = {"make_vec": partial(build, lambda env: env)}
    builds |= {
        one.__name__: partial(build, one) for one in (HeadingVectorWrapper, EnergyTankWrapper)
    }
    return in_turns("wrapped", n, size.num_envs, builds)


def training(name: str, guarantee: str, size: Size) -> list[Case]:
    """Decisions of the training environment, relative to the physics of its steps."""

    def build(learning: bool) -> Running:
        threads = size.num_threads
        env: Any = training_env(name, size.num_envs, guarantee=guarantee, num_threads=threads)
        if learning:
            return Running(stepping(env).step)
        step, steps = simulator_of(env.scenario, size).step, range(env.env.decision_period)
        return Running(lambda: [step() for _ in steps])

    learns = f"training_env, {name}, {guarantee}"
    builds = {"base steps": partial(build, False), learns: partial(build, True)}
    n = rv.scenarios.get(name).n_robots
    return in_turns("training", n, size.num_envs, builds, "decisions")


def sensing(n: int, size: Size | None) -> list[Case]:
    """Steps with imperfect sensors, batched or PettingZoo, relative to exact sensors."""

    def build(sensor: rv.Sensing) -> Running:
        scenario = spread_out(n, sensing=sensor)
        if size is None:
            return _in_dicts(partial(rv.parallel_env, scenario))
        return simulator_of(scenario, size)

    builds = {name: partial(build, sensor) for name, sensor in _SENSORS.items()}
    return in_turns("sensing", n, 1 if size is None else size.num_envs, builds)


def features(n: int, size: Size) -> list[Case]:
    """Batched steps with clocks, failures or other robots, relative to a scenario without them."""
    models = ["unicycle" if robot % 2 else "single_integrator" for robot in range(n)]
    speeds: dict[str, Any] = {"max_speed": [0.5 if robot % 2 else 1.0 for robot in range(n)]}
    given: dict[str, Mapping[str, Any]] = {"none": {}, **_FEATURES, "two speeds": speeds}
    given["unicycles"] = {"robot_model": "unicycle", **speeds}
    given["mixed team"] = {"robot_model": models, **speeds}
    builds = {
        name: partial(_vector, spread_out(n, **fields), size) for name, fields in given.items()
    }
    return in_turns("features", n, size.num_envs, builds)


def many_shapes(num_envs: int, slots: int | None, size: Size) -> list[Case]:
    """Batched steps with 2,000 boxes, relative to 20, with all rows or only the nearest."""
    own, chosen, rows = size._replace(num_envs=num_envs), {}, "all rows"
    if slots is not None:
        chosen = {"obstacle_slots": slots, "obstacle_overflow": "nearest"}
        rows = f"{slots} nearest"
    builds = {
        f"{count:,} shapes, {rows}": partial(
            simulator_of, _among_boxes(count, **chosen), own, drifts=False
        )
        for count in (20, 2000)
    }
    return in_turns("many-shapes", 4, num_envs, builds)


def _among_boxes(count: int, **fields: Any) -> rv.Scenario:
    """Scenario with random boxes of constant density, and robots that do not merge."""
    random, half = np.random.default_rng(0), 5.0 * math.sqrt(count / 20.0)
    boxes = []
    for _ in range(count):
        (x, y), angle = random.uniform(-half, half, 2), random.uniform(0.0, math.pi)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * random.uniform(0.1, 0.3, 2)
        boxes.append(rv.Polygon(vertices=(corners @ turn.T + (x, y)).tolist()))
    return rv.Scenario(
        name=f"among-{count}-boxes",
        n_robots=4,
        obstacles=tuple(boxes),
        graph=rv.graphs.complete(),
        merge_radius=1e-6,
        time_step=0.05,
        max_speed=2.0,
        allow_long_step=True,
        spawn_size=10.0,
        time_limit=1e9,
        **fields,
    )


def tape_of(space: Any, *batch: int, drifts: bool = True) -> Iterator[Any]:
    """Endless iterator over prepared random actions, (*batch, *shape); without drift their sum over
    a period is zero, so that no robot is driven into a corner where it meets others.
    """
    random, shape = np.random.default_rng(0), (8, *batch, *space.shape)
    if isinstance(space, MultiDiscrete):
        return itertools.cycle(random.integers(space.nvec.min(), size=shape))
    actions = random.uniform(-1.0, 1.0, shape)
    actions -= 0.0 if drifts else actions.mean(axis=0)
    return itertools.cycle(actions.astype(np.float32))


def stepping(env: Any) -> Running:
    """Vector environment with random actions."""
    env.reset(seed=0)
    tape, simulator = tape_of(env.single_action_space, env.num_envs), env.unwrapped.simulator
    return Running(lambda: env.step(next(tape)), lambda: bool(simulator.active.all()))


def _mpe2(n: int) -> Any:
    from mpe2 import simple_spread_v3

    return simple_spread_v3.parallel_env(N=n, continuous_actions=True, max_cycles=10**9)


def _in_dicts(make: Callable[[], Any], low: float = -1.0) -> Running:
    """PettingZoo environment with random actions between ``low`` and 1."""
    env = make()
    env.reset(seed=0)
    names = list(env.agents)
    shape = 8, len(names), *env.action_space(names[0]).shape
    drawn = np.random.default_rng(0).uniform(low, 1.0, shape).astype(np.float32)
    tape = itertools.cycle([dict(zip(names, each, strict=True)) for each in drawn])
    return Running(lambda: env.step(next(tape)), lambda: list(env.agents) == names)


def simulator_of(scenario: rv.Scenario, size: Size, drifts: bool = True) -> Running:
    """Batched simulator with random actions, see ``tape_of``."""
    simulator = rv.Simulator(scenario, size.num_envs, num_threads=size.num_threads)
    simulator.reset(0)
    space = rv.make_vec(scenario, 1).single_action_space
    tape = tape_of(space, size.num_envs, drifts=drifts)

    def step() -> Any:
        outcome = simulator.step(next(tape))
        if not simulator.all_running:  # autoreset
            simulator.restart(simulator.ended, outcome)
        return outcome

    return Running(step, lambda: bool(simulator.active.all()))


def _vector(scenario: rv.Scenario, size: Size, max_cycles: int | None = None) -> Running:
    """Environments of ``make_vec``; with ``max_cycles`` their episodes end at different steps."""
    venv = rv.make_vec(scenario, size.num_envs, num_threads=size.num_threads, max_cycles=max_cycles)
    running = stepping(venv)
    if max_cycles is not None:
        venv.set_state(venv.get_state() | {"steps": np.arange(size.num_envs) % max_cycles})
    return running


def _limit(n: int, num_envs: int) -> Running:
    blocks = -(-num_envs // _LANES)
    positions = np.random.default_rng(0).uniform(-1e3, 1e3, (blocks, n, 2, _LANES))
    bearings, f = np.zeros((blocks, n, n - 1, 2, _LANES)), np.zeros((n, 2, _LANES))
    return Running(lambda: bare_step(positions, bearings, f))


@njit(nogil=True, error_model="numpy")
def bare_step(positions: Any, bearings: Any, f: Any) -> None:
    """Bare reference kernel: all bearings, their sums f and an Euler step of 1 ns.

    Shapes are (blocks, n, n − 1, 2, lanes) and (n, 2, lanes), with environments last for SIMD.
    There are no frames, merges or rewards.
    """
    blocks, n, _, lanes = positions.shape
    for block in range(blocks):
        p, g = positions[block], bearings[block]
        f[:] = 0.0
        for i in range(n):
            for j in range(n):
                if j != i:
                    row = g[i, j - (j > i)]
                    for lane in range(lanes):
                        dx, dy = p[j, 0, lane] - p[i, 0, lane], p[j, 1, lane] - p[i, 1, lane]
                        inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
                        row[0, lane], row[1, lane] = dx * inverse, dy * inverse
                        f[i, 0, lane] += dx * inverse
                        f[i, 1, lane] += dy * inverse
        for i in range(n):
            for k in range(2):
                for lane in range(lanes):
                    p[i, k, lane] += 1e-9 * f[i, k, lane]
