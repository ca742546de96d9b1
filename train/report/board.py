"""The page of a leaderboard's folder: algorithms, figures, and the card of every run."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .. import results
from ..checks import UserError
from ..leaderboard import cards, tables
from .skeleton import figures, part, terms, whole

_FIGURES = ("price.png", "profiles.png")


def is_one(folder: Path) -> bool:
    """Whether ``leaderboard`` wrote into a folder."""
    return (folder / "leaderboard.csv").is_file()


def page(folder: Path) -> str:
    """The whole page.

    Raises:
        UserError: if a card or table is missing, not readable, or of another version.
    """
    found, path = cards.read_cards(folder), folder / "leaderboard.csv"
    rows = results.read_csv(path)
    if not found or [tuple(row) for row in rows] != [tuple(tables.COLUMNS)] * len(rows):
        raise UserError(f"{path}: without its cells, or of another version; run leaderboard again")
    drawn = [folder / name for name in _FIGURES if (folder / name).is_file()]
    sections = Template(part("board.html")).substitute(figures=figures(drawn), about=_about(found))
    data = {"board": rows, "cells": [_cell(card) for card in found]}
    links = ("Results", "Figures", "Cells", "About")
    scripts = ("data", "save", "tables", "board")
    return whole("Rendezvous: leaderboard", links, sections, data, scripts)


def _cell(card: cards.Card) -> dict[str, str]:
    """A row of the table of runs, its numbers as text."""
    name, found = cards.place_of(card).name, card["results"]
    row: dict[str, Any] = {key: float(np.mean(found[key])) for key in ("clean", "time")}
    row |= {key: 1000.0 * sum(found[key]) / sum(found["steps"]) for key in ("touches", "risen")}
    row |= {"algorithm": card["algorithm"], "scenario": card["field"], "seed": card["seed"]}
    return {key: str(value) for key, value in row.items()} | {"card": f"cells/{name}.json"}


def _about(found: list[cards.Card]) -> str:
    learned = sorted({card["decisions"] for card in found} - {0})
    fields = {card["field"]: f"{card['field']} ({card['digest'][:12]}…)" for card in found}
    versions = sorted({f"{k} {v}" for card in found for k, v in card["versions"].items()})
    lines = {
        "Fields": ", ".join(fields.values()),
        "Budget": f"{' or '.join(map(str, learned)) or 'no'} decisions of robots for each learner, "
        f"{found[0]['starts']} held-out starts a run",
        "Seeds": ", ".join(map(str, sorted({card["seed"] for card in found}))),
        "Versions": ", ".join(versions),
        "Again": "rendezvous leaderboard --repeat CARD does a run again and compares it",
    }
    return terms(lines)
