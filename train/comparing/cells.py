"""What a comparison consists of, and its finished parts on disk.

A cell is a block of starts of one policy on one scenario, or one run of a ceiling. It depends on
nothing but the plan, so a comparison that goes on after a kill finds what an uninterrupted one
would have found.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import baselines
import rendezvous_env
import train
from baselines.learned import checkpoints

from .. import policies, results
from ..recording import Recording
from .ceiling import Run
from .episodes import Episodes
from .out_folder import Part
from .plan import Config, Job

Cell = tuple[Episodes, list[Recording]]


def plan_of(jobs: Sequence[Job], config: Config) -> dict[str, Any]:
    """All that the numbers of a comparison depend on, as plain data."""
    scenarios = list(dict.fromkeys(job.scenario for job in jobs))
    about = results.provenance()
    return {
        **{key: about[key] for key in ("format_version", "versions")},
        "source": _source(),
        **{name: getattr(config, name) for name in ("seed", "episodes", "keep", "ceiling")},
        "scenarios": [scenario.to_plain() for scenario in scenarios],
        "policies": [
            [job.policy for job in jobs if job.scenario == scenario] for scenario in scenarios
        ],
        "weights": {name: _weights(name) for name in sorted({job.policy for job in jobs})},
    }


def _weights(policy: str) -> str | None:
    """Digest of a learned policy's checkpoint, or of the file that holds a policy: an exported
    network, or the source of a scripted one.

    None for one that was typed in and stands in no file.
    """
    learned = policies.learned_path(policy)
    if learned is not None and not learned.is_file():
        return str(checkpoints.describe(checkpoints.find(learned))["sha256"])
    path = learned or policies.source_file(policy)
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def _source() -> str:
    """Digest of the program's own files, which change more often than its version."""
    found = hashlib.sha256()
    for package in (rendezvous_env, baselines, train):
        for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()


# ---- cells --------------------------------------------------------------------------------------


def save(part: Part, name: str, cell: Cell) -> None:
    """Keep the cell of a task."""
    episodes, recordings = cell
    arrays = {f"episodes/{field.name}": getattr(episodes, field.name) for field in fields(Episodes)}
    for start, recording in enumerate(recordings):
        arrays |= {f"{start}/{name}": array for name, array in recording.items()}
    results.write_arrays(part.cell(name), arrays, part.run, packed=False)


def load(part: Part, name: str) -> Cell | None:
    """The cell of a task; None if it is not finished, or cannot be read."""
    arrays = _read(part, name)
    if arrays is None:
        return None
    episodes = Episodes(*(arrays.pop(f"episodes/{field.name}") for field in fields(Episodes)))
    recordings: dict[int, Recording] = {}
    for name, array in arrays.items():
        start, _, kind = name.partition("/")
        recordings.setdefault(int(start), {})[kind] = array
    return episodes, [recordings[start] for start in sorted(recordings)]


def save_run(part: Part, name: str, run: Run) -> None:
    """Keep a run of a ceiling."""
    results.write_arrays(part.cell(name), run._asdict(), part.run, packed=False)


def load_run(part: Part, name: str) -> Run | None:
    """A run of a ceiling; None if it is not finished, or cannot be read."""
    arrays = _read(part, name)
    return None if arrays is None else Run(**arrays)


def _read(part: Part, name: str) -> dict[str, np.ndarray[Any, Any]] | None:
    try:
        return results.read_arrays(part.cell(name), part.run)
    except (OSError, ValueError):  # not there, or damaged: it is played anew
        return None
