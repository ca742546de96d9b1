"""Speed of training environments and guarantee wrappers, for docs/throughput.md.

    learner_speed.py                        # ratios to the physics beneath, CPU time of one thread
    learner_speed.py --threads 2 --clock    # wall time of two threads
    learner_speed.py --stages               # and the time of each kernel in a decision

Both sides of a ratio alternate within one process. It prints medians and 95 % intervals of them.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

import rendezvous_env as rv
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env

TRAINED, WRAPPED = (512, 4), (1024, 8)
"""Environments and robots of decisions, and of steps under a guarantee."""
TAUGHT = (("clutter-8", "heading"), ("clutter-24", "tank"))
Step = Callable[[], Any]


def stepping(env: Any) -> Step:
    """Steps with prepared random actions."""
    env.reset(seed=0)
    random, space = np.random.default_rng(0), env.single_action_space
    shape = 8, env.num_envs, *space.shape
    tape = itertools.cycle(random.uniform(-1.0, 1.0, shape).astype(np.float32))
    return lambda: env.step(next(tape))


def decision(name: str, guarantee: str, threads: int) -> tuple[Step, Step]:
    """A decision of ``training_env``, and the same number of base steps of its physics."""
    num_envs, _ = TRAINED
    env: Any = training_env(name, num_envs, guarantee=guarantee, num_threads=threads)
    simulator = rv.Simulator(env.scenario, num_envs, num_threads=threads)
    simulator.reset(0)
    random, shape = np.random.default_rng(0), (8, num_envs, *simulator.active.shape[1:], 2)
    tape = itertools.cycle(random.uniform(-1.0, 1.0, shape).astype(np.float32))

    def physics() -> None:
        for _ in range(env.env.decision_period):
            outcome = simulator.step(next(tape))
            if not simulator.all_running:
                simulator.restart(simulator.ended, outcome)

    return physics, stepping(env)


def wrapped(wrap: Any, threads: int) -> tuple[Step, Step]:
    """A step of ``make_vec``, without and with a guarantee, of robots too far apart to merge."""
    num_envs, n = WRAPPED
    far = rv.Scenario(n_robots=n, spawn_size=1e6 * n * n, time_limit=1e9)
    make = partial(rv.make_vec, far, num_envs, num_threads=threads)
    return stepping(make()), stepping(wrap(make()))


def cases(threads: int) -> Iterator[tuple[str, Callable[[], tuple[Step, Step]]]]:
    """Names and builders of all ratios."""
    for name, guarantee in TAUGHT:
        named = f"training_env, {name}, {guarantee}, over its base steps"
        yield named, partial(decision, name, guarantee, threads)
    for wrap in (HeadingVectorWrapper, EnergyTankWrapper):
        yield f"{wrap.__name__} over make_vec, n = 8", partial(wrapped, wrap, threads)


def paired_times(
    one: Step, other: Step, clock: Callable[[], float], pairs: int, seconds: float
) -> list[tuple[float, float]]:
    """Times of a step of either, s, measured alternately and in alternating order."""
    counts = []
    for step in (one, other):
        step()
        begin, count = clock(), 0
        while (passed := clock() - begin) < seconds:
            step()
            count += 1
        counts.append(max(1, round(count * seconds / passed)))
    times = []
    for turn in range(pairs):
        pair = [0.0, 0.0]
        for side in (0, 1) if turn % 2 == 0 else (1, 0):
            step, begin = (one, other)[side], clock()
            for _ in range(counts[side]):
                step()
            pair[side] = (clock() - begin) / counts[side]
        times.append((pair[0], pair[1]))
    return times


def median_interval(values: list[float]) -> tuple[float, float, float]:
    """Median and its 95 % interval, by the order statistics of the sign test."""
    ordered, n = sorted(values), len(values)
    k = max(0, int(0.5 * (n - 1.96 * n**0.5)))
    return statistics.median(ordered), ordered[k], ordered[n - 1 - k]


@contextmanager
def timed_kernels(clock: Callable[[], float]) -> Iterator[Counter[str]]:
    """Time of all kernels that filters and the simulator call, s, by name."""
    spent: Counter[str] = Counter()
    yield spent


def main() -> None:
    """Measure and print all ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=1, help="threads of a step")
    parser.add_argument("--clock", action="store_true", help="wall time in place of CPU time")
    parser.add_argument("--pairs", type=int, default=31)
    parser.add_argument("--seconds", type=float, default=0.1, help="of one measurement")
    given = parser.parse_args()
    clock = time.perf_counter if given.clock else time.process_time
    for name, build in cases(given.threads):
        times = paired_times(*build(), clock, given.pairs, given.seconds)
        ratio, low, high = median_interval([one / other for one, other in times])
        bare, own = (1e6 * statistics.median(pair[side] for pair in times) for side in (0, 1))
        print(f"{name}: {ratio:.3f} [{low:.3f}, {high:.3f}], {bare:.0f} and {own:.0f} µs")


if __name__ == "__main__":
    main()
