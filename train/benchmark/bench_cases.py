"""What ``rendezvous bench`` times: environments, their nearest peer, the limit of the machine."""

from __future__ import annotations

import importlib.util
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import allocating_kernel
from rendezvous_env.engine.pool import threads
from rendezvous_env.engine.pool.sharing import each_block
from rendezvous_env.outcome import Outcome

EPISODE = 200
"""Steps of an episode in the case that ends episodes."""
LIMIT = "limit"
"""How the names of the bare kernel's cases begin."""
_LANES = 64
_ENDLESS = 10**9


class Running(NamedTuple):
    """Something that can be timed."""

    step: Callable[[], Any]
    """One step; its results are thrown away."""
    intact: Callable[[], bool]
    """Whether no robot has merged meanwhile, so that every step did the same work."""


@dataclass(frozen=True)
class Case:
    """One row of the table, before it is measured."""

    name: str
    group: str
    """One of bench.GROUPS."""
    n_robots: int
    num_envs: int
    """B, teams that step together."""
    per_step: int
    """What one step counts as, in ``unit``."""
    unit: str
    """"team steps", "robot steps" or "samples"."""
    build: Callable[[], Running]
    against: str = ""
    """Name of the case of the same group and size that this one is divided by."""


def spread_out(n_robots: int, **fields: Any) -> rv.Scenario:
    """A complete graph of robots that are too far apart to meet while they are timed."""
    return rv.Scenario(
        name=f"spread-out-{n_robots}",
        n_robots=n_robots,
        spawn_size=2000.0 * n_robots,
        time_limit=1e9,
        **fields,
    )


def among_discs() -> rv.Scenario:
    """Four robots that see 8 discs and are too slow to meet or reach them while they are timed."""
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


def one_team(scenario: rv.Scenario, group: str, peer: bool) -> list[Case]:
    """A step of one team in dicts, beside MPE2's ``simple_spread_v3`` when it is installed."""
    n = scenario.n_robots
    peers = peer and importlib.util.find_spec("mpe2") is not None
    cases = (
        [Case("MPE2 simple_spread_v3", group, n, 1, 1, "team steps", lambda: _mpe2(n))]
        if peers
        else []
    )
    name, against = "PettingZoo", "MPE2" if peers else ""
    return [
        *cases,
        Case(name, group, n, 1, 1, "team steps", lambda: dicts_of(scenario), against),
    ]


def batched(
    scenario: rv.Scenario, group: str, num_envs: int, num_threads: int | None
) -> list[Case]:
    """Steps of many teams, beside the bare kernel where there are no obstacles."""
    n, free = scenario.n_robots, not scenario.obstacles
    size = (n, num_envs, num_envs, "team steps")
    found: list[tuple[str, Callable[[], Running], str]] = []
    for width in (1, 2) if free else ():
        count = min(width, num_threads or threads.available_cores())
        for pairs, how in ((True, "by pairs"), (False, "by rows")):
            name = f"{LIMIT}, {how}, {width} thread{'s' * (width > 1)}"
            build = _builder(_limit, n, num_envs, count, pairs)
            found.append((name, build, ""))
    against = LIMIT if free else ""
    found += [
        ("Simulator", lambda: simulator_of(scenario, num_envs, num_threads), against),
        ("make_vec", lambda: _vector(scenario, num_envs, num_threads, None), against),
    ]
    name = f"make_vec, episodes of {EPISODE} steps"
    found += [(name, lambda: _vector(scenario, num_envs, num_threads, EPISODE), against)]
    return [Case(name, group, *size, build, against) for name, build, against in found]


def _builder(build: Callable[..., Running], *arguments: Any) -> Callable[[], Running]:
    return lambda: build(*arguments)


def _actions(shape: Sequence[int], bound: float) -> list[NDArray[np.float32]]:
    """A tape of random actions, prepared beforehand."""
    random = np.random.default_rng(0)
    return [random.uniform(-bound, bound, shape).astype(np.float32) for _ in range(8)]


def dicts_of(scenario: rv.Scenario) -> Running:
    """One team through PettingZoo, under random actions."""
    env = rv.parallel_env(scenario)
    env.reset(seed=0)
    shape = (scenario.n_robots, scenario.action_size)
    tape = itertools.cycle(
        [dict(zip(env.agents, each, strict=True)) for each in _actions(shape, 1.0)]
    )
    return Running(lambda: env.step(next(tape)), lambda: bool(env.simulator.active.all()))


def _mpe2(n: int) -> Running:
    from mpe2 import simple_spread_v3

    env = simple_spread_v3.parallel_env(N=n, continuous_actions=True, max_cycles=_ENDLESS)
    env.reset(seed=0)
    tape = itertools.cycle(
        [dict(zip(env.agents, np.abs(each), strict=True)) for each in _actions((n, 5), 1.0)]
    )
    return Running(lambda: env.step(next(tape)), lambda: len(env.agents) == n)


def simulator_of(scenario: rv.Scenario, num_envs: int, num_threads: int | None) -> Running:
    """Many teams in the bare simulator, under random actions."""
    simulator = rv.Simulator(scenario, num_envs, num_threads=num_threads)
    simulator.reset(0)
    shape = (num_envs, scenario.n_robots, scenario.action_size)
    tape = itertools.cycle(_actions(shape, 1.0))

    def step() -> Outcome:
        outcome = simulator.step(next(tape))
        if not simulator.all_running:  # autoreset
            simulator.restart(simulator.ended, outcome)
        return outcome

    return Running(step, lambda: bool(simulator.active.all()))


def _vector(
    scenario: rv.Scenario, num_envs: int, num_threads: int | None, max_cycles: int | None
) -> Running:
    venv = rv.make_vec(scenario, num_envs, num_threads=num_threads, max_cycles=max_cycles)
    venv.reset(seed=0)
    if max_cycles is not None:  # the teams' episodes end one after another
        state = venv.get_state()
        state["steps"] = np.arange(num_envs) % max_cycles
        venv.set_state(state)
    shape = (num_envs, scenario.n_robots, scenario.action_size)
    tape = itertools.cycle(_actions(shape, 1.0))
    return Running(lambda: venv.step(next(tape)), lambda: bool(venv.simulator.active.all()))


# ---- the limit: what any environment of this kind must do at least -----------------------------


def _limit(n: int, num_envs: int, count: int, pairs: bool) -> Running:
    """All bearings in float64, their sums and an Euler step; teams last in memory, no frames, no
    merging, no reward.
    """
    blocks = -(-num_envs // _LANES)
    positions = np.random.default_rng(0).uniform(-1e3, 1e3, (blocks, n, 2 * _LANES))
    bearings = np.zeros((blocks, n, n - 1, 2 * _LANES))
    walk = limit_by_pairs if pairs else limit_by_rows

    def step() -> None:
        threads.share(lambda part: walk(part, positions, bearings), blocks, count)

    return Running(step, lambda: bool(np.isfinite(positions).all()))


@allocating_kernel
def limit_by_pairs(share, positions, bearings):  # noqa: ANN001, ANN201
    """Every pair once, then the sums."""
    f = np.zeros((positions.shape[1], 2 * _LANES))
    return each_block(share, _pairs_of_block, (positions, bearings, f))


@allocating_kernel
def _pairs_of_block(block, arguments):  # noqa: ANN001, ANN202
    positions, bearings, f = arguments
    n, p, g = positions.shape[1], positions[block], bearings[block]
    for i in range(n):
        for j in range(i + 1, n):
            _bearing_of_pair(p[i], p[j], g[i, j - 1], g[j, i])
    for i in range(n):
        for k in range(n - 1):
            _add(g[i, k], f[i])
        _euler_step(f[i], p[i])


@allocating_kernel
def limit_by_rows(share, positions, bearings):  # noqa: ANN001, ANN201
    """Every robot's bearings one after another, summed at once."""
    f = np.zeros((positions.shape[1], 2 * _LANES))
    return each_block(share, _rows_of_block, (positions, bearings, f))


@allocating_kernel
def _rows_of_block(block, arguments):  # noqa: ANN001, ANN202
    positions, bearings, f = arguments
    n, p, g = positions.shape[1], positions[block], bearings[block]
    for i in range(n):
        for j in range(n):
            if j != i:
                _bearing_and_sum(p[i], p[j], g[i, j - (j > i)], f[i])
    for i in range(n):
        _euler_step(f[i], p[i])


@allocating_kernel
def _bearing_of_pair(p_i, p_j, g_ij, g_ji):  # noqa: ANN001, ANN202
    for lane in range(_LANES):
        dx, dy = p_j[lane] - p_i[lane], p_j[_LANES + lane] - p_i[_LANES + lane]
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
        g_ij[lane] = dx * inverse
        g_ij[_LANES + lane] = dy * inverse
        g_ji[lane] = -dx * inverse
        g_ji[_LANES + lane] = -dy * inverse


@allocating_kernel
def _bearing_and_sum(p_i, p_j, g_ij, f_i):  # noqa: ANN001, ANN202
    for lane in range(_LANES):
        dx, dy = p_j[lane] - p_i[lane], p_j[_LANES + lane] - p_i[_LANES + lane]
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy)
        g_ij[lane] = dx * inverse
        g_ij[_LANES + lane] = dy * inverse
        f_i[lane] += dx * inverse
        f_i[_LANES + lane] += dy * inverse


@allocating_kernel
def _add(values, total):  # noqa: ANN001, ANN202
    for k in range(2 * _LANES):
        total[k] += values[k]


@allocating_kernel
def _euler_step(f, p):  # noqa: ANN001, ANN202
    for k in range(2 * _LANES):
        p[k] += 1e-9 * f[k]
        f[k] = 0.0
