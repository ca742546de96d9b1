"""Replays of two episodes of a run, small enough to be stored beside its record."""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.learned import plain_data

from rendezvous_env.engine.memory import RUNNING
from rendezvous_env.outcome import StepOutput
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Step

from .. import results
from ..checks import UserError
from ..compare.evaluation import alignments
from ..encoding import Encoded, encode_all
from ..recording import EpisodeRecorder, Recording, state_of
from .playing import EvaluationSetup, play

BUDGET = 20_000
"""Maximum size of the recordings of a run, in characters; longer ones are subsampled."""
_TEXT = re.compile(r"[\w+/]+=*", re.ASCII)
Replay = dict[str, Any]
"""Contents of a file in OUT/replays: "starts", by number, each an ``Encoded``; and the digest "
""sha256" of
them and of the results in its record."""


def play_and_record(
    player: EvaluationSetup, starts: Sequence[int]
) -> tuple[dict[str, list[Any]], list[Recording]]:
    """As ``play``, with recordings of the environments with these indices.

    It observes ``Simulator.step``, independent of the caller.
    """
    recorders: list[EpisodeRecorder] = []

    def begin(simulator: Simulator) -> None:
        step, seen = simulator.step, simulator.observe()
        recorders.extend(EpisodeRecorder(simulator, team, seen, exact=False) for team in starts)

        def watched(actions: NDArray[np.float32]) -> StepOutput:
            nonlocal seen
            running, before = simulator.status == RUNNING, simulator.lyapunov()
            outcome = step(actions)
            done = Step(running, seen, actions, before, outcome)
            aligned, after = alignments(simulator.scenario, done), state_of(simulator)
            for recorder in recorders:
                recorder.see(done, aligned, after)
            seen = outcome.observations
            return outcome

        vars(simulator)["step"] = watched

    found = play(player, begin)
    return found, [recorder.finish() for recorder in recorders]


def replay_of(found: dict[str, Any], player: EvaluationSetup) -> Replay | None:
    """Repeat the evaluation with a new player and record two episodes.

    They are the first initial condition, equal for all runs, and the first one with the opposite
    result. None if the repetition differs from ``found``.
    """
    clean = found["clean"]
    starts = [0, *[start for start, one in enumerate(clean) if one != clean[0]][:1]]
    again, recordings = play_and_record(player, starts)
    if again != found:
        return None
    encoded = zip(starts, encode_all(recordings, BUDGET), strict=True)
    kept = {str(start): asdict(one) for start, one in encoded}
    return {"sha256": _seal(found, kept), "starts": kept}


def _seal(found: dict[str, Any], kept: dict[str, Any]) -> str:
    return plain_data.digest({"results": found, "starts": kept})


def path_of(card: Path) -> Path:
    """Path of the replay of a run: OUT/replays mirrors OUT/cells; a UserError elsewhere."""
    folders = card.absolute().parents
    if len(folders) < 3 or folders[1].name != "cells":
        raise UserError(f"{card}: a replay belongs to a record in OUT/cells/ALGORITHM")
    return folders[2] / "replays" / folders[0].name / card.name


def write_replay(path: Path, replay: Replay) -> None:
    """Write a replay for ``read_replay``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    results.write_text(path, json.dumps(replay, separators=(",", ":")) + "\n")


def read_replay(path: Path, found: dict[str, Any]) -> dict[int, Encoded]:
    """Recorded episodes by initial condition; empty if there is no file.

    Raises:
        UserError: if the replay belongs to other results than those of the record.
    """
    try:
        replay = plain_data.read_json(path)
        if replay["sha256"] != _seal(found, replay["starts"]):
            raise ValueError("changed, or of other results")
        kept = {int(start): Encoded(**one) for start, one in replay["starts"].items()}
        if not all(_TEXT.fullmatch(one.text) for one in kept.values()):
            raise ValueError("its text is not base64")
    except FileNotFoundError:
        return {}
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise UserError(f"{path}: not the replay of its record ({error}); remove it") from error
    return kept
