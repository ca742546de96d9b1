"""``rendezvous leaderboard``: train, evaluate and report run by run; resumable."""

import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from tyro.conf import arg

from rendezvous_env.checks import counted
from rendezvous_env.deprecation import renamed_arguments
from rendezvous_env.scenario import scenarios

from .. import results
from ..checks import Bounds, UserError, current_policy
from ..compare import out_folder, statistics
from ..compare.playing import Task, play_all
from ..console import Console
from ..learn.settings import MAX_SEED
from ..policies import resolve_scenario
from ..resume import RunCheckpoint, program
from ..tasks import Workers
from . import registry, tables
from .replays import path_of, write_replay
from .run_records import (
    Run,
    RunKey,
    RunRecord,
    has_replay,
    place_of,
    read_record,
    read_records,
    run_of,
    write_run,
)

Tier = Literal["smoke", "mini", "full"]


class Protocol(NamedTuple):
    """Settings shared by all algorithms of a tier."""

    fields: tuple[str, ...]
    seeds: int
    decisions: int  # of single robots, per run
    episodes: int  # held out, per run


_FIELDS = (
    "clutter-8", "clutter-16", "clutter-24", "corridor", "rooms", "noisy-8", "unicycle-clutter-16",
)  # fmt: skip
TIERS: dict[Tier, Protocol] = {
    "smoke": Protocol(_FIELDS[:2], 3, 2**14, 50),
    "mini": Protocol(_FIELDS, 5, 2**16, 200),
    "full": Protocol(_FIELDS, 10, 10_000_000, 1000),
}
EXAMPLES = (
    "--tier smoke",
    "--tier mini --algorithms ppo-heading ppo-tank --fields clutter-16 --jobs 8",
    "--repeat results/leaderboard/smoke/cells/ppo-heading/clutter-8-v1-seed-0.json --record",
)
FLAG_GROUPS = {"Output": ("out", "fresh"), "Workers": ("jobs", "on", "address")}
_TABLES = r"(leaderboard|improvement)\.csv|(price|profiles)\.png|README\.md|report\.html"
_SAME = ("algorithm", "field", "digest", "seed", "decisions", "episodes", "results")
"""Entries of a run record that a repetition must reproduce."""


@dataclass(frozen=True)
class Config(Workers):
    """Train and evaluate algorithms over scenarios and seeds; write tables and raw results."""

    tier: Tier = "smoke"
    """Size: smoke (minutes), mini (hours on two cores) or full (a cluster)."""
    algorithms: tuple[str, ...] = ()
    """Names of algorithms, one file each in train/leaderboard/algorithms. Default: all whose
    libraries are installed."""
    fields: Annotated[tuple[str, ...], arg(aliases=("--scenarios",))] = ()
    """Named scenarios, with or without version. Default: those of the tier."""
    seeds: Annotated[tuple[int, ...], Bounds(0, MAX_SEED)] = ()
    """Training seeds. Default: those of the tier, 0, 1 and so on."""
    decisions: Annotated[int | None, Bounds(1)] = None
    """Training budget, in decisions of single robots. Default: that of the tier."""
    episodes: Annotated[int | None, Bounds(1)] = None
    """Number of episodes of an evaluation, from held-out initial conditions. Default: that of the
    tier."""
    repeat: Path | None = None
    """Run record to repeat and compare bitwise; exit status 1 if it differs. The other flags are
    taken from the record."""
    record: bool = False
    """Keep a replay of every run instead of the first seed only; runs of OUT without a replay are
    repeated. With --repeat, keep the replay of that run if it does not differ."""
    out: Path = Path("out/leaderboard")
    """Folder for run records, tables and figures. Existing runs are kept and others added.
    Finished runs are in OUT.part until all are done; the same command resumes."""
    fresh: Annotated[bool, arg(name="overwrite")] = False
    """Discard the unfinished results of another command in OUT.part."""


FORMER_FLAGS = {"--starts": "--episodes"}
"""Deprecated flags."""
Config.__init__ = renamed_arguments(  # type: ignore[method-assign]
    starts="episodes"
)(Config.__init__)


def plan(config: Config) -> list[RunKey]:
    """Runs requested by a configuration; a UserError if no algorithm fits any scenario."""
    tier = TIERS[config.tier]
    able = tuple(name for name, one in registry.known().items() if not one.missing)
    decisions, episodes = config.decisions or tier.decisions, config.episodes or tier.episodes
    seeds = config.seeds or tuple(range(tier.seeds))
    places = []
    for name in config.algorithms or able:
        algorithm = registry.find(name)
        for given in config.fields or tier.fields:
            scenario = resolve_scenario(given)
            if not (named := results.versioned(scenario)):
                raise UserError(f"--fields {given}: only named scenarios have versions")
            field = named["field"].partition("/")[2]
            if algorithm.fits(scenario):
                own, much = (seeds, decisions) if algorithm.learns else (seeds[:1], 0)
                places += [RunKey(name, field, seed, much, episodes) for seed in own]
    if not places:
        raise UserError("none of these algorithms fits any of these scenarios")
    if len(set(places)) < len(places):
        raise UserError("an algorithm, a scenario or a seed is named twice; name each once")
    return places


def run(config: Config) -> int:
    """Execute all runs and write the results, or repeat one run.

    Returns:
        Exit status: 1 if a repetition differs from its record.
    """
    console = Console()
    if config.repeat is not None:
        return _repeat(config.repeat, config.record, console)
    places, begun = plan(config), any(config.out.glob("cells/*/*.json"))
    ours = re.compile("cells|replays|" + _TABLES * begun)  # a killed process may leave no record
    out = out_folder.destination(config.out, "leaderboard", ours.fullmatch)
    lacking = {name: one.missing for name, one in registry.known().items() if one.missing}
    if lacking and not config.algorithms:
        wanted = ", ".join(sorted({package for own in lacking.values() for package in own}))
        console.print(f"skipped without {wanted}: {', '.join(lacking)}", soft_wrap=True)
    asked = {**program(), "cells": [list(p) for p in places], "record": config.record}
    part = RunCheckpoint(out_folder.part_of(out), asked, "leaderboard")
    with part.at_work(config.out, console, fresh=config.fresh):
        if out.exists():
            results.prepare_folder(out, f"--out {config.out}")
        kept = _kept(out, places)
        if config.record:
            kept = {p: c for p, c in kept.items() if p not in places or has_replay(out, c)}
        tasks = {
            place: Task(
                name=f"cell-{number:04d}",
                label=f"{place.algorithm} · {place.field} · {place.seed}",
                scenario=scenarios.get(place.field),
                count=1,
                work=partial(run_of, place, config.record or place.seed == places[0].seed),
            )
            for number, place in enumerate(places)
            if place not in kept
        }
        done, _ = play_all(list(tasks.values()), config, part, console)
        runs = {place: (card, None) for place, card in kept.items()}
        runs |= {place: done[task.name] for place, task in tasks.items()}
        write(out, [runs[place] for place in sorted(runs)], console)
        part.discard()
    console.print(f"{counted(len(runs), 'cell')}; files in {config.out}", soft_wrap=True)
    return 0


def _kept(out: Path, places: Sequence[RunKey]) -> dict[RunKey, RunRecord]:
    """Runs stored in a folder; a UserError if their budget or number of episodes differs."""
    kept = {place_of(card): card for card in read_records(out)}
    _check_names(out, kept, places)
    for what in ("decisions", "episodes"):
        amounts = {getattr(place, what) for place in (*kept, *places)} - {0}
        if len(amounts) > 1:
            each = " and ".join(f"{amount:,}" for amount in sorted(amounts))
            raise UserError(
                f"--out {out}: {each} {what} cannot be in one table; choose another folder"
            )
    return kept


def _check_names(out: Path, kept: Iterable[RunKey], places: Iterable[RunKey]) -> None:
    """Raise a UserError if a folder has runs of an algorithm under its deprecated name."""
    asked = {place.algorithm for place in places}
    for former in {place.algorithm for place in kept}:
        if (name := current_policy(former)) != former and name in asked:
            raise UserError(
                f"--out {out}: holds runs of {former}, which is called {name} now; choose another "
                f'folder, or rename cells/{former}, replays/{former} and "algorithm" in its records'
            )


def write(out: Path, runs: Sequence[Run], console: Console) -> None:
    """Write a record per run, replays, tables and figures; print the table."""
    for run in runs:
        write_run(out, *run)
    cards = [card for card, _ in runs]
    rows = tables.rows_of(cards)
    results.write_csv(out / "leaderboard.csv", rows)
    results.write_csv(out / "improvement.csv", tables.improvements(cards), tables.IMPROVEMENT)
    tables.draw(out, cards, rows)
    results.write_text(out / "README.md", tables.markdown(rows, cards))
    Console(width=max(console.width, tables.WIDTH)).print(tables.text(rows))


def _repeat(path: Path, record: bool, console: Console) -> int:
    """Repeat a recorded run.

    If it differs, report whether collision-free success lies within the interval of a repetition.
    """
    card = read_record(path)
    place = place_of(card)
    kept = path_of(path) if record else None
    again, replay = run_of(place, record)
    differ = [key for key in _SAME if again[key] != card.get(key)]
    if not differ:
        console.print(f"{place.name}: bitwise equal", soft_wrap=True)
        if kept is not None and replay is not None:
            write_replay(kept, replay)
            console.print(f"its replay: {kept}", soft_wrap=True)
        return 0
    other = [k for k, v in again["versions"].items() if card.get("versions", {}).get(k) != v]
    told = f" (other versions of {', '.join(other)})" if other else ""
    own, was = (np.array(one["results"]["clean"], float) for one in (again, card))
    low, high = statistics.bootstrap_interval((own - was,), np.mean)
    where = "within" if low <= 0.0 <= high else "outside"
    print(
        f"error: {place.name}: {', '.join(differ)} differ{told}; collision-free success is "
        f"{own.mean():.3f}, in the record {was.mean():.3f}, {where} the 95 % interval of the "
        "difference",
        file=sys.stderr,
    )
    return 1
