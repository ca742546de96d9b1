"""The files of a comparison, but for its figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import results
from ..unfinished import Part
from . import statistics
from .episodes import Episodes
from .plan import Config
from .playing import Played
from .ranking import Ranking, answer

_ROUNDING = 1e-9  # m²/s, of V; a larger rise at a merge above its bound is an error


def write(
    part: Part,
    played: Sequence[Played],
    rows: Sequence[dict[str, Any]],
    pairs: Sequence[dict[str, Any]],
) -> list[str]:
    """Write results.csv, episodes.csv, paired.csv and trajectories.npz; their names."""
    tables = {
        "results.csv": (results.RESULT_COLUMNS, rows),
        "episodes.csv": (results.EPISODE_COLUMNS, _episode_rows(played)),
        "paired.csv": (results.PAIRED_COLUMNS, pairs),
    }
    for name, (columns, content) in tables.items():
        results.write_csv(part.folder / name, columns, content)
    results.write_arrays(part.folder / "trajectories.npz", _arrays(played), part.run)
    return [*tables, "trajectories.npz"]


def _episode_rows(played: Sequence[Played]) -> Iterator[dict[str, Any]]:
    for done in played:
        head = {"scenario": done.job.scenario.name, "policy": done.job.policy}
        yield from (head | row for row in done.episodes.rows())


def paired_rows(played: Sequence[Played], against: str | None) -> list[dict[str, Any]]:
    """The rows of paired.csv; where ``against`` was not played another is the reference."""
    by_scenario: dict[str, dict[str, Episodes]] = {}
    for done in played:
        by_scenario.setdefault(done.job.scenario.name, {})[done.job.policy] = done.episodes
    return [
        row
        for scenario, episodes in by_scenario.items()
        for row in statistics.compare_pairs(
            scenario, episodes, against if against in episodes else None
        )
    ]


def _arrays(played: Sequence[Played]) -> dict[str, np.ndarray[Any, Any]]:
    """Recorded arrays under scenario/policy/start/name."""
    return {
        f"{done.job.scenario.name}/{done.job.policy}/{start}/{name}": array
        for done in played
        for start, recording in enumerate(done.recordings)
        for name, array in recording.items()
    }


def description(
    config: Config, played: Sequence[Played], timing: dict[str, float]
) -> dict[str, Any]:
    """What run.json says of a comparison."""
    used = {done.job.scenario.name: done.job.scenario for done in played}
    return results.provenance() | {
        "seed": config.seed,
        "episodes": config.episodes or max(len(done.episodes.success) for done in played),
        "keep": max(len(done.recordings) for done in played),
        "starts": {done.job.scenario.name: len(done.episodes.success) for done in played},
        "scenarios": {name: scenario.to_plain() for name, scenario in used.items()},
        "policies": {
            name: [done.job.policy for done in played if done.job.scenario.name == name]
            for name in used
        },
        "merges_above_bound": count_excess(played),
        "timing": timing,
    }


def write_summary(
    path: Path,
    rankings: Sequence[Ranking],
    rows: Sequence[dict[str, Any]],
    pairs: Sequence[dict[str, Any]],
    about: Mapping[str, Any],
) -> None:
    """Write all that was found in short, as JSON: what ``--json`` asks for.

    The names of columns are those of results.csv and paired.csv; null where it does not apply.
    """
    results.write_json(
        path,
        {
            "answer": answer(rankings),
            "scenarios": {
                ranking.scenario: {
                    "starts": ranking.starts,
                    "best": ranking.best if ranking.is_contest else None,
                    "tied": list(ranking.tied),
                    "references": list(ranking.references),
                    "policies": {
                        row["policy"]: _plain(row, results.RESULT_COLUMNS[2:])
                        for row in rows
                        if row["scenario"] == ranking.scenario
                    },
                }
                for ranking in rankings
            },
            "paired": [_plain(row, results.PAIRED_COLUMNS) for row in pairs],
            **about,
        },
    )


def _plain(row: Mapping[str, Any], columns: Sequence[str]) -> dict[str, Any]:
    """Cells as numbers and words, null where they are empty."""
    cells = {column: results.plain(row[column]) for column in columns}
    return {column: None if cell == "" else cell for column, cell in cells.items()}


def count_excess(played: Sequence[Played]) -> int:
    """Episodes in which a merge raised V above its proven bound."""
    return sum(int((done.episodes.merge_excess > _ROUNDING).sum()) for done in played)
