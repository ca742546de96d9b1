"""``rendezvous leaderboard``: train, play, tell; cell by cell, so that it can be stopped."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rendezvous_env.baselines.learned.plain_data import read_json
from rich.console import Console

from rendezvous_env.scenario import scenarios

from .. import results
from ..checks import UserError
from ..compare.playing import Task, play_all
from ..resume import Part, claimed, program, read
from . import registry, tables
from .playing import play
from .settings import EXAMPLES as EXAMPLES
from .settings import FLAG_GROUPS as FLAG_GROUPS
from .settings import Config, Place, plan

Card = dict[str, Any]
_SAME = ("algorithm", "field", "digest", "seed", "decisions", "starts", "results")
"""Of a card, what a repetition finds again."""


def run(config: Config) -> int:
    """Do all cells, write cards, tables and figures; or repeat one.

    Returns:
        Exit status: 1 if a repeated cell differs from its card, else 0.

    Raises:
        UserError: for an unknown name, an impossible number or a folder that cannot be written.
    """
    console = Console()
    if config.repeat is not None:
        return _repeat(config.repeat, console)
    places = plan(config)
    out = Path(config.out)
    asked = {**program(), "cells": [list(place) for place in places]}
    with claimed(out.parent, f".{out.name}.lock", f"--out {out}"):
        part = Part(out.with_name(f"{out.name}.part"), asked, "leaderboard")
        part.begin(out, fresh=config.fresh)
        with part.at_work(console):
            tasks = [_task(number, place) for number, place in enumerate(places)]
            done, _ = play_all(tasks, config, part, console)
            cards = [done[task.name] for task in tasks]
            write(out, cards, console)
            part.discard()
    return 0


def _task(number: int, place: Place) -> Task:
    scenario = scenarios.get(place.field)
    label = f"{place.algorithm} · {place.field} · {place.seed}"
    return Task(f"cell-{number:04d}", label, scenario, 1, partial(card_of, place))


def card_of(place: Place) -> Card:
    """Do a cell: all that it takes to do it again, and the raw numbers of every start."""
    algorithm, scenario = registry.find(place.algorithm), scenarios.get(place.field)
    began = time.perf_counter()
    player, settings = algorithm.learn(scenario, place.seed, registry.Budget(place.decisions))
    learned = time.perf_counter()
    found = play(player(place.starts))
    return {
        "algorithm": place.algorithm,
        "about": algorithm.about,
        "safety": algorithm.safety,
        "guarantee": algorithm.guarantee,
        "given": algorithm.given,
        "field": scenarios.versioned(scenario.name),
        "digest": scenarios.digests()[place.field],
        "seed": place.seed,
        "decisions": place.decisions if algorithm.learns else 0,
        "starts": place.starts,
        "settings": settings,
        "command": place.command,
        "versions": results.provenance(_packages(algorithm.learns))["versions"],
        "learning_s": round(learned - began, 1),
        "playing_s": round(time.perf_counter() - learned, 1),
        "results": found,
    }


def _packages(learns: bool) -> Sequence[str]:
    return ("torch", "stable-baselines3") if learns else ()


def write(out: Path, cards: Sequence[Card], console: Console) -> None:
    """Write the folder anew: a card for each cell, tables, figures; print the table."""
    if (out / "cells").is_dir():
        shutil.rmtree(out / "cells")
    for card in cards:
        path = out / "cells" / card["algorithm"] / f"{_name_of(card)}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in card.items())
        with results.atomic(path) as temporary:
            temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    rows = tables.rows_of(cards)
    results.write_csv(out / "leaderboard.csv", tuple(tables.COLUMNS), rows)
    results.write_csv(out / "improvement.csv", tables.IMPROVEMENT, tables.improvements(cards))
    tables.draw(out, cards, rows)
    (out / "README.md").write_text(tables.markdown(rows, cards), encoding="utf-8")
    Console(width=max(console.width, tables.WIDTH)).print(tables.text(rows))
    console.print(f"{len(cards)} cells; files in {out}", soft_wrap=True)


def _name_of(card: Card) -> str:
    return f"{card['field'].partition('/')[2]}-seed-{card['seed']}"


def read_cards(out: Path) -> list[Card]:
    """The cards of a folder that ``write`` wrote, by algorithm, field and seed."""
    return [read(path) for path in sorted((out / "cells").glob("*/*.json"))]


def _repeat(path: Path, console: Console) -> int:
    try:
        card = dict(read_json(path))
        words = card["field"].partition("/")[2], card["seed"], card["decisions"], card["starts"]
        place = Place(card["algorithm"], *words)
        scenarios.get(place.field)
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise UserError(f"--repeat {path}: no results card of this version ({error})") from error
    place = place if place.decisions else replace_decisions(place)
    again = card_of(place)
    differ = [key for key in _SAME if again[key] != card.get(key)]
    if not differ:
        console.print(f"{place.name}: the same, bit for bit", soft_wrap=True)
        return 0
    other = [k for k, v in again["versions"].items() if card.get("versions", {}).get(k) != v]
    told = f" (other versions of {', '.join(other)})" if other else ""
    print(f"error: {place.name}: {', '.join(differ)} differ{told}", file=sys.stderr)
    return 1


def replace_decisions(place: Place) -> Place:
    """Of what does not learn the budget is 0, which no learner has."""
    return place._replace(decisions=1)


__all__ = ["Config", "card_of", "read_cards", "run", "write"]
