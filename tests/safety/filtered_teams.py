"""One way to play adversaries under a safety filter, and what is looked at in each step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.safety.safety_filter import SafetyFilter

ROUNDING = 2.0**-20
"""Of float32 rows, relative to n D̄² τ; what is displaced in float32 is booked as it is."""


class Moment(NamedTuple):
    """Teams between two steps."""

    positions: np.ndarray
    active: np.ndarray
    lyapunov: np.ndarray
    levels: np.ndarray
    """ΣA_i, (B,), m²/s; zero without a tank."""

    @property
    def energy(self) -> np.ndarray:
        return self.lyapunov + self.levels


class Step(NamedTuple):
    on: np.ndarray
    """(B,), teams that were running."""
    calm: np.ndarray
    """(B,), those of them without a merge or contact."""
    before: Moment
    after: Moment
    outcome: Any
    simulator: Simulator
    observations: np.ndarray
    """That the filter was given."""


def played(
    scenario: Scenario,
    safety_filter: SafetyFilter,
    choose: Callable[[Any, int], Any],
    *,
    seed: int = 0,
    steps: int | None = None,
    mislead: Callable[[Any], Any] = lambda observations: observations,
) -> Iterator[Step]:
    """Steps until all have met or run out of time: choices from what is seen and the step's number,
    carried out by the filter.
    """
    simulator = Simulator(scenario, len(safety_filter.held))
    observations, step = simulator.reset(seed), 0

    def moment() -> Moment:
        levels = getattr(safety_filter, "levels", np.zeros((1, 1))).sum(axis=-1)
        return Moment(simulator.positions, simulator.active, simulator.lyapunov(), levels)

    after = moment()
    while (on := simulator.status == RUNNING).any() and step != steps:
        before, seen = after, mislead(observations)
        safety_filter.hold(choose(seen, step))
        outcome = simulator.step(safety_filter.act(seen))
        safety_filter.book(outcome.contact, simulator.merged_into, ~on)
        after = moment()
        calm = on & (before.active == after.active).all(axis=-1) & ~outcome.contact.any(axis=-1)
        yield Step(on, calm, before, after, outcome, simulator, observations)
        observations, step = outcome.observations, step + 1


class Seen:
    """What a batch of adversarial episodes showed; V and A in m²/s."""

    def __init__(self, scenario: Scenario, safety_filter: SafetyFilter, choose: Any, **how: Any):
        teams, n = len(safety_filter.held), scenario.n_robots
        tolerance = 2 * ROUNDING * n * scenario.max_degree**2 * scenario.tau
        self.times, self.start = np.full(teams, np.inf), None
        self.rise, self.above_start, self.highest = -np.inf, -np.inf, -np.inf
        self.lowest_level, self.calm_steps = np.inf, 0
        for k, step in enumerate(played(scenario, safety_filter, choose, **how)):
            before, after, on, calm = step.before, step.after, step.on, step.calm
            if self.start is None:
                self.start, budgets = before.lyapunov, before.levels
            rise = after.energy - before.energy - tolerance - 1e-12 * before.energy
            self.rise = max(self.rise, rise[calm].max(initial=-np.inf))
            whole = on & after.active.all(axis=-1)
            excess = after.lyapunov - self.start - budgets - (k + 1) * tolerance
            self.above_start = max(self.above_start, excess[whole].max(initial=-np.inf))
            share = (after.lyapunov / self.start)[on]
            self.highest = max(self.highest, share.max(initial=-np.inf))
            self.lowest_level = min(self.lowest_level, after.levels.min())
            self.calm_steps += int(calm.sum())
            met = on & (step.outcome.status == RENDEZVOUS)
            self.times[met] = step.simulator.time[met]
            self.watch(step)
        self.met = np.isfinite(self.times)

    def watch(self, step: Step) -> None:
        """Look at more."""

    def kept(self) -> bool:
        """Whether V + ΣA never rose between merges."""
        return self.rise <= 0 and self.above_start <= 0 and self.lowest_level >= 0


def longer(scenario: Scenario, factor: float, **changes: Any) -> Scenario:
    """The scenario with a step that is so many times the certified one."""
    step = factor * scenario.certified_step
    return scenario.replace(time_step=step, allow_long_step=True, time_limit=1e4, **changes)
