"""Run records: the result of an (algorithm, scenario, seed) run and all settings to repeat it."""

import json
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from rendezvous_env.baselines.learned import plain_data

from rendezvous_env.checks import check_int
from rendezvous_env.scenario import scenarios

from .. import results
from ..checks import UserError
from ..learn.settings import MAX_SEED
from . import registry
from .playing import play
from .replays import Replay, path_of, replay_of, write_replay

RunRecord = dict[str, Any]
Run = tuple[RunRecord, Replay | None]
_TYPES = {
    **dict.fromkeys(("algorithm", "safety", "given", "field", "digest"), str),
    **dict.fromkeys(("seed", "decisions", "episodes"), int),
    "guarantee": Literal["none", "heading", "tank"],
    "versions": dict[str, str],
    **dict.fromkeys(("learning_s", "playing_s"), float),
    "results": dict[str, list[float]],
}
"""Types of the entries of a run record that tables and pages read."""
_BOUNDS = ("seed", 0, MAX_SEED), ("decisions", 0, 2**62), ("episodes", 1, 2**62)
_RESULTS = ("success", "clean", "time", "touches", "risen", "rise", "steps")


class RunKey(NamedTuple):
    """Identity of a run: algorithm, scenario and seed."""

    algorithm: str
    field: str  # with version, without namespace
    seed: int
    decisions: int  # 0 without training
    episodes: int

    @property
    def name(self) -> str:
        """File name of the run record, without folder."""
        return f"{self.algorithm}/{self.field}-seed-{self.seed}"

    @property
    def command(self) -> str:
        """Command line that repeats this run alone."""
        budget = f" --decisions {self.decisions}" if self.decisions else ""
        return (
            f"rendezvous leaderboard --algorithms {self.algorithm} --fields {self.field} "
            f"--seeds {self.seed}{budget} --episodes {self.episodes}"
        )


def run_of(place: RunKey, record: bool) -> Run:
    """Train and evaluate one run.

    The record contains everything needed to repeat the run and the raw result of every initial
    condition. With ``record`` there may be a replay, see ``replay_of``.
    """
    algorithm, scenario = registry.find(place.algorithm), scenarios.get(place.field)
    began = time.perf_counter()
    player, settings = algorithm.learn(scenario, place.seed, registry.Budget(place.decisions))
    learned = time.perf_counter()
    found = play(player(place.episodes))
    played = time.perf_counter()
    card = {
        "algorithm": place.algorithm,
        "about": algorithm.about,
        "safety": algorithm.safety,
        "guarantee": algorithm.guarantee,
        "given": algorithm.given,
        **results.versioned(scenario),
        "seed": place.seed,
        "decisions": place.decisions,
        "episodes": place.episodes,
        "settings": settings,
        "command": place.command,
        "versions": results.provenance(algorithm.packages)["versions"],
        "learning_s": round(learned - began, 1),
        "playing_s": round(played - learned, 1),
        "results": found,
    }
    return card, replay_of(found, player(place.episodes)) if record else None


def write_run(folder: Path, card: RunRecord, replay: Replay | None) -> None:
    """Write a run record for ``read_records``, one line per entry, and its replay."""
    path = path_in(folder, card)
    if replay is not None:
        write_replay(path_of(path), replay)
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in card.items())
    results.write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def path_in(folder: Path, card: RunRecord) -> Path:
    """Path of a run record in a leaderboard folder."""
    return folder / "cells" / f"{place_of(card).name}.json"


def has_replay(folder: Path, card: RunRecord) -> bool:
    """True if a leaderboard folder holds a replay of a run."""
    return path_of(path_in(folder, card)).exists()


def read_records(out: Path) -> list[RunRecord]:
    """Run records of a folder, sorted by algorithm, scenario and seed.

    Raises:
        UserError: as ``read_record``, and for a file with the name of another run.
    """
    found = {path: read_record(path) for path in (out / "cells").glob("*/*.json")}
    for path, card in found.items():
        if path != path_in(out, card):
            raise UserError(f"{path}: is the record of {place_of(card).name}; remove it")
    return sorted(found.values(), key=place_of)


def read_record(path: Path) -> RunRecord:
    """Read a run record of this version's scenarios; a UserError if it is not one."""
    try:
        card = _in_current_words(plain_data.read_json(path))
        plain_data.check_types(card, _TYPES)
        field = results.versioned(scenarios.get(place_of(card).field))
        if field["digest"] != card["digest"]:
            raise ValueError("digest of other initial conditions")
        if field["field"] != card["field"]:
            raise ValueError(f"field is {card['field']!r}; it must be {field['field']!r}")
        for key, least, most in _BOUNDS:
            check_int(key, card[key], least, most)
        if any(len(card["results"][name]) != card["episodes"] for name in _RESULTS):
            raise ValueError("other number of episodes")
        numbers = np.array([card["results"][name] for name in _RESULTS], np.float64)
        sound = np.isfinite(numbers) & (numbers >= 0.0)
        if not sound.all() or not (numbers[:2] <= 1.0).all() or not numbers[-1].any():
            raise ValueError("invalid results")
    except (OSError, KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise UserError(f"{path}: not a run record of this version ({error})") from error
    return card


def _in_current_words(card: RunRecord) -> RunRecord:
    """Entries of a record, also of one whose entry "episodes" has its former name."""
    return {"episodes" if key == "starts" else key: value for key, value in card.items()}


def place_of(card: RunRecord) -> RunKey:
    """Identity of the run that a record describes."""
    field = card["field"].partition("/")[2]
    return RunKey(card["algorithm"], field, card["seed"], card["decisions"], card["episodes"])
