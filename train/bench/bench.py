"""``rendezvous bench``: how fast the environments are on this machine, as ratios of one run."""

from __future__ import annotations

import importlib.util
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import rendezvous_env as rv
from rendezvous_env.engine.threads import available_cores

from ..checks import UserError, check_least, check_most
from ..results import atomic, provenance, write_json
from . import learners
from .cases import (
    Case,
    Running,
    Size,
    among_discs,
    batched,
    one_team,
    sensing,
    simulator_of,
    spread_out,
    wrapped,
)

GROUPS = (
    "one-team", "batched", "obstacles", "wrapped", "sensing", "learned", "adapters", "robots",
    "ppo", "heading-ppo",
)  # fmt: skip
_WITH_SB3 = ("robots", "ppo", "heading-ppo")
_PEERS = ("stable-baselines3", "torch", "mpe2", "torchrl", "pufferlib-core")
_MOST_BEARINGS = 2**31
_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10**6))"
"""Keeps a core busy until its parent ends, however that happens."""
SIZES, RINGS, BATCHES = (2, 3, 4, 8, 16, 32, 64), (8, 32, 128, 512, 1024), (1, 16, 256, 4096)
"""Of the figure: robots in a complete graph and in a ring, as many robots in all, and teams."""

EXAMPLES = ("", "--only batched wrapped --robots 8 --json out/bench.json")


@dataclass(frozen=True)
class Config:
    """Measure the speed of the environments."""

    json: Path | None = None
    """A file for the numbers, beside the table."""
    figure: Path | None = None
    """A PNG file for the growth of a robot step's time with n and B, which is measured only
    then."""
    only: tuple[str, ...] = ()
    """The groups of rows to measure: one-team, batched, obstacles, wrapped, sensing, learned,
    adapters, robots, ppo, heading-ppo. Without it all are."""
    robots: tuple[int, ...] = (3, 8, 32)
    """The sizes of teams."""
    num_envs: int = 1024
    """How many environments step together, and the slots of the VecEnv."""
    num_threads: int | None = None
    """The most threads a step may use: one for each core if nothing is said."""
    repeats: int = 5
    """Of how many measurements the median is taken; cases that are compared take turns."""
    seconds: float = 0.3
    """The length of a measurement, s."""
    busy: bool = False
    """Measures again while another process keeps one core busy."""


@dataclass(frozen=True)
class Row:
    """One measured case."""

    group: str
    name: str
    n_robots: int
    num_envs: int
    unit: str
    rate: float
    """Median, units per second."""
    rates: list[float]
    """Every measurement."""
    against: str
    """What ``ratio`` compares with; the fastest one whose name begins so."""
    ratio: float | None
    """Median over turns of this rate divided by the other's in the same turn."""
    busy_rate: float | None = None
    """Median while another process keeps one core busy."""


def check(config: Config) -> None:
    """Refuse settings that cannot be measured.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    if unknown := sorted(set(config.only) - set(GROUPS)):
        raise UserError(f"only: {unknown[0]!r} is unknown; known are {', '.join(GROUPS)}")
    check_least(config, robots=2, num_envs=1, num_threads=1, repeats=1)
    check_most(config, robots=2**12, num_envs=2**24, num_threads=2**10, seconds=3600)
    if not config.robots:
        raise UserError("--robots names none; give sizes of teams, 2 or more")
    if (bearings := config.num_envs * max(config.robots) ** 2) > _MOST_BEARINGS:
        raise UserError(
            f"--num-envs times the square of --robots is {bearings}; it must be {_MOST_BEARINGS} "
            "or less, so that memory holds them"
        )
    if not config.seconds > 0:
        raise UserError(f"--seconds is {config.seconds}; it must be positive")
    for path in (config.json, config.figure):
        if path is not None and not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}")
        if path is not None and path.is_dir():
            raise UserError(f"{path}: is a folder; name a file")


def run(config: Config) -> None:
    """Measure, print the table, write what files are asked for.

    Raises:
        UserError: for an unknown group of rows, or a folder that does not exist.
        RuntimeError: if robots merged while they were timed.
    """
    check(config)
    console = Console(width=None if sys.stdout.isatty() else 120)
    rows = []
    for cases in _groups(config, console):
        rows += measure(cases, config)
        console.print(f"[dim]{cases[0].group}, n = {cases[0].n_robots}: done[/dim]")
    console.print(_table(rows, config.busy))
    for n in config.robots:
        state, seen = _bytes_per_team(n, config)
        console.print(f"memory per team, n = {n}: {state:,} bytes of state, {seen:,} observed")
    if config.json is not None:
        write_json(config.json, _content(rows, config))
    if config.figure is not None:
        _draw_growth(config.figure, config)


def _groups(config: Config, console: Console) -> Iterator[list[Case]]:
    """Cases that are timed in turns."""
    wanted, size = config.only or GROUPS, Size(config.num_envs, config.num_threads)
    teams = [spread_out(n) for n in config.robots]
    if "one-team" in wanted:
        yield from (one_team(team, "one-team", peer=True) for team in teams)
    if "batched" in wanted:
        yield from (batched(team, "batched", size) for team in teams)
    if "obstacles" in wanted:
        yield one_team(among_discs(), "obstacles", peer=False)
        yield batched(among_discs(), "obstacles", size)
    if "wrapped" in wanted:
        yield from (wrapped(n, size) for n in config.robots)
    if "sensing" in wanted:
        yield from (cases for n in config.robots for cases in sensing(n, size))
    if "learned" in wanted:
        yield from (learners.learned(count) for count in (1, max(2, config.num_envs // 4)))
    if "adapters" in wanted:
        yield from learners.adapters(config.robots, size)
    if set(_WITH_SB3) & set(wanted):
        if importlib.util.find_spec("stable_baselines3") is None:
            console.print("stable_baselines3 is missing (extra 'train'): no VecEnv and PPO rows")
        else:
            yield from learners.ppo_groups(wanted, config.robots, size)


# ---- measuring ----------------------------------------------------------------------------------


def measure(cases: Sequence[Case], config: Config) -> list[Row]:
    """Time cases in turns, so that what disturbs the machine disturbs all of them.

    Raises:
        RuntimeError: if robots merged while they were timed.
    """
    running = [case.build() for case in cases]
    counts = [_calibrate(each, config.seconds) for each in running]
    rates = _take_turns(cases, running, counts, config.repeats)
    busy: list[list[float]] | None = None
    if config.busy:
        with _one_core_busy():
            busy = _take_turns(cases, running, counts, config.repeats)
    for case, each in zip(cases, running, strict=True):
        if not each.intact():
            raise RuntimeError(f"{case.name}, n = {case.n_robots}: robots merged while timed")
    return [_row(k, cases, rates, busy) for k in range(len(cases))]


def _calibrate(running: Running, seconds: float) -> int:
    """Steps that take about so long, after warming up."""
    running.step()
    begin, count = time.perf_counter(), 0
    while (passed := time.perf_counter() - begin) < seconds / 2:
        running.step()
        count += 1
    return max(1, round(seconds * count / passed))


def _take_turns(
    cases: Sequence[Case], running: Sequence[Running], counts: Sequence[int], repeats: int
) -> list[list[float]]:
    """Rates of each case, one for each turn, units per second."""
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats):
        for case, each, count, found in zip(cases, running, counts, rates, strict=True):
            begin = time.perf_counter()
            for _ in range(count):
                each.step()
            found.append(case.per_step * count / (time.perf_counter() - begin))
    return rates


def _row(
    k: int, cases: Sequence[Case], rates: list[list[float]], busy: list[list[float]] | None
) -> Row:
    case, ratio = cases[k], None
    named = zip(cases, rates, strict=True)
    others = [own for other, own in named if case.against and other.name.startswith(case.against)]
    if others:
        best = max(others, key=statistics.median)
        ratio = statistics.median(a / b for a, b in zip(rates[k], best, strict=True))
    return Row(
        group=case.group,
        name=case.name,
        n_robots=case.n_robots,
        num_envs=case.num_envs,
        unit=case.unit,
        rate=statistics.median(rates[k]),
        rates=rates[k],
        against=case.against,
        ratio=ratio,
        busy_rate=statistics.median(busy[k]) if busy else None,
    )


@contextmanager
def _one_core_busy() -> Iterator[None]:
    """Another process computes for nothing meanwhile."""
    process = subprocess.Popen([sys.executable, "-c", _BUSY], start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _bytes_per_team(n_robots: int, config: Config) -> tuple[int, int]:
    """Bytes of a team's state, and of its observations in one step."""
    simulator = rv.Simulator(spread_out(n_robots), config.num_envs)
    return simulator.nbytes // config.num_envs, simulator.reset(0).nbytes // config.num_envs


# ---- telling ------------------------------------------------------------------------------------


def _table(rows: Sequence[Row], busy: bool) -> Table:
    table = Table(title="per second: median; ratio: median of the turns of this run")
    for heading in ("rows", "case"):
        table.add_column(heading, no_wrap=True)
    for heading in ("n", "B", "rate", "ratio", *(["one core busy"] if busy else [])):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:.3g} × {row.against}"
        cells = [row.group, row.name, str(row.n_robots), str(row.num_envs), _rate(row), ratio]
        if row.busy_rate is not None:
            cells.append(f"{row.busy_rate / row.rate:.0%}")
        table.add_row(*cells)
    return table


def _rate(row: Row) -> str:
    if row.unit == learners.TICKS:
        return f"{1e6 / row.rate:.3g} µs per robot and tick"
    rate = f"{row.rate / 1e6:.3g} M" if row.rate >= 1e5 else f"{row.rate:,.0f}"
    return f"{rate} {row.unit}"


def _content(rows: Sequence[Row], config: Config) -> dict[str, Any]:
    """All figures with what they were measured on, as plain data."""
    content = provenance()
    for name in _PEERS:  # as far as they are installed
        if found := [one for one in metadata.distributions(name=name)]:
            content["versions"][name] = found[0].version
    return content | {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": config.num_threads or available_cores(),
        "repeats": config.repeats,
        "seconds": config.seconds,
        "bytes_per_team": {
            str(n): dict(zip(("state", "observations"), _bytes_per_team(n, config), strict=True))
            for n in config.robots
        },
        "rows": [asdict(row) for row in rows],
    }


def _processor() -> str:
    """Name of the processor, if the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor()


def _draw_growth(path: Path, config: Config) -> None:
    """Draw the time of a bare simulator step per robot against n and against B."""
    from matplotlib.figure import Figure

    def nanoseconds(scenario: rv.Scenario, num_envs: int) -> float:
        n, size = scenario.n_robots, Size(num_envs, config.num_threads)
        build = lambda: simulator_of(scenario, size)  # noqa: E731
        case = Case("", "", n, num_envs, n * num_envs, "robot steps", build)
        return 1e9 / measure([case], config)[0].rate

    robots = config.num_envs * RINGS[0]
    rings = [nanoseconds(spread_out(n, graph="cycle"), max(1, robots // n)) for n in RINGS]
    sizes = [nanoseconds(spread_out(n), config.num_envs) for n in SIZES]
    batches = [nanoseconds(spread_out(8), batch) for batch in BATCHES]
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    by_size, by_batch = figure.subplots(1, 2)
    by_size.loglog(SIZES, sizes, "o-", label=f"complete graph, B = {config.num_envs}")
    by_size.loglog(RINGS, rings, "s-", label=f"ring, {robots} robots in all")
    by_size.set(xlabel="robots in a team, n", title="by the size of a team")
    by_size.legend()
    by_batch.loglog(BATCHES, batches, "o-")
    by_batch.set(xlabel="teams, B", title="complete graph, n = 8")
    for axes, places in ((by_size, sorted({*SIZES, *RINGS})), (by_batch, BATCHES)):
        axes.set_xticks(places, [str(place) for place in places])
        axes.set_xticks([], minor=True)
        axes.set_ylabel("time per robot step, ns")
        axes.grid(visible=True, alpha=0.3)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)
