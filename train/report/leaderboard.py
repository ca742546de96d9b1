"""Report of a leaderboard folder: algorithms, replays, figures and run records."""

import shlex
from itertools import chain
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from rendezvous_env.checks import counted
from rendezvous_env.scenario import scenarios

from .. import results
from ..checks import UserError, user_error
from ..leaderboard import run_records, tables
from ..leaderboard.replays import path_of, read_replay
from ..learn.settings import EVALUATION_SEEDS
from .skeleton import PLAYER, Replay, assemble, elements, figures, part, player_data, terms

_FIGURES = ("price.png", "profiles.png")


def is_one(folder: Path) -> bool:
    """True if a folder was written by ``leaderboard``."""
    return (folder / "leaderboard.csv").is_file()


def page(folder: Path) -> str:
    """The page as HTML; a UserError if a run record, replay or table is missing or unreadable."""
    found, path = run_records.read_records(folder), folder / "leaderboard.csv"
    with user_error(f"{path}: not readable: ", OSError, ValueError):
        rows = results.read_csv(path)
    whole_rows = all(tuple(row) == tables.COLUMNS and None not in row.values() for row in rows)
    algorithms = sorted({card["algorithm"] for card in found})
    if not found or not whole_rows or sorted(row["algorithm"] for row in rows) != algorithms:
        raise UserError(f"{path}: has no cells, or is of another version; run leaderboard again")
    drawn = [folder / name for name in _FIGURES if (folder / name).is_file()]
    shown = [_replays(folder, card) for card in found]
    replays = list(chain.from_iterable(shown))
    sections = Template(part("board.html")).substitute(
        replay=part("replay.html") if replays else "",
        figures=figures(drawn),
        about=_about(found, sum(map(bool, shown))),
    )
    names = sorted({card["field"] for card in found}, key=lambda name: (len(name), name))
    cells = [_cell(card, bool(own)) for card, own in zip(found, shown, strict=True)]
    played = [one for row in rows for one in cells if one["algorithm"] == row["algorithm"]]
    data = player_data(replays, {name: scenarios.get(name) for name in names}) | {
        "run": {"seed": str(EVALUATION_SEEDS)},
        "folder": shlex.quote(str(folder)),
        "board": rows,
        "cells": cells,
        "rankings": [],
        "leaders": [one["replay"] for one in played if one["replay"]],
        "results": [
            {
                "scenario": one["scenario"],
                "policy": one["replay"],
                "collision_free_success": one["collision_free"],
            }
            for one in cells
        ],
    }
    links = ("Results", "Replay", "Figures", "Runs", "About")
    scripts = ("data", "choice", "save", *PLAYER, "tables", "board", "replay")
    return assemble(
        "Rendezvous: leaderboard", links, sections, data, scripts, recordings=elements(replays)
    )


def _policy(card: run_records.RunRecord) -> str:
    """Policy name of a replay, with the seed of a learned one."""
    seed = f", seed {card['seed']}" if card["decisions"] else ""
    return f"{card['algorithm']}{seed}"


def _replays(folder: Path, card: run_records.RunRecord) -> list[Replay]:
    """Replays of a run, with the recorded result of each episode."""
    found, kept = card["results"], path_of(run_records.path_in(folder, card))
    names = {
        "success": "success", "collision_free": "clean", "time": "time", "contacts": "touches",
    }  # fmt: skip
    return [
        Replay(
            card["field"], _policy(card), start, vars(one),
            {name: str(found[own][start]) for name, own in names.items()},
        )
        for start, one in read_replay(kept, found).items()
    ]  # fmt: skip


def _cell(card: run_records.RunRecord, is_replayed: bool) -> dict[str, str]:
    """Row of the table of runs, with numbers as text."""
    name, found = run_records.place_of(card).name, card["results"]
    row: dict[str, Any] = {"collision_free": float(np.mean(found["clean"]))}
    row["time"] = float(np.mean(found["time"]))
    row |= {key: 1000.0 * sum(found[key]) / sum(found["steps"]) for key in ("touches", "risen")}
    row |= {"algorithm": card["algorithm"], "scenario": card["field"], "seed": card["seed"]}
    row |= {"replay": _policy(card) if is_replayed else "", "card": f"cells/{name}.json"}
    row["seconds"] = card["learning_s"] + 2.0 * card["playing_s"]
    return {key: str(value) for key, value in row.items()}


def _about(found: list[run_records.RunRecord], replays: int) -> str:
    learned = sorted({card["decisions"] for card in found} - {0})
    fields = {card["field"]: f"{card['field']} ({card['digest'][:12]}…)" for card in found}
    versions = sorted({f"{k} {v}" for card in found for k, v in card["versions"].items()})
    lines = {
        "Fields": ", ".join(fields.values()),
        "Budget": f"{' or '.join(map(str, learned)) or 'no'} decisions of robots for each learner, "
        f"{counted(found[0]['episodes'], 'held-out initial condition')} a run",
        "Seeds": ", ".join(map(str, sorted({card["seed"] for card in found}))),
        "Versions": ", ".join(versions),
        "Replays": f"of {replays} of {counted(len(found), 'run')}: the first held-out initial "
        "condition, equal for all, and the first with the other outcome, collision-free or not. "
        "Each was recorded in a second run with equal results on all initial conditions; a "
        "replay of other results is rejected. Frames are subsampled to keep the folder small, "
        "positions rounded to 16 bits",
        "Again": "rendezvous leaderboard --repeat RECORD repeats a run and compares it",
    }
    return terms(lines)
