"""How much can be reached at all: by a planner that knows the map, and by law (4).

What the planner passes cleanly is the share of starts that are possible. What some run of law (4)
has done a policy could have done, so the share of starts that at least one of many randomised
certified runs passed cleanly is an estimate, from below, of what any heading policy can reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.obstacle_rules.obstacle_avoidance import (
    CertifiedHeadingPolicy,
    tangent_joined_heading,
)
from rendezvous_env.baselines.references import privileged_planner
from rich.console import Console

from rendezvous_env import baselines
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.trajectory import Policy

from .. import results
from ..resume import Part
from ..tasks import each
from . import tables
from .evaluation import counts_contacts, play
from .playing import progress
from .settings import Config, Job

MIN_ALIGNMENT = 0.05
"""ε of every run."""
_LEAST_CLEARANCE, _MOST_CLEARANCE = 0.02, 0.4  # rad
_SPREADS = (0.3, 0.6, 1.0)  # rad; of the bias that a robot keeps for an episode
_WANDER = 0.3
"""Spread of the bias that comes and goes, as a share of the one that stays."""
_WANDER_TIME = 1.0  # s


@dataclass(frozen=True)
class UpperBound:
    """What R runs did on N starts."""

    success: NDArray[np.bool_]
    """(R, N), whether all met."""
    clean: NDArray[np.bool_]
    """(R, N), whether they met without touching an obstacle."""
    planned: NDArray[np.bool_]
    """(N,), whether the planner passed cleanly; (0,) where it steers no such robots."""

    def row(self, scenario: Scenario) -> dict[str, Any]:
        """One row of ceiling.csv."""
        return {
            "scenario": scenario.name,
            "episodes": self.clean.shape[1],
            "runs": len(self.clean),
            "clean_planner": float(self.planned.mean()) if self.planned.size else math.nan,
            "clean_best": float(self.clean.any(axis=0).mean()),
            "success_best": float(self.success.any(axis=0).mean()),
            "clean_mean": float(self.clean.mean()),
            "never_clean": int((~self.clean.any(axis=0)).sum()),
            "never_met": int((~self.success.any(axis=0)).sum()),
        }


COLUMNS = (
    "scenario",
    "episodes",
    "runs",
    "clean_planner",
    "clean_best",
    "success_best",
    "clean_mean",
    "never_clean",
    "never_met",
)
"""Of ceiling.csv: fractions 0–1 of the starts, that of the planner empty where it does not fit; and
starts that no run passed cleanly, or at all."""


def applies(scenario: Scenario) -> bool:
    """Whether there is anything to steer around: single integrators among obstacles that stop
    them.
    """
    return "tangent-joined" in baselines.names(scenario) and counts_contacts(scenario)


class Run(NamedTuple):
    """What one run did on N starts."""

    success: NDArray[np.bool_]
    """(N,), whether all met."""
    clean: NDArray[np.bool_]
    """(N,), whether they met without touching an obstacle."""


@dataclass(frozen=True)
class Task:
    """One run on one scenario."""

    scenario: Scenario
    """Single integrators among obstacles."""
    run: int
    """Its number, of which all that is random follows; the first is the joined rule with nothing
    random but its clearance. PLANNER is no run of law (4), but the planner's."""
    episodes: int
    """N."""
    seed: int
    """Of the first start."""


PLANNER = -1


def tasks_of(scenario: Scenario, runs: int, *, episodes: int, seed: int) -> list[Task]:
    """R runs on the starts that follow from ``seed``, and the planner's where it fits."""
    fits = privileged_planner.NAME in baselines.names(scenario)
    numbers = (*range(runs), *((PLANNER,) if fits else ()))
    return [Task(scenario, run, episodes, seed) for run in numbers]


def play_run(task: Task) -> Run:
    """Play a run."""
    scenario, run = task.scenario, task.run
    make: Callable[[], Policy]
    if run == PLANNER:
        make, margin = partial(baselines.make, privileged_planner.NAME, scenario), None
    else:
        spread = _SPREADS[run % 3] if run else 0.0
        make = partial(randomised, scenario, seed=run, spread=spread)
        margin = MIN_ALIGNMENT
    done, _ = play(scenario, make, margin=margin, episodes=task.episodes, seed=task.seed)
    return Run(done.success, done.clean == 1)


def joined(runs: Mapping[Task, Run]) -> UpperBound:
    """What all runs on one scenario say."""
    own = [run for task, run in runs.items() if task.run != PLANNER]
    planned = [run.clean for task, run in runs.items() if task.run == PLANNER]
    return UpperBound(
        success=np.array([run.success for run in own]),
        clean=np.array([run.clean for run in own]),
        planned=planned[0] if planned else np.zeros(0, np.bool_),
    )


def randomised(scenario: Scenario, *, seed: int, spread: float) -> CertifiedHeadingPolicy:
    """The joined rule looking past f by an angle that is random for each robot.

    Args:
        scenario: single integrators among obstacles.
        seed: of everything random.
        spread: standard deviation of the angle, rad.
    """
    rule = _RandomRule(scenario.tau, np.random.default_rng(seed), spread)
    return CertifiedHeadingPolicy(scenario, rule, MIN_ALIGNMENT, math.pi / scenario.tau)


@dataclass
class _RandomRule:
    """A heading rule with memory of its random angles, one for each robot."""

    tau: float
    random: np.random.Generator
    spread: float
    clearance: float = field(init=False)
    _bias: NDArray[np.float64] = field(init=False, default_factory=lambda: np.zeros(0))
    _wander: NDArray[np.float64] = field(init=False, default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.clearance = float(self.random.uniform(_LEAST_CLEARANCE, _MOST_CLEARANCE))

    def __call__(
        self, net_bearing: NDArray[np.float64], silhouettes: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Headings of the joined rule, as if f pointed elsewhere; never against the true f."""
        shape = net_bearing.shape[:-1]
        if self._bias.shape != shape:
            self._bias = self.random.normal(0.0, self.spread, shape)
            self._wander = np.zeros(shape)
        share = math.sqrt(2.0 * self.tau / _WANDER_TIME)
        self._wander *= 1.0 - self.tau / _WANDER_TIME
        self._wander += self.random.normal(0.0, share * _WANDER * self.spread, shape)
        aside = _turned(net_bearing, self._bias + self._wander)
        headings = tangent_joined_heading(aside, silhouettes, clearance=self.clearance)
        return _not_against(headings, net_bearing)


def _turned(vectors: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors turned in their xy plane, counter-clockwise; angles in rad."""
    out = vectors.copy()
    c, s = np.cos(angle), np.sin(angle)
    out[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
    out[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
    return out


def _not_against(headings: NDArray[np.float64], f: NDArray[np.float64]) -> NDArray[np.float64]:
    """Headings without the part that points against f."""
    square = np.maximum(np.sum(f * f, axis=-1, keepdims=True), np.finfo(float).tiny)
    against = np.minimum(np.sum(headings * f, axis=-1, keepdims=True), 0.0)
    return headings - against / square * f


def play_upper_bounds(
    part: Part, jobs: Sequence[Job], config: Config, console: Console
) -> list[str]:
    """Estimate what can be reached in each scenario with obstacles; a table and ceiling.csv.

    Returns:
        Names of the files.
    """
    scenarios = dict.fromkeys(job.scenario for job in jobs if applies(job.scenario))
    tasks = [
        task
        for scenario in scenarios
        for task in tasks_of(
            scenario, config.ceiling, episodes=config.starts(scenario), seed=config.seed
        )
    ]
    names = {task: f"upper-bound-{task.scenario.name}-{task.run:04d}" for task in tasks}
    found = {task: part.load(name) for task, name in names.items()}
    left = [task for task in tasks if found[task] is None]
    runs = each(play_run, left, config.workers)
    with progress(console) as shown, closing(runs):
        done = len(tasks) - len(left)
        bar = shown.add_task("best of many", total=len(tasks), completed=done)
        for number, run in runs:
            found[left[number]] = run
            part.save(names[left[number]], run)
            name = f"{left[number].scenario.name} · best of {config.ceiling}".ljust(40)
            shown.update(bar, advance=1, description=name)
    rows = [joined(_of(found, scenario.name)).row(scenario) for scenario in scenarios]
    results.write_csv(part.folder / "ceiling.csv", COLUMNS, rows)
    console.print(tables.ceiling_table(rows))
    return ["ceiling.csv"]


def _of(found: dict[Task, Run | None], scenario: str) -> dict[Task, Run]:
    """The runs on one scenario."""
    return {
        task: run
        for task, run in found.items()
        if run is not None and task.scenario.name == scenario
    }
