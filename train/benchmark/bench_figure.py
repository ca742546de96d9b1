"""How the time of a robot's step grows with the size of a team and of the batch."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from rendezvous_env.experiment.scenario import Scenario

from ..results import atomic
from .bench_cases import Case, batched, spread_out
from .bench_settings import Config

SIZES = (2, 3, 4, 8, 16, 32, 64)
RINGS = (8, 32, 128, 512, 1024)
"""Robots of teams in which each sees two others, as many robots together as teams of the first."""
BATCHES = (1, 4, 16, 64, 256, 1024, 4096)


def draw_growth(path: Path, config: Config) -> None:
    """Measure bare simulator steps and draw their time per robot against n and against B."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    by_size, by_batch = figure.subplots(1, 2)
    robots = config.num_envs * RINGS[0]
    sizes = [_robot_step(spread_out(n), config.num_envs, config) for n in SIZES]
    rings = [_robot_step(_ring(n), max(1, robots // n), config) for n in RINGS]
    batches = [_robot_step(spread_out(8), batch, config) for batch in BATCHES]
    by_size.loglog(SIZES, sizes, "o-", label=f"complete graph, B = {config.num_envs}")
    by_size.loglog(RINGS, rings, "s-", label=f"ring, {robots} robots in all")
    by_size.set(xlabel="robots in a team, n", title="by the size of a team")
    by_size.legend()
    by_batch.loglog(BATCHES, batches, "o-")
    by_batch.set(xlabel="teams, B", title="complete graph, n = 8")
    for axes, places in ((by_size, sorted({*SIZES, *RINGS})), (by_batch, BATCHES)):
        axes.set_xticks(places, [str(place) for place in places])
        axes.set_xticks([], minor=True)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.0, 0.4)))
        axes.set_ylabel("time per robot step, ns")
        axes.grid(visible=True, alpha=0.3)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)


def _ring(n_robots: int) -> Scenario:
    return spread_out(n_robots, graph="cycle")


def _robot_step(scenario: Scenario, num_envs: int, config: Config) -> float:
    """Median time of a robot's step, ns."""
    cases = batched(scenario, "batched", num_envs, config.num_threads)
    case = next(case for case in cases if case.name == "Simulator")
    return 1e9 * statistics.median(_times(case, config))


def _times(case: Case, config: Config) -> list[float]:
    step = case.build().step
    step()
    times: list[float] = []
    for _ in range(config.repeats):
        begin, count = time.perf_counter(), 0
        while time.perf_counter() - begin < config.seconds / 2:
            step()
            count += 1
        times.append((time.perf_counter() - begin) / (count * case.n_robots * case.num_envs))
    return times
