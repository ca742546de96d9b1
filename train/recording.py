"""Keep what one team of a batch does, in no more frames than a picture can show."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Step

MAX_FRAMES = 400
"""Frames kept of one episode; of a longer one only every second, fourth, … step is kept."""

Recording = dict[str, NDArray[Any]]
"""One team's episode over T frames (the start, some of the steps, every merge and the end):

times (T,) s; positions (T, n, d) m; headings (T, n, k) rad; active (T, n); lyapunov (T,) m²/s;
contacts (T, n), steps with a contact up to the frame; alignment (T, n), of the step that led to the
frame, NaN where there is none; observations (T, n, rows, d); obstacles (M, width), packed as
obstacles.py says; lyapunov_before_merge and lyapunov_after_merge (T,), V just before the first and
just after the last merge of the step that led to the frame, m²/s, NaN if there was none.
"""


class Recorder:
    """Records one team of a batch.

    Args:
        simulator: freshly reset.
        team: which one.
        observations: of the start, (B, n, rows, d).
    """

    def __init__(self, simulator: Simulator, team: int, observations: NDArray[np.float32]) -> None:
        self._simulator, self._team = simulator, team
        self._contacts = np.zeros(simulator.scenario.n_robots, dtype=np.int64)
        self._active = simulator.active[team]
        self._stride = 1
        self._frames: list[tuple[int, Recording]] = []
        alignment = np.full(simulator.scenario.n_robots, np.nan)
        self._add(observations[team], alignment, (np.nan, np.nan))

    def see(self, step: Step, alignments: NDArray[np.float64]) -> None:
        """Take in one step and the alignments (B, n) of its robots."""
        team, outcome = self._team, step.outcome
        if not step.running[team]:
            return
        self._contacts += outcome.contact[team]
        merged = bool((outcome.active[team] != self._active).any())
        self._active = outcome.active[team]
        number = int(self._simulator.steps[team])
        if merged:
            jump = outcome.lyapunov_before_merge[team], outcome.lyapunov_after_merge[team]
            self._add(outcome.observations[team], alignments[team], jump)
        elif number % self._stride == 0 or self._simulator.ended[team]:
            self._add(outcome.observations[team], alignments[team], (np.nan, np.nan))

    def _add(
        self,
        observations: NDArray[np.float32],
        alignment: NDArray[np.float64],
        jump: tuple[float, float],
    ) -> None:
        """Keep the present state as a frame, and thin out if there are too many."""
        simulator, team = self._simulator, self._team
        frame = {
            "times": simulator.time[team],
            "positions": simulator.positions[team],
            "headings": simulator.headings[team],
            "active": simulator.active[team],
            "lyapunov": simulator.lyapunov()[team],
            "lyapunov_before_merge": np.float64(jump[0]),
            "lyapunov_after_merge": np.float64(jump[1]),
            "contacts": self._contacts.copy(),
            "alignment": alignment.copy(),
            "observations": observations.copy(),
        }
        self._frames.append((int(simulator.steps[team]), frame))
        if len(self._frames) > MAX_FRAMES:
            self._stride *= 2
            self._frames = [entry for entry in self._frames if self._stays(*entry)]

    def _stays(self, number: int, frame: Recording) -> bool:
        merged = not np.isnan(frame["lyapunov_before_merge"])
        return merged or number % self._stride == 0

    def finish(self) -> Recording:
        """The recording, once the team has finished."""
        frames = [frame for _, frame in self._frames]
        stacked = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
        return stacked | {"obstacles": self._simulator.obstacles[self._team]}
