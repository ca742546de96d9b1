"""What a comparison consists of, and its finished parts on disk.

A cell is a block of starts of one policy on one scenario, or one run of a ceiling.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from baselines.learned import checkpoints

from .. import policies, unfinished
from ..recording import Recording
from ..unfinished import Part
from .ceiling import Run
from .episodes import Episodes
from .plan import Config, Job

Cell = tuple[Episodes, list[Recording]]


def plan_of(jobs: Sequence[Job], config: Config) -> dict[str, Any]:
    """All that the numbers of a comparison depend on, as plain data."""
    scenarios = list(dict.fromkeys(job.scenario for job in jobs))
    return {
        **unfinished.program(),
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


# ---- cells --------------------------------------------------------------------------------------


def save(part: Part, name: str, cell: Cell) -> None:
    """Keep the cell of a task."""
    episodes, recordings = cell
    arrays = {f"episodes/{field.name}": getattr(episodes, field.name) for field in fields(Episodes)}
    for start, recording in enumerate(recordings):
        arrays |= {f"{start}/{name}": array for name, array in recording.items()}
    part.save(name, arrays)


def load(part: Part, name: str) -> Cell | None:
    """The cell of a task; None if it is not finished, or cannot be read."""
    arrays = part.load(name)
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
    part.save(name, run._asdict())


def load_run(part: Part, name: str) -> Run | None:
    """A run of a ceiling; None if it is not finished, or cannot be read."""
    arrays = part.load(name)
    return None if arrays is None else Run(**arrays)
