"""Recordings of single environments of a batch, with a limited number of frames."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.checks import counted
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.obstacles.moving import moves
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Step

MAX_FRAMES = 400
"""Maximum number of frames per episode; longer episodes keep every second, fourth, … step."""

ARRAYS = {
    "times": "(T,), s",
    "positions": "(T, n, d), m",
    "headings": "(T, n, k), rad: yaw, or yaw and pitch; k is 0 where a model has none",
    "velocities": "(T, n, v), m/s; v is d for robots with inertia, else 0",
    "frames": "(T, n, d, d), rotations R_i from the robots' own frames to the world",
    "active": "(T, n), whether the robot is active (not merged)",
    "merged_into": "(T, n), index of the robot that each one has merged into; its own while active",
    "lyapunov": "(T,), V, m²/s",
    "lyapunov_before_merge": "(T,), V just before the first merge of the step that led to the "
    "frame, m²/s; NaN if there was none",
    "lyapunov_after_merge": "(T,), V just after the last merge of that step, m²/s, or NaN",
    "contacts": "(T, n), steps with a contact up to the frame",
    "alignment": "(T, n), of the step that led to the frame; NaN where there is none",
    "observations": "(T, n, rows, d), observations; only with imperfect sensors, links that are "
    "not fixed and undirected, or models with further memory; otherwise ``report`` recomputes "
    "them",
    "weights": "(changes, links), otherwise: the links at the start and after each merge, as in "
    "``Simulator.get_state``",
    "first": "(changes, links), lower robot of each link, likewise; for large sparse graphs only",
    "second": "(changes, links), higher robot of each link, likewise",
    "obstacles": "(M, columns), one row each, see ``rendezvous_env.obstacles.shape``",
    "obstacle_offsets": "(T, M, d), displacements from there, m; only with moving obstacles",
    "conditions": "(T, n), the sum of 1 for a robot that has crashed, 2 for an adversarial one, 4 "
    "for one with a failed sensor, 8 for one that was not active in the last step; only with "
    "asynchronous activation or failures",
}
"""Shape and meaning of the arrays of a recording; their key in trajectories.npz is
scenario/policy/start/name."""
Recording = dict[str, NDArray[Any]]
"""One episode in T frames: the start, some of the steps, every merge and the end.

Arrays are as in ``ARRAYS``. Observations are stored if they cannot be recomputed (see
``is_recomputable``), otherwise links.
"""

_CONDITIONS = {"crashed": 1, "adversarial": 2, "blind": 4}
_INACTIVE = 8

LINKS = ("weights", "first", "second")
"""Entries of a simulator's state that merging changes; the last two are optional."""


def is_recomputable(scenario: Scenario) -> bool:
    """True if observations can be recomputed from recorded states.

    This holds for exact sensors that do not fail, fixed links, obstacles that do not move, and
    robot models without further state.
    """
    model = scenario.model
    recorded = model.n_angles + scenario.dim * model.keeps_velocity
    plain = model.memory_size(scenario.dim) == recorded and not moves(scenario.obstacles)
    exact = scenario.sensing.exact and "blind" not in scenario.events.kinds
    return plain and exact and scenario.sensing_graph.undirected


def state_of(simulator: Simulator) -> Callable[[], Recording]:
    """State of a batch, read once for all recorders on first access."""

    @cache
    def read() -> Recording:
        names = ("time", "positions", "headings", "velocities", "frames", "active", "merged_into")
        state = {name: getattr(simulator, name) for name in names}
        if simulator.obstacle_offsets.size:
            state["obstacle_offsets"] = simulator.obstacle_offsets
        if found := simulator.conditions:
            state["conditions"] = _marks(found, simulator.steps)
        return state | {"lyapunov": simulator.lyapunov()}

    return read


def _marks(found: Recording, steps: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Conditions of robots in the last step, (B, n), see ``ARRAYS``."""
    marks = np.zeros(next(iter(found.values())).shape, np.uint8)
    for name, mark in _CONDITIONS.items():
        if name in found:
            marks |= np.uint8(mark) * found[name]
    if "activated" in found:
        marks |= np.uint8(_INACTIVE) * (~found["activated"] & (steps > 0)[:, None])
    return marks


class EpisodeRecorder:
    """Recorder of one environment of a batch after a reset, with observations unless exact."""

    def __init__(
        self, simulator: Simulator, team: int, observations: NDArray[np.float32], exact: bool
    ) -> None:
        self._simulator, self._team, self._exact = simulator, team, exact
        self._obstacles = simulator.obstacles[team]
        self._active = simulator.active[team]
        self._contacts = np.zeros(len(self._active), dtype=np.int64)
        self._stride = 1
        self._links = [self._links_now()]
        self._frames: list[tuple[int, Recording]] = []
        nothing = np.full(len(self._active), np.nan)
        self._add(state_of(simulator)(), observations[team], nothing)

    def _step(self) -> int:
        return int(self._simulator.steps[self._team])

    def _links_now(self) -> Recording:
        state = self._simulator.get_state()
        return {name: state[name][self._team] for name in LINKS if name in state}

    def see(
        self, step: Step, alignments: NDArray[np.float64], after: Callable[[], Recording]
    ) -> None:
        """Record a step from alignments (B, n) and the ``state_of`` the batch after it."""
        team, outcome = self._team, step.outcome
        if not step.running[team]:
            return
        self._contacts += outcome.contact[team]
        merged = bool((outcome.active[team] != self._active).any())
        self._active = outcome.active[team]
        kept = outcome.observations[team], alignments[team]
        if merged:
            self._links.append(self._links_now())
            jump = outcome.lyapunov_before_merge[team], outcome.lyapunov_after_merge[team]
            self._add(after(), *kept, jump)
        elif self._step() % self._stride == 0 or outcome.status[team] != RUNNING:
            self._add(after(), *kept)

    def _add(
        self,
        state: Recording,
        observations: NDArray[np.float32],
        alignment: NDArray[np.float64],
        jump: tuple[float, float] = (np.nan, np.nan),
    ) -> None:
        """Store a frame; drop every second one if there are too many."""
        team = self._team
        kept = ("positions", "headings", "velocities", "frames", "active")
        frame = {
            "times": state["time"][team],
            **{name: state[name][team].copy() for name in kept},
            "merged_into": state["merged_into"][team].astype(np.int32),
            "lyapunov": state["lyapunov"][team],
            "lyapunov_before_merge": np.float64(jump[0]),
            "lyapunov_after_merge": np.float64(jump[1]),
            "contacts": self._contacts.copy(),
            "alignment": alignment.astype(np.float32),
        }
        for name in ("obstacle_offsets", "conditions"):
            if name in state:
                frame[name] = state[name][team].copy()
        if not self._exact:
            frame["observations"] = observations.copy()
        if len(self._frames) >= MAX_FRAMES:
            self._stride *= 2
            self._frames = [
                (step, one)
                for step, one in self._frames
                if step % self._stride == 0 or not np.isnan(one["lyapunov_before_merge"])
            ]
        self._frames.append((self._step(), frame))

    def finish(self) -> Recording:
        """Recording of the finished episode."""
        frames = [frame for _, frame in self._frames]
        stacked = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
        if self._exact:
            for name in self._links[0]:
                stacked[name] = np.stack([row[name] for row in self._links])
        return stacked | {"obstacles": self._obstacles}


def with_observations(recording: Recording, scenario: Scenario) -> Recording:
    """Recording with its observations; raises as ``observations``."""
    if "observations" in recording:
        return recording
    return recording | {"observations": observations(recording, scenario)}


def observations(recording: Recording, scenario: Scenario) -> NDArray[np.float32]:
    """Observations of an exact sensor in each frame, (T, n, rows, d), bitwise as in the episode.

    Raises:
        ValueError: naming an entry that is invalid in the scenario.
    """
    into = recording["merged_into"]
    frames = len(into)
    simulator = Simulator(scenario, frames)  # one environment per frame
    state = simulator.get_state()
    merged = (into[1:] != into[:-1]).any(axis=-1)
    row = np.concatenate([[0], np.cumsum(merged)])
    tables = {name: recording.get(name, np.zeros((0, 0))) for name in LINKS if name in state}
    for name, table in tables.items():
        if len(table) != row[-1] + 1:
            raise ValueError(f"{name} has {counted(len(table), 'row')}; it must have {row[-1] + 1}")
    state |= {name: table[row] for name, table in tables.items()}
    state |= {
        "positions": recording["positions"],
        "memory": np.concatenate([recording["headings"], recording["velocities"]], axis=-1),
        "merged_into": into.astype(np.int64),
        "obstacles": np.broadcast_to(recording["obstacles"], state["obstacles"].shape),
        "episode": np.zeros(frames, dtype=np.int64),
        "status": np.where((into == np.arange(into.shape[1])).sum(axis=1) > 1, RUNNING, RENDEZVOUS),
    }
    if "frames" in state:
        state["frames"] = recording["frames"].reshape(state["frames"].shape)
    simulator.set_state(state)
    return simulator.observe()
