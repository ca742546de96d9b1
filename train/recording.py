"""Keep what one team of a batch does, in no more frames than a picture can show."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.engine.memory import RUNNING
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Step

MAX_FRAMES = 400
"""Frames kept of one episode; of a longer one only every second, fourth, … step is kept."""

Recording = dict[str, NDArray[Any]]
"""One team's episode over T frames (the start, some of the steps, every merge and the end):

times (T,) s; positions (T, n, d) m; headings (T, n, k) rad; velocities (T, n, d) m/s, of robots
with inertia, else (T, n, 0); active (T, n); merged_into (T, n), see ``Simulator.merged_into``;
lyapunov (T,) m²/s; frames (T, n, d, d), rotations R_i from the robots' own frames to the world;
contacts (T, n), steps with a contact up to the frame; alignment (T, n), of the step that led to the
frame, NaN where there is none; obstacles (M, width), a table as ``experiment.packing`` says;
lyapunov_before_merge and lyapunov_after_merge (T,), V just before the first and just after the last
merge of the step that led to the frame, m²/s, NaN if there was none; observations (T, n, rows, d),
as the robots saw them.

A recording that is kept has observations only where they cannot be found again
(``seeing_again.observations``); else it has links: of the start and after each merge, one row for
each, as ``Simulator.get_state`` gives them.
"""

LINKS = ("weights", "first", "second")
"""Entries of a simulator's state that merging changes, of which a team may have the last two."""


class Snapshot:
    """The state of a batch at one moment, each part taken out once and only if it is asked for."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator

    def __getattr__(self, name: str) -> NDArray[Any]:
        """The simulator's array of that name; it stands in the instance from then on."""
        value = getattr(self._simulator, name)
        self.__dict__[name] = value() if callable(value) else value
        return self.__dict__[name]

    def links(self, team: int) -> Recording:
        """The links of a team, by the names that its state has for them."""
        return {name: self.get_state[name][team] for name in LINKS if name in self.get_state}


class Recorder:
    """Records one team of a batch.

    Args:
        start: the batch, freshly reset.
        team: which one.
        observations: of the start, (B, n, rows, d).
        exact: whether robots see nothing but what follows from where they are.
    """

    def __init__(
        self, start: Snapshot, team: int, observations: NDArray[np.float32], exact: bool
    ) -> None:
        self._team, self._exact = team, exact
        self._obstacles = start.obstacles[team]
        self._active = start.active[team]
        self._contacts = np.zeros(len(self._active), dtype=np.int64)
        self._stride = 1
        self._links = [start.links(team)]
        self._frames: list[tuple[int, Recording]] = []
        alignment = np.full(len(self._active), np.nan)
        self._add(start, observations[team], alignment, (np.nan, np.nan))

    def see(self, step: Step, alignments: NDArray[np.float64], after: Snapshot) -> None:
        """Take in one step, the alignments (B, n) of its robots, and what it led to."""
        team, outcome = self._team, step.outcome
        if not step.running[team]:
            return
        self._contacts += outcome.contact[team]
        merged = bool((outcome.active[team] != self._active).any())
        self._active = outcome.active[team]
        if merged:
            self._links.append(after.links(team))
            jump = outcome.lyapunov_before_merge[team], outcome.lyapunov_after_merge[team]
            self._add(after, outcome.observations[team], alignments[team], jump)
        elif after.steps[team] % self._stride == 0 or outcome.status[team] != RUNNING:
            nothing = np.nan, np.nan
            self._add(after, outcome.observations[team], alignments[team], nothing)

    def _add(
        self,
        state: Snapshot,
        observations: NDArray[np.float32],
        alignment: NDArray[np.float64],
        jump: tuple[float, float],
    ) -> None:
        """Keep a frame, and thin out if there are too many."""
        team = self._team
        frame = {
            "times": state.time[team],
            "positions": state.positions[team].copy(),
            "headings": state.headings[team].copy(),
            "velocities": state.velocities[team].copy(),
            "frames": state.frames[team].copy(),
            "active": state.active[team].copy(),
            "merged_into": state.merged_into[team].astype(np.int32),
            "lyapunov": state.lyapunov[team],
            "lyapunov_before_merge": np.float64(jump[0]),
            "lyapunov_after_merge": np.float64(jump[1]),
            "contacts": self._contacts.copy(),
            "alignment": alignment.astype(np.float32),
        }
        if not self._exact:
            frame["observations"] = observations.copy()
        if len(self._frames) >= MAX_FRAMES:
            self._stride *= 2
            self._frames = [entry for entry in self._frames if self._stays(*entry)]
        self._frames.append((int(state.steps[team]), frame))

    def _stays(self, number: int, frame: Recording) -> bool:
        merged = not np.isnan(frame["lyapunov_before_merge"])
        return merged or number % self._stride == 0

    def finish(self) -> Recording:
        """The recording, once the team has finished."""
        frames = [frame for _, frame in self._frames]
        stacked = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
        if self._exact:
            stacked |= {
                name: np.stack([row[name] for row in self._links]) for name in self._links[0]
            }
        return stacked | {"obstacles": self._obstacles}
