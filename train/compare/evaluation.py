"""Evaluation of one policy: simulated episodes and their metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.deprecation import renamed_attribute
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.engine.preparation import has_fixed_start
from rendezvous_env.engine.state_checks import check_mask, check_numbers, check_observations
from rendezvous_env.physics.neighbour_rows import net_bearing_of
from rendezvous_env.physics.vectors import X_AXIS, dot, load
from rendezvous_env.safety.theorems.descent import time_bound
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import Policy, Step, run

from ..checks import user_error
from ..recording import EpisodeRecorder, Recording, is_recomputable, state_of

CHUNK = 1024
"""Maximum batch size; further initial conditions are simulated in later chunks."""


@dataclass(frozen=True)
class Episodes:
    """Metrics of one policy from N initial conditions of a scenario; every field is (N,)."""

    success: NDArray[np.bool_]
    """True if all robots met within the time limit."""
    collision_free: NDArray[np.float64]
    """1 for collision-free success, else 0; NaN where robots pass through obstacles."""
    time: NDArray[np.float64]
    """Rendezvous time, s; the time limit without success."""
    path_length: NDArray[np.float64]
    """Total path length of all robots, m."""
    contacts: NDArray[np.int64]
    """Number of contacts with obstacles, counted per robot and step."""
    clearance: NDArray[np.float64]
    """Minimum distance of a robot to an obstacle, m; NaN without obstacles."""
    max_rise_between_merges: NDArray[np.float64]
    """Largest change of V in a step up to its first merge, m²/s; negative if V always decreased."""
    merge_rise: NDArray[np.float64]
    """Largest increase of V at a merge, m²/s."""
    merge_excess: NDArray[np.float64]
    """Excess of an increase of V at a merge over its bound (theory 5), m²/s; 0 unless there is an
    error."""
    min_alignment: NDArray[np.float64]
    """Minimum alignment of robots with ‖f‖ ≥ 2δ, NaN if there was none; see ``alignments``."""
    initial_lyapunov: NDArray[np.float64]
    """Initial V, m²/s."""
    time_bound: NDArray[np.float64]
    """Proven bound on the rendezvous time, s; NaN without one."""
    max_rise_of_size: NDArray[np.float64]
    """Largest change of the hull perimeter L in a step, m; negative if L always decreased. NaN for
    fixed undirected graphs, where V must not increase instead."""

    @classmethod
    def joined(cls, parts: list[Episodes]) -> Episodes:
        """Concatenated episodes."""
        columns = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))

    clean = renamed_attribute("clean", "collision_free")

    @property
    def good(self) -> NDArray[np.bool_]:
        """True for episodes with (collision-free, where contacts count) success, (N,)."""
        return np.where(np.isnan(self.collision_free), self.success, self.collision_free == 1)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Rows of episodes.csv, one per initial condition."""
        columns = {field.name: getattr(self, field.name).tolist() for field in fields(self)}
        free = [None if value != value else int(value) for value in self.collision_free]
        columns["collision_free"] = free
        for k in range(len(self.success)):
            yield {"initial_condition": k} | {name: values[k] for name, values in columns.items()}


def play(
    scenario: Scenario,
    make_policy: Callable[[], Policy],
    *,
    margin: float | None,
    episodes: int,
    seed: int,
    keep: int = 0,
    steps: int | None = None,
    promised: float = np.inf,
) -> tuple[Episodes, list[Recording]]:
    """Run one policy from the seeds ``seed``, ``seed`` + 1, …, the same for every policy.

    A scenario without randomness is run once.

    Args:
        scenario: the experiment.
        make_policy: creates a policy for each chunk of environments.
        margin: minimum alignment ε that the policy guarantees, 1 for law (1), None if none.
        episodes: N.
        seed: seed of the first initial condition.
        keep: number of first initial conditions to record.
        steps: maximum number of steps of an episode; None runs to the end.
        promised: guaranteed rendezvous time from any initial condition, s; it applies if ``margin``
            guarantees none.

    Raises:
        UserError: if no initial condition can be sampled.
    """
    episodes = starts_of(scenario, episodes)
    parts: list[Episodes] = []
    recordings: list[Recording] = []
    for first in range(0, episodes, CHUNK):
        simulator = Simulator(scenario, min(CHUNK, episodes - first))
        with user_error(f"{scenario.name}: ", RuntimeError):  # no initial condition found
            observations = simulator.reset(seed + first)
        kept = range(min(keep, episodes)) if first == 0 else ()
        exact = is_recomputable(scenario)
        recorders = [EpisodeRecorder(simulator, team, observations, exact) for team in kept]
        meter = _Meter(simulator)
        for step in islice(run(simulator, make_policy(), observations), steps):
            aligned, after = meter.see(step), state_of(simulator)
            for recorder in recorders:
                recorder.see(step, aligned, after)
        parts.append(meter.episodes(margin, promised))
        recordings += [recorder.finish() for recorder in recorders]
    return Episodes.joined(parts), recordings


def starts_of(scenario: Scenario, asked: int) -> int:
    """Number of distinct initial conditions, at most the requested number."""
    return 1 if has_fixed_start(scenario) else asked


def counts_contacts(scenario: Scenario) -> bool:
    """True if contacts count, that is, robots do not pass through obstacles."""
    return not scenario.obstacles or scenario.obstacle_contact != "ignore"


class _Meter:
    """Running extrema of the metrics of a batch."""

    def __init__(self, simulator: Simulator) -> None:
        batch = simulator.num_envs
        self._simulator = simulator
        self._rise, self._growth = np.full((2, batch), -np.inf)
        self._merge_rise, self._merge_excess = np.zeros((2, batch))
        self._alignment = np.full(batch, np.inf)
        sized = not simulator.scenario.sensing_graph.undirected
        # computing a hull per environment and step is slower than a step
        self._size = simulator.size() if sized else None

    def see(self, step: Step) -> NDArray[np.float64]:
        """Update from a step; returns the alignments of its robots, (B, n)."""

        def keep(worst: NDArray[np.float64], found: NDArray[np.float64]) -> None:
            np.maximum(worst, found, out=worst, where=step.running)

        keep(self._rise, step.outcome.lyapunov_before_merge - step.lyapunov)
        keep(self._merge_rise, step.outcome.merge_rise)
        keep(self._merge_excess, step.outcome.merge_excess)
        if self._size is not None:
            before, self._size = self._size, self._simulator.size()
            keep(self._growth, self._size - before)
        aligned = alignments(self._simulator.scenario, step)
        least = np.fmin.reduce(aligned, axis=1)
        np.fmin(self._alignment, least, out=self._alignment, where=step.running)
        return aligned

    def episodes(self, margin: float | None, promised: float) -> Episodes:
        """Metrics after all episodes have finished."""
        simulator, scenario = self._simulator, self._simulator.scenario
        success = simulator.status == RENDEZVOUS
        contacts, start = simulator.contacts, simulator.initial_lyapunov
        bounds = np.full(start.shape, np.nan)
        if margin is not None:
            bounds = time_bound(scenario, start, min_alignment=margin)
        bounds = np.where(np.isfinite(bounds), bounds, promised)
        return Episodes(
            success=success,
            collision_free=np.where(counts_contacts(scenario), success & (contacts == 0), np.nan),
            time=simulator.time,
            path_length=simulator.path_length,
            contacts=contacts,
            clearance=_or_nan(simulator.min_clearance),
            max_rise_between_merges=self._rise,
            merge_rise=self._merge_rise,
            merge_excess=self._merge_excess,
            min_alignment=_or_nan(self._alignment),
            initial_lyapunov=start,
            time_bound=_or_nan(bounds),
            max_rise_of_size=_or_nan(self._growth),
        )


def _or_nan(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), values, np.nan)


def alignments(scenario: Scenario, step: Step) -> NDArray[np.float64]:
    """Alignment |vᵀf|/(‖v‖‖f‖), (B, n), in [0, 1], of robots with ‖f‖ ≥ 2δ.

    NaN for other robots and finished episodes. v is the commanded velocity (0 has alignment 0), for
    nonholonomic robots along the body axis, for double integrators the commanded acceleration.

    Raises:
        ValueError: if the shapes do not match.
    """
    n, layout = scenario.n_robots, scenario.observation_layout
    shape = (len(step.running), n, *layout.shape)
    observations = check_observations(step.observations, shape)
    acted = (*shape[:2], scenario.action_size)
    actions = check_numbers("actions", step.actions, acted, "(B, n, a)")
    running = check_mask(step.running, shape[0])
    out = np.full(shape[:2], np.nan)
    least = max(2.0 * scenario.dead_zone, 1e-12)
    along_x = scenario.model.nonholonomic
    batch_alignments(observations, actions, running, layout.neighbour_slots, along_x, least, out)
    return out


@kernel
def batch_alignments(
    observations: Any, actions: Any, running: Any, slots: int, along_x: bool, least: float, out: Any
) -> None:
    """Write |vᵀf|/(‖v‖‖f‖) of robots with ‖f‖ ≥ ``least`` (m/s) in running episodes to ``out``.

    ``out`` is (B, n); the value is 0 where v = 0.
    """
    for b in range(out.shape[0]):
        for i in range(out.shape[1]):
            f = net_bearing_of(observations[b, i], slots)
            f_square = dot(f, f)
            if running[b] and f_square >= least * least:
                v = X_AXIS if along_x else load(actions[b, i])
                v_square = dot(v, v)
                cosine = abs(dot(v, f)) / np.sqrt(f_square * v_square) if v_square > 0.0 else 0.0
                out[b, i] = min(1.0, cosine)
