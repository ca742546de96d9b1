"""``rendezvous bench``: how fast the environments are on this machine, as ratios of one run."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from rendezvous_env.engine.pool import threads

from ..results import provenance, write_json
from .bench_adapters import LEARNERS, adapters, adapters_in_training
from .bench_cases import LIMIT, Case, among_discs, batched, one_team, spread_out
from .bench_guarantees import wrapped
from .bench_policies import TICKS, learned
from .bench_rllib import rllib_in_training
from .bench_sensing import sensing
from .bench_settings import GROUPS, Config, check
from .measuring import Row, bytes_per_team, measure

__all__ = ["GROUPS", "Config", "Row", "measure", "run"]

_PEERS = ("stable-baselines3", "torch", "mpe2", *(learner.distribution for learner in LEARNERS))


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
        state, seen = bytes_per_team(n, config)
        console.print(f"memory per team, n = {n}: {state:,} bytes of state, {seen:,} observed")
    if config.json is not None:
        write_json(config.json, _content(rows, config))
    if config.figure is not None:
        from .bench_figure import draw_growth

        draw_growth(config.figure, config)


def _groups(config: Config, console: Console) -> Iterator[list[Case]]:
    """Cases that are timed in turns."""
    wanted = config.only or GROUPS
    size = config.num_envs, config.num_threads
    if "one-team" in wanted:
        yield from (one_team(spread_out(n), "one-team", peer=True) for n in config.robots)
    for n in config.robots:
        if "batched" in wanted:
            yield batched(spread_out(n), "batched", *size)
    if "obstacles" in wanted:
        yield one_team(among_discs(), "obstacles", peer=False)
        yield batched(among_discs(), "obstacles", *size)
    for n in config.robots:
        if "wrapped" in wanted:
            yield wrapped(n, *size)
    for n in config.robots:
        if "sensing" in wanted:
            yield from sensing(n, *size)
    if "learned" in wanted:
        yield learned(1)
        yield learned(max(2, config.num_envs // 4))
    if "adapters" in wanted:
        yield from (adapters(n, *size) for n in config.robots)
        yield from adapters_in_training(*size)
        yield from rllib_in_training(*size)
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
        ratio = "" if row.ratio is None else f"{row.ratio:.3g} × {row.against}"
        cells = [row.group, row.name, str(row.n_robots), str(row.num_envs)]
        cells += [_rate(row), ratio]
        if row.busy_rate is not None:
            cells.append(f"{row.busy_rate / row.rate:.0%}")
        table.add_row(*cells)
    return table


def _rate(row: Row) -> str:
    if row.unit == TICKS:
        return f"{1e6 / row.rate:.3g} µs per robot and tick"
    rate = f"{row.rate / 1e6:.3g} M" if row.rate >= 1e5 else f"{row.rate:,.0f}"
    return f"{rate} {row.unit}"


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
