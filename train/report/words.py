"""What the page says in words: who leads, what was played, what each figure shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from ..compare.evaluation import Episodes
from ..compare.playing import Played
from ..compare.ranking import Ranking, rank
from ..compare.settings import Job
from .input import Comparison, Row

_CAPTIONS = {
    "success": "How many of the starts each policy met on. Open marks: all robots met. Filled: and "
    "none touched an obstacle. Lines: 95 % intervals.",
    "times": "Median time until all robots met, with its 95 % interval; time-outs count as later "
    "than the limit.",
    "against-obstacles": "Collision-free success as obstacles become more. Bars: 95 % intervals.",
    "against-robots": "Collision-free success of teams of different size among the same number of "
    "obstacles. Bars: 95 % intervals.",
    "price": "Collision-free success and time, each against the share of steps in which V rose.",
    "profiles": "The share of runs that reach each level of collision-free success.",
}


def rankings(found: Comparison) -> list[Ranking]:
    """Who wins on each scenario, as ``compare`` says it, from episodes.csv."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for row in found.episodes:
        rows.setdefault((row["scenario"], row["policy"]), []).append(row)
    played = found.run["policies"].items()
    return rank(
        [
            Played(Job(found.scenarios[name], policy), _episodes(rows[name, policy]), {})
            for name, policies in played
            for policy in policies
        ]
    )


def _episodes(rows: Sequence[Mapping[str, str]]) -> Episodes:
    columns = {
        field.name: np.array([float(row[field.name] or "nan") for row in rows])
        for field in fields(Episodes)
    }
    columns["success"] = columns["success"] == 1.0
    return Episodes(**columns)


def counts(found: Comparison) -> str:
    """How many scenarios, policies and starts."""
    policies = {name for played in found.run["policies"].values() for name in played}
    first, count = found.run["seed"], found.run["episodes"]
    starts = f"{count} starts each (seeds {first}–{first + count - 1})"
    single = [name for name, of_it in found.run["starts"].items() if of_it == 1 < count]
    alone = f"; one of {', '.join(single)}, whose start is given" if single else ""
    fewer = "".join(
        f"; {of_it} of {name}" for name, of_it in found.run["starts"].items() if 1 < of_it < count
    )
    return f"{len(found.scenarios)} scenarios, {len(policies)} policies, {starts}{alone}{fewer}"


def caption(stem: str) -> str:
    """What a figure of ``compare`` shows.

    Args:
        stem: name of its file, without the ending.
    """
    kind, _, scenario = stem.partition("-")
    if kind == "trajectories":
        return (
            f"{scenario}: the ways of the robots from the first start under each policy. "
            "Dots: starts. Crosses: merges. Orange: obstacles."
        )
    name, _, number = stem.rpartition("-")
    return _CAPTIONS.get(name if number.isdigit() else stem, stem)
