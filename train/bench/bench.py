"""``rendezvous bench``: throughput on this machine, as ratios within one run."""

import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table

import rendezvous_env as rv
from rendezvous_env.engine.threads import available_cores

from ..checks import Bounds, Flags, UserError, installed, unknown_name
from ..console import Console
from ..results import prepare_file, provenance, write_json
from . import cases, learners
from .cases import Case, Running, Size, spread_out

GROUPS = tuple(
    "one-team batched obstacles wrapped training sensing features many-shapes adapters "
    "heading-ppo".split()
)
_PEERS = ("stable-baselines3", "torch", "mpe2", "torchrl", "pufferlib-core")
_SHOWN = ("group", "name", "n_robots", "num_envs", "unit", "against")
_MOST_BEARINGS = 2**31
_TAUGHT = (("clutter-8", "heading"), ("clutter-24", "tank"))

EXAMPLES = ("", "--only batched wrapped --robots 8 --json out/bench.json")


@dataclass(frozen=True)
class Config(Flags):
    """Measure the speed of the environments."""

    json: Path | None = None
    """File for the results as JSON."""
    only: tuple[str, ...] = ()
    """Groups of rows to measure: one-team, batched, obstacles, wrapped, training, sensing,
    features, many-shapes, adapters, heading-ppo. Default: all."""
    robots: Annotated[tuple[int, ...], Bounds(2, 2**12)] = (3, 8, 32)
    """Numbers of robots per environment."""
    num_envs: Annotated[int, Bounds(1, 2**24)] = 1024
    """Number of environments in a batch."""
    num_threads: Annotated[int | None, Bounds(1, 2**10)] = None
    """Maximum number of threads per step. Default: one per core."""
    repeats: Annotated[int, Bounds(1)] = 5
    """Number of measurements per case; the median is reported. Cases alternate."""
    seconds: Annotated[float, Bounds(0, 3600, "(]")] = 0.3
    """Duration of a measurement, s."""
    cpu_time: bool = False
    """Measure the processor time of this process, which other processes disturb less."""


Row = dict[str, Any]
"""A measured case: the fields _SHOWN; rate, the median of rates, in units per second; ratio, the
median over turns of this rate divided by that of the case against which it is measured, or None.
"""


def check(config: Config) -> None:
    """Validate the settings."""
    if others := sorted(set(config.only) - set(GROUPS)):
        raise unknown_name("--only: group", others[0], GROUPS)
    if not config.robots:
        raise UserError("--robots is empty; give numbers of robots, 2 or more")
    if (bearings := config.num_envs * max(config.robots) ** 2) > _MOST_BEARINGS:
        raise UserError(
            f"--num-envs times the square of --robots is {bearings}; it must be {_MOST_BEARINGS} "
            "or less, so that memory holds them"
        )
    if config.json is not None:
        prepare_file(config.json, "--json")


def run(config: Config) -> None:
    """Measure, print the table and write the requested files."""
    check(config)
    console = Console(width=None if sys.stdout.isatty() else 120)
    rows = []
    for compared in _compared(config):
        rows += measure(compared, config)
        console.print(f"{compared[0].group}, n = {compared[0].n_robots}: done", style="dim")
    console.print(_table(rows))
    sizes = {}
    for n in config.robots:
        state, seen = sizes[n] = _bytes_per_team(n, config)
        console.print(
            f"memory per environment, n = {n}: {state:,} bytes of state, {seen:,} observed"
        )
    if config.json is not None:
        write_json(config.json, _content(rows, sizes, config))


def _compared(config: Config) -> Iterator[list[Case]]:
    """Groups of cases that are timed alternately."""
    size, robots = Size(config.num_envs, config.num_threads), config.robots
    teams, discs = [spread_out(n) for n in robots], cases.among_discs()
    known: dict[str, Iterable[list[Case]]] = {
        "one-team": (cases.one_team("one-team", team) for team in teams),
        "batched": (cases.batched("batched", team, size) for team in teams),
        "obstacles": (make("obstacles", discs, size) for make in (cases.one_team, cases.batched)),
        "wrapped": (cases.wrapped(n, size) for n in robots),
        "training": (cases.training(*taught, size) for taught in _TAUGHT),
        "sensing": (cases.sensing(n, own) for n in robots for own in (None, size)),
        "features": (cases.features(n, size) for n in robots),
        "many-shapes": (
            cases.many_shapes(count, slots, size)
            for count in (1, min(64, size.num_envs))
            for slots in (None, 8)
        ),
        "adapters": learners.adapters(robots, size),
        "heading-ppo": [learners.heading_ppo(size)] if installed("stable_baselines3") else [],
    }
    return chain.from_iterable(known[name] for name in GROUPS if name in (config.only or GROUPS))


def measure(compared: Sequence[Case], config: Config) -> list[Row]:
    """Time cases alternately, so that disturbances affect all of them equally.

    Raises:
        RuntimeError: if robots merged during the measurement.
    """
    running = [case.build() for case in compared]
    clock = time.process_time if config.cpu_time else time.perf_counter
    counts = [_calibrate(each, config.seconds) for each in running]
    rates: dict[str, list[float]] = {case.name: [] for case in compared}
    for _ in range(config.repeats):
        for case, each, count in zip(compared, running, counts, strict=True):
            begin = clock()
            for _ in range(count):
                each.step()
            rates[case.name].append(case.per_step * count / (clock() - begin))
    for case, each in zip(compared, running, strict=True):
        if not each.intact():
            raise RuntimeError(f"{case.name}, n = {case.n_robots}: robots merged while measured")
    return [_row(case, rates) for case in compared]


def _calibrate(running: Running, seconds: float) -> int:
    """Number of steps that take about the given time, after a warm-up."""
    running.step()
    begin, count = time.perf_counter(), 0
    while (passed := time.perf_counter() - begin) < seconds / 2:
        running.step()
        count += 1
    return max(1, round(seconds * count / passed))


def _row(case: Case, rates: Mapping[str, list[float]]) -> Row:
    own, ratio = rates[case.name], None
    if case.against:
        pairs = zip(own, rates[case.against], strict=True)
        ratio = statistics.median(one / other for one, other in pairs)
    shown = {name: getattr(case, name) for name in _SHOWN}
    return shown | {"rate": statistics.median(own), "rates": own, "ratio": ratio}


def _bytes_per_team(n_robots: int, config: Config) -> tuple[int, int]:
    """Bytes of the state of one environment, and of its observations."""
    simulator = rv.Simulator(spread_out(n_robots), config.num_envs)
    return simulator.nbytes // config.num_envs, simulator.reset(0).nbytes // config.num_envs


def _table(rows: Sequence[Row]) -> Table:
    table = Table(title="per second: median; ratio: median of the turns of this run")
    for heading in ("rows", "case", "n", "B", "rate", "ratio"):
        justify: Any = "left" if heading in ("rows", "case") else "right"
        table.add_column(heading, justify=justify, no_wrap=True)
    for row in rows:
        fast = row["rate"] >= 1e5
        rate = f"{row['rate'] / 1e6:.3g} M" if fast else f"{row['rate']:,.0f}"
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g} × {row['against']}"
        size = str(row["n_robots"]), str(row["num_envs"])
        table.add_row(row["group"], row["name"], *size, f"{rate} {row['unit']}", ratio)
    return table


def _content(
    rows: Sequence[Row], sizes: Mapping[int, tuple[int, int]], config: Config
) -> dict[str, Any]:
    """Results and machine description as plain data."""
    told = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.*)", told.read_text() if told.exists() else "")
    peers = [name for name in _PEERS if any(metadata.distributions(name=name))]
    return provenance(peers) | {
        "processor": named[1] if named else platform.processor(),
        "cores": os.cpu_count(),
        "threads": config.num_threads or available_cores(),
        "repeats": config.repeats,
        "seconds": config.seconds,
        "cpu_time": config.cpu_time,
        "bytes_per_team": {
            str(n): {"state": state, "observations": seen} for n, (state, seen) in sizes.items()
        },
        "rows": list(rows),
    }
