"""Speed of training environments and guarantee wrappers, for docs/throughput.md.

    learner_speed.py                        # ratios to the physics beneath, CPU time of one thread
    learner_speed.py --threads 2 --clock    # wall time of two threads

Both sides of a ratio alternate within one process. It prints their medians with 95 % intervals, and
on one thread the share of each part in the time of a decision.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import rendezvous_env as rv
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env

TRAINED, WRAPPED = (512, 4), (1024, 8)
"""Environments and robots of decisions, and of steps under a guarantee."""
TAUGHT = (("clutter-8", "heading"), ("clutter-24", "tank"))
_PARTS = ("physics", "base controller", "safety filter", "features", "frames")
Step = Callable[[], Any]
Clock = Callable[[], float]


def stepping(env: Any) -> Step:
    """Steps with prepared random actions."""
    env.reset(seed=0)
    random, space = np.random.default_rng(0), env.single_action_space
    shape = 8, env.num_envs, *space.shape
    tape = itertools.cycle(random.uniform(-1.0, 1.0, shape).astype(np.float32))
    return lambda: env.step(next(tape))


def decision(name: str, guarantee: str, threads: int) -> tuple[Step, Any]:
    """Base steps of a decision of ``training_env``, without learner, and the environment."""
    num_envs, n = TRAINED
    env: Any = training_env(name, num_envs, guarantee=guarantee, num_threads=threads)
    simulator = rv.Simulator(env.scenario, num_envs, num_threads=threads)
    simulator.reset(0)
    random, shape = np.random.default_rng(0), (8, num_envs, n, 2)
    tape = itertools.cycle(random.uniform(-1.0, 1.0, shape).astype(np.float32))

    def physics() -> None:
        for _ in range(env.env.decision_period):
            outcome = simulator.step(next(tape))
            if not simulator.all_running:
                simulator.restart(simulator.ended, outcome)

    return physics, env


def wrapped(wrap: Any, threads: int) -> tuple[Step, Any]:
    """A step of ``make_vec`` and the environment with a guarantee; robots too far to merge."""
    num_envs, n = WRAPPED
    far = rv.Scenario(n_robots=n, spawn_size=1e6 * n * n, time_limit=1e9)
    make = partial(rv.make_vec, far, num_envs, num_threads=threads)
    return stepping(make()), wrap(make())


def cases(threads: int) -> Iterator[tuple[str, Callable[[], tuple[Step, Any]]]]:
    """Names and builders of all ratios."""
    for name, guarantee in TAUGHT:
        named = f"training_env, {name}, {guarantee}, over its base steps"
        yield named, partial(decision, name, guarantee, threads)
    for wrap in (HeadingVectorWrapper, EnergyTankWrapper):
        yield f"{wrap.__name__} over make_vec, n = 8", partial(wrapped, wrap, threads)


def paired_times(
    one: Step, other: Step, clock: Clock, pairs: int, seconds: float
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


def shares(env: Any, step: Step, clock: Clock, count: int) -> dict[str, float]:
    """Shares of _PARTS in the time of ``count`` steps on one thread, and of the rest.

    The rest are resets, infos, copies, and the calls of compiled code.
    """
    spent: Counter[str] = Counter()
    for _ in range(count):
        step()
    _watch(env, spent, clock)
    begin = clock()
    for _ in range(count):
        step()
    total = clock() - begin
    found = {part: spent[part] / total for part in _PARTS if spent[part] > 0.0}
    return found | {"rest": 1.0 - sum(found.values())}


def _watch(env: Any, spent: Counter[str], clock: Clock) -> None:
    """Add up the time of all compiled calls of an environment in its part."""

    def timed(part: str, call: Step) -> Step:
        def run() -> Any:
            begin = clock()
            result = call()
            spent[part] += clock() - begin
            return result

        return run

    def watch(part: str, owner: Any, name: str) -> None:
        method = getattr(owner, name)

        def calls_of(*given: Any) -> list[Any]:
            """The same calls, which the engine lists as a function and its arguments."""
            calls = method(*given)
            if owner is not stages:
                return [timed(part, call) for call in calls]
            return [(timed(part, partial(*call)),) for call in calls]

        setattr(owner, name, calls_of)

    stages = env.unwrapped.simulator._runner._stages
    teams = env.env if hasattr(env.env, "filter") else env
    watch("physics", stages, "calls")
    for name in ("apply_calls", "update_calls"):
        watch("safety filter", teams.filter, name)
    if (controller := getattr(teams, "controller", None)) is None:
        watch("frames", teams.filter, "observe_calls")
        return
    watch("base controller", controller, "_aim_calls")
    show = controller.show
    controller.show = lambda *given: timed("features", partial(show, *given))()


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
        bare, env = build()
        own = stepping(env)
        times = paired_times(bare, own, clock, given.pairs, given.seconds)
        ratio, low, high = median_interval([one / other for one, other in times])
        micros = [1e6 * statistics.median(pair[side] for pair in times) for side in (0, 1)]
        print(f"{name}: {ratio:.3f} [{low:.3f}, {high:.3f}], {micros[0]:.0f}, {micros[1]:.0f} µs")
        if given.threads == 1:
            count = max(1, round(1e6 * given.pairs * given.seconds / micros[1]))
            found = shares(env, own, clock, count)
            print("   ", ", ".join(f"{part} {share:.2f}" for part, share in found.items()))


if __name__ == "__main__":
    main()
