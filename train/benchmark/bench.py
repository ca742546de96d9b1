"""``rendezvous bench``: how fast the environments are on this machine, as ratios of one run."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import rendezvous_env as rv
from rendezvous_env.engine import threads

from ..checks import check_least, check_most
from ..errors import UserError
from ..results import provenance, write_json
from .bench_cases import LIMIT, Case, Running, among_discs, batched, one_team, spread_out

GROUPS = ("one-team", "batched", "obstacles", "robots", "ppo", "heading-ppo")
_MOST_BEARINGS = 2**31
_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10**6))"
"""Keeps a core busy until its parent ends, however that happens."""
_PEERS = ("stable-baselines3", "torch", "mpe2")


@dataclass(frozen=True)
class Config:
    """Measure the speed of the environments."""

    json: Path | None = None
    """File for the figures, beside the table."""
    figure: Path | None = None
    """PNG file for the growth of a robot step's time with n and B; measured only if given."""
    only: tuple[str, ...] = ()
    """Groups of rows: one-team, batched, obstacles, robots, ppo, heading-ppo; none is all."""
    robots: tuple[int, ...] = (3, 8, 32)
    """Sizes of teams."""
    num_envs: int = 1024
    """Teams that step together, and slots of the VecEnv."""
    num_threads: int | None = None
    """Most threads a step may use; None is one for each core."""
    repeats: int = 5
    """Measurements of which the median is taken; cases that are compared take turns."""
    seconds: float = 0.3
    """Length of a measurement, s."""
    busy: bool = False
    """Measure again while another process keeps one core busy."""


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


def run(config: Config) -> None:
    """Measure, print the table, write what files are asked for.

    Raises:
        UserError: for an unknown group of rows, or a folder that does not exist.
        RuntimeError: if robots merged while they were timed.
    """
    _check(config)
    console = Console(width=None if sys.stdout.isatty() else 120)
    rows = []
    for cases in _groups(config, console):
        rows += measure(cases, config)
        console.print(f"[dim]{cases[0].group}, n = {cases[0].n_robots}: done[/dim]")
    console.print(_table(rows, config.busy))
    for n in config.robots:
        state, seen = bytes_per_team(n, config)
        console.print(f"memory per team, n = {n}: {state:,} bytes of state, {seen:,} observed")
    if config.json is not None:
        write_json(config.json, _content(rows, config))
    if config.figure is not None:
        from .bench_figure import draw_growth

        draw_growth(config.figure, config)


def _check(config: Config) -> None:
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


def _groups(config: Config, console: Console) -> Iterator[list[Case]]:
    """Cases that are timed in turns."""
    wanted = config.only or GROUPS
    size = config.num_envs, config.num_threads
    for n in config.robots:
        if "one-team" in wanted:
            yield one_team(spread_out(n), "one-team", peer=True)
    for n in config.robots:
        if "batched" in wanted:
            yield batched(spread_out(n), "batched", *size)
    if "obstacles" in wanted:
        yield one_team(among_discs(), "obstacles", peer=False)
        yield batched(among_discs(), "obstacles", *size)
    if {"robots", "ppo", "heading-ppo"} & set(wanted):
        yield from _learning_groups(config, wanted, console)


def _learning_groups(
    config: Config, wanted: tuple[str, ...], console: Console
) -> Iterator[list[Case]]:
    try:
        from . import bench_learning
    except ModuleNotFoundError as error:
        console.print(f"{error.name} is missing (extra 'train'): no VecEnv and PPO rows")
        return
    for n in config.robots:
        if "robots" in wanted:
            yield bench_learning.robots(n, config.num_envs, config.num_threads)
    for n in config.robots:
        if "ppo" in wanted:
            yield bench_learning.ppo(n, config.num_envs, config.num_threads)
    if "heading-ppo" in wanted:
        yield bench_learning.heading_ppo(config.num_envs, config.num_threads)


# ---- measuring ------------------------------------------------------------------------------


def measure(cases: list[Case], config: Config) -> list[Row]:
    """Time cases in turns, so that what disturbs the machine disturbs all of them.

    Raises:
        RuntimeError: if robots merged while they were timed.
    """
    running = [case.build() for case in cases]
    counts = [_calibrate(each.step, config.seconds) for each in running]
    rates = _take_turns(cases, running, counts, config.repeats)
    busy: list[list[float]] | None = None
    if config.busy:
        with one_core_busy():
            busy = _take_turns(cases, running, counts, config.repeats)
    for case, each in zip(cases, running, strict=True):
        if not each.intact():
            raise RuntimeError(f"{case.name}, n = {case.n_robots}: robots merged while timed")
    return [_row(k, cases, rates, busy) for k in range(len(cases))]


def _calibrate(step: Callable[[], Any], seconds: float) -> int:
    """Steps that take about so long, after warming up."""
    step()
    begin, count = time.perf_counter(), 0
    while (passed := time.perf_counter() - begin) < seconds / 2:
        step()
        count += 1
    return max(1, round(seconds * count / passed))


def _take_turns(
    cases: list[Case], running: list[Running], counts: list[int], repeats: int
) -> list[list[float]]:
    """Rates of each case, one for each turn, units per second."""
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats):
        for case, each, count, found in zip(cases, running, counts, rates, strict=True):
            step = each.step
            begin = time.perf_counter()
            for _ in range(count):
                step()
            found.append(case.per_step * count / (time.perf_counter() - begin))
    return rates


def _row(
    k: int, cases: list[Case], rates: list[list[float]], busy: list[list[float]] | None
) -> Row:
    case, ratio = cases[k], None
    others = [
        each
        for other, each in zip(cases, rates, strict=True)
        if case.against and other.name.startswith(case.against)
    ]
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
def one_core_busy() -> Iterator[None]:
    """Another process computes for nothing meanwhile."""
    process = subprocess.Popen([sys.executable, "-c", _BUSY], start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def bytes_per_team(n_robots: int, config: Config) -> tuple[int, int]:
    """Bytes of a team's state, and of its observations in one step."""
    batch = config.num_envs
    simulator = rv.Simulator(spread_out(n_robots), batch)
    return simulator.nbytes // batch, simulator.reset(0).nbytes // batch


# ---- telling --------------------------------------------------------------------------------


def _table(rows: list[Row], busy: bool) -> Table:
    table = Table(title="per second: median; ratio: median of the turns of this run")
    for heading in ("rows", "case"):
        table.add_column(heading, no_wrap=True)
    for heading in ("n", "B", "rate", "ratio"):
        table.add_column(heading, justify="right", no_wrap=True)
    if busy:
        table.add_column("one core busy", justify="right")
    for row in rows:
        if _is_slower_limit(row, rows):
            continue
        rate = f"{row.rate / 1e6:.3g} M" if row.rate >= 1e5 else f"{row.rate:,.0f}"
        ratio = "" if row.ratio is None else f"{row.ratio:.3g} × {row.against}"
        cells = [row.group, row.name, str(row.n_robots), str(row.num_envs)]
        cells += [f"{rate} {row.unit}", ratio]
        if row.busy_rate is not None:
            cells.append(f"{row.busy_rate / row.rate:.0%}")
        table.add_row(*cells)
    return table


def _is_slower_limit(row: Row, rows: list[Row]) -> bool:
    """Whether a faster way to reach the limit was measured; only the fastest is the limit."""
    return row.name.startswith(LIMIT) and any(
        other.rate > row.rate
        for other in rows
        if other.name.startswith(LIMIT)
        and (other.group, other.n_robots) == (row.group, row.n_robots)
    )


def _content(rows: list[Row], config: Config) -> dict[str, Any]:
    """All figures with what they were measured on, as plain data."""
    content = provenance()
    content["versions"] |= _peer_versions()
    return content | {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": config.num_threads or threads.available_cores(),
        "repeats": config.repeats,
        "seconds": config.seconds,
        "bytes_per_team": {
            str(n): dict(zip(("state", "observations"), bytes_per_team(n, config), strict=True))
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


def _peer_versions() -> dict[str, str]:
    """Of what is timed beside us, as far as it is installed."""
    found = {}
    for name in _PEERS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
