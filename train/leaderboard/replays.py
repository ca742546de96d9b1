"""Replays: what two starts of a run looked like, small enough to be kept beside its card."""

from __future__ import annotations

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
from ..recording import Recorder, Recording, Snapshot
from .playing import Player, play

BUDGET = 20_000
"""Characters of a run's recordings; what is longer is thinned out."""
_TEXT = re.compile(r"[\w+/]+=*", re.ASCII)
Replay = dict[str, Any]
"""As it lies in OUT/replays: "starts", by number, each an ``Encoded``; and the digest "sha256" of
them and of the results on its card."""


class Watch:
    """Records some teams of a batch, whoever leads it: it stands before ``Simulator.step``.

    Args:
        starts: numbers of teams.
    """

    def __init__(self, starts: Sequence[int]) -> None:
        self._starts = starts

    def begin(self, simulator: Simulator) -> None:
        """Look on from here; the teams have just begun."""
        self._simulator, self._step = simulator, simulator.step
        self._seen, start = simulator.observe(), Snapshot(simulator)
        self._recorders = [Recorder(start, k, self._seen, exact=False) for k in self._starts]
        vars(simulator)["step"] = self._watched

    def _watched(self, actions: NDArray[np.float32]) -> StepOutput:
        simulator = self._simulator
        running, before = simulator.status == RUNNING, simulator.lyapunov()
        outcome = self._step(actions)
        step = Step(running, self._seen, actions, before, outcome)
        aligned, after = alignments(simulator.scenario, step), Snapshot(simulator)
        for recorder in self._recorders:
            recorder.see(step, aligned, after)
        self._seen = outcome.observations
        return outcome

    def recordings(self) -> list[Recording]:
        """Of the teams, once they have finished."""
        return [recorder.finish() for recorder in self._recorders]


def starts_to_show(clean: Sequence[int]) -> list[int]:
    """The first start, which is the same for all runs, and the first that ended otherwise: clean,
    or not.
    """
    return [0, *[start for start, one in enumerate(clean) if one != clean[0]][:1]]


def replay_of(found: dict[str, Any], player: Player) -> Replay | None:
    """Play once more and look on; None of what does not play twice alike.

    Args:
        found: what came of playing, as ``play`` gives it.
        player: a new one of the same.
    """
    watch = Watch(starts := starts_to_show(found["clean"]))
    if play(player, watch.begin) != found:
        return None
    encoded = zip(starts, encode_all(watch.recordings(), BUDGET), strict=True)
    kept = {str(start): asdict(one) for start, one in encoded}
    return {"sha256": _seal(found, kept), "starts": kept}


def _seal(found: dict[str, Any], kept: dict[str, Any]) -> str:
    return plain_data.digest({"results": found, "starts": kept})


def path_of(card: Path) -> Path:
    """Where the replay of a card lies: OUT/replays mirrors OUT/cells.

    Raises:
        UserError: for a card that lies elsewhere.
    """
    folders = card.absolute().parents
    if len(folders) < 3 or folders[1].name != "cells":
        raise UserError(f"{card}: a replay is kept beside a card of OUT/cells/ALGORITHM")
    return folders[2] / "replays" / folders[0].name / card.name


def write_replay(path: Path, replay: Replay) -> None:
    """Write what ``read_replay`` reads."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with results.atomic(path) as temporary:
        temporary.write_text(json.dumps(replay, separators=(",", ":")) + "\n", encoding="utf-8")


def read_replay(path: Path, found: dict[str, Any]) -> dict[int, Encoded]:
    """What was kept of each start; nothing if there is no file.

    Args:
        path: of ``path_of``.
        found: the results on the card, which it must be of.

    Raises:
        UserError: naming the path, if it is no replay of them.
    """
    try:
        replay = plain_data.read_json(path)
        if replay["sha256"] != _seal(found, replay["starts"]):
            raise ValueError("changed, or of other results")
        kept = {int(start): Encoded(**one) for start, one in replay["starts"].items()}
        if not all(_TEXT.fullmatch(one.text) for one in kept.values()):
            raise ValueError("its text is no base64")
    except FileNotFoundError:
        return {}
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise UserError(f"{path}: no replay of its card ({error}); remove it") from error
    return kept
