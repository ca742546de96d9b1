"""Time of a robot step against n and against B, for docs/throughput.md: ``growth.py PNG``."""

from __future__ import annotations

import sys

from matplotlib.figure import Figure

import rendezvous_env as rv
from train.bench.bench import Config, measure
from train.bench.cases import Case, Size, simulator_of, spread_out

SIZES, RINGS, BATCHES = (2, 3, 4, 8, 16, 32, 64), (8, 32, 128, 512, 1024), (1, 16, 256, 1024, 4096)
"""Robots in a complete graph, robots in a cycle (same total), environments."""
CONFIG = Config()


def nanoseconds(scenario: rv.Scenario, num_envs: int) -> float:
    """Time of a simulator step per robot, ns."""
    n, size = scenario.n_robots, Size(num_envs, CONFIG.num_threads)
    build = lambda: simulator_of(scenario, size)  # noqa: E731
    case = Case("", "", n, num_envs, n * num_envs, "robot steps", build)
    return 1e9 / float(measure([case], CONFIG)[0]["rate"])


def growth_figure() -> Figure:
    """Time per robot step against n, and against B."""
    robots = CONFIG.num_envs * RINGS[0]
    rings = [nanoseconds(spread_out(n, graph="cycle"), max(1, robots // n)) for n in RINGS]
    sizes = [nanoseconds(spread_out(n), CONFIG.num_envs) for n in SIZES]
    shared = {CONFIG.num_envs: sizes[SIZES.index(8)]}  # one measurement for both panels
    batches = [shared.get(batch) or nanoseconds(spread_out(8), batch) for batch in BATCHES]
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    by_size, by_batch = figure.subplots(1, 2)
    by_size.loglog(SIZES, sizes, "o-", label=f"complete graph, B = {CONFIG.num_envs}")
    by_size.loglog(RINGS, rings, "s-", label=f"cycle, {robots} robots in total")
    by_size.set(xlabel="robots n", title="by number of robots")
    by_size.legend()
    by_batch.loglog(BATCHES, batches, "o-")
    by_batch.set(xlabel="environments B", title="complete graph, n = 8")
    for axes, places in ((by_size, sorted({*SIZES, *RINGS})), (by_batch, BATCHES)):
        axes.set_xticks(places, [str(place) for place in places])
        axes.set_xticks([], minor=True)
        axes.set_ylabel("time per robot step (ns)")
        axes.grid(visible=True, alpha=0.3)
    return figure


if __name__ == "__main__":
    if len(sys.argv) != 2 or not sys.argv[1].endswith(".png"):
        sys.exit("name a PNG: growth.py PNG")
    growth_figure().savefig(sys.argv[1], dpi=150)
