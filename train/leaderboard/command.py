"""``rendezvous leaderboard``: train, play, tell; cell by cell, so that it can be stopped."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from rendezvous_env.scenario import scenarios

from .. import results
from ..checks import UserError
from ..compare import statistics
from ..compare.playing import Task, play_all
from ..resume import Part, claimed, program
from . import registry, tables
from .cards import Card, Run, place_of, read_card, read_cards, run_of, write_run
from .replays import path_of, write_replay
from .settings import EXAMPLES as EXAMPLES
from .settings import FLAG_GROUPS as FLAG_GROUPS
from .settings import Config, Place, plan

_SAME = ("algorithm", "field", "digest", "seed", "decisions", "starts", "results")
"""Of a card, what a repetition finds again."""


def run(config: Config) -> int:
    """Do all cells, write cards, tables and figures; or repeat one. The exit status: 1 if that
    differs from its card.
    """
    console = Console()
    if config.repeat is not None:
        return _repeat(config.repeat, config.record, console)
    places, out = plan(config), Path(config.out)
    lacking = {name: one.missing for name, one in registry.known().items() if one.missing}
    if lacking and not config.algorithms:
        wanted = ", ".join(sorted({package for own in lacking.values() for package in own}))
        console.print(f"left out without {wanted}: {', '.join(lacking)}", soft_wrap=True)
    asked = {**program(), "cells": [list(p) for p in places], "record": config.record}
    with claimed(out.parent, f".{out.name}.lock", f"--out {out}"):
        kept = _kept(out, places)
        part = Part(out.with_name(f"{out.name}.part"), asked, "leaderboard")
        with part.at_work(out, console, fresh=config.fresh):
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
    return 0


def _kept(out: Path, places: Sequence[Place]) -> dict[Place, Card]:
    """The cells that a folder has; a UserError if they are not of the same budget and starts as
    those asked for.
    """
    kept = {place_of(card): card for card in read_cards(out)}
    for what in ("decisions", "starts"):
        amounts = {getattr(place, what) for place in (*kept, *places)} - {0}
        if len(amounts) > 1:
            each = " and ".join(f"{amount:,}" for amount in sorted(amounts))
            raise UserError(
                f"--out {out}: {each} {what} do not stand in one table; choose another folder"
            )
    return kept


def write(out: Path, runs: Sequence[Run], console: Console) -> None:
    """Write a card for each cell, replays, tables, figures; print the table."""
    for run in runs:
        write_run(out, *run)
    cards = [card for card, _ in runs]
    rows = tables.rows_of(cards)
    results.write_csv(out / "leaderboard.csv", tables.COLUMNS, rows)
    results.write_csv(out / "improvement.csv", tables.IMPROVEMENT, tables.improvements(cards))
    tables.draw(out, cards, rows)
    (out / "README.md").write_text(tables.markdown(rows, cards), encoding="utf-8")
    Console(width=max(console.width, tables.WIDTH)).print(tables.text(rows))
    console.print(f"{len(cards)} cells; files in {out}", soft_wrap=True)


def _repeat(path: Path, record: bool, console: Console) -> int:
    """Do a card's cell again; where it differs, say whether collision-free success is within the
    interval of a repetition.
    """
    card = read_card(path)
    place = place_of(card)
    kept = path_of(path) if record else None
    again, replay = run_of(place, record)
    differ = [key for key in _SAME if again[key] != card.get(key)]
    if not differ:
        console.print(f"{place.name}: the same, bit for bit", soft_wrap=True)
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
        f"{own.mean():.3f}, on the card {was.mean():.3f}, {where} the 95 % interval of the "
        "difference",
        file=sys.stderr,
    )
    return 1
