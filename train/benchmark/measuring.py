"""How fast a case is: rates of cases that take turns, beside a busy core too."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rendezvous_env as rv

from .bench_cases import Case, Running, spread_out
from .bench_settings import Config

_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(10**6))"
"""Keeps a core busy until its parent ends, however that happens."""


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
