"""Rollouts: run a policy and keep what happened, for people who only want to see it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .engine.memory import RENDEZVOUS, RUNNING
from .experiment.checks import floats, shown
from .experiment.scenario import Scenario
from .experiment.scenarios import resolve
from .outcome import Outcome
from .simulator import Simulator

Policy = Callable[[NDArray[np.float32], NDArray[np.float64]], NDArray[Any]]


class Merge(NamedTuple):
    """One step in which robots of a team became one."""

    env: int
    """Index of the team."""
    time: float
    """End of the step, s."""
    robots: tuple[int, ...]
    """Who was absorbed."""
    lyapunov_before: float
    """V just before the first merge of the step, m²/s."""
    lyapunov_after: float
    """V just after the last, m²/s."""


@dataclass(frozen=True)
class Trajectory:
    """What B teams did over T steps; a team that has finished stays as it is to the end."""

    scenario: Scenario
    """The experiment."""
    times: NDArray[np.float64]
    """(T + 1,), s."""
    positions: NDArray[np.float64]
    """(T + 1, B, n, d), m; a merged-away robot is where its survivor is."""
    headings: NDArray[np.float64]
    """(T + 1, B, n, k), rad: none for single integrators, yaw, or yaw and pitch."""
    active: NDArray[np.bool_]
    """(T + 1, B, n), whether the robot still exists on its own."""
    lyapunov: NDArray[np.float64]
    """V, (T + 1, B), m²/s."""
    lyapunov_before_merge: NDArray[np.float64]
    """(T, B), V just before the first merge of a step; V at its end if there was none."""
    lyapunov_after_merge: NDArray[np.float64]
    """(T, B), V just after the last merge of a step; V at its end if there was none."""
    observations: NDArray[np.float32]
    """(T + 1, B, n, rows, d), as the robots saw them."""
    actions: NDArray[np.float32]
    """(T, B, n, a), as the policy chose them."""
    rewards: NDArray[np.float64]
    """(T, B)."""
    contacts: NDArray[np.bool_]
    """(T, B, n), whether a robot touched an obstacle in the step."""
    success: NDArray[np.bool_]
    """(B,), whether all robots met."""
    rendezvous_time: NDArray[np.float64]
    """(B,), s; inf without rendezvous."""
    obstacles: NDArray[np.float64]
    """(B, M, width), tables of ``experiment.packing``."""

    @property
    def merges(self) -> list[Merge]:
        """All merges in order of time."""
        gone = self.active[:-1] & ~self.active[1:]
        return [
            Merge(
                env=int(b),
                time=float(self.times[t + 1]),
                robots=tuple(np.flatnonzero(gone[t, b]).tolist()),
                lyapunov_before=float(self.lyapunov_before_merge[t, b]),
                lyapunov_after=float(self.lyapunov_after_merge[t, b]),
            )
            for t, b in np.argwhere(gone.any(axis=-1))
        ]

    @property
    def largest_rise_between_merges(self) -> float:
        """Largest rise of V in a stretch of a step before any merge, m²/s; ≤ 0 if V never rose."""
        return float(np.max(self.lyapunov_before_merge - self.lyapunov[:-1], initial=-np.inf))


class Step(NamedTuple):
    """One step of an episode as ``run`` yields it."""

    running: NDArray[np.bool_]
    """(B,), which teams took part."""
    observations: NDArray[np.float32]
    """(B, n, rows, d), what the actions were chosen from."""
    actions: NDArray[np.float32]
    """(B, n, a)."""
    lyapunov: NDArray[np.float64]
    """(B,), V before the step."""
    outcome: Outcome
    """What came of it."""


def run(simulator: Simulator, policy: Policy, observations: NDArray[np.float32]) -> Iterator[Step]:
    """Step until every team has finished; after each step the caller may look at the simulator.

    Args:
        simulator: the teams, freshly reset.
        policy: (B, n, rows, d) observations and (B,) times in s → (B, n, a) actions. Its method
            ``reset(mask=None)`` is called first if it has one.
        observations: what the reset returned.

    Raises:
        ValueError: if an action has the wrong shape or is not finite.
    """
    forget = getattr(policy, "reset", None)
    if callable(forget):
        forget()
    while (running := simulator.status == RUNNING).any():
        actions = floats("actions", policy(observations, simulator.time), np.float32)
        before = simulator.lyapunov()
        outcome = simulator.step(actions)
        yield Step(running, observations, actions, before, outcome)
        observations = outcome.observations


def rollout(
    scenario: Scenario | str | os.PathLike[str],
    policy: Policy,
    seed: int | None = 0,
    num_envs: int = 1,
    options: Mapping[str, Any] | None = None,
) -> Trajectory:
    """Run one episode in each of ``num_envs`` teams and keep all of it.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        policy: any callable (observations, time) → actions, see ``run``.
        seed: team b starts from seed + b.
        num_envs: B.
        options: given parts of the start, see ``Simulator.reset``.

    Raises:
        ValueError: for a bad scenario, seed, number of teams, option or action.
        TypeError: if the policy cannot be called.
    """
    if not callable(policy):
        raise TypeError(f"policy is {shown(policy)}; it must be callable: baselines.make makes one")
    simulator = Simulator(resolve(scenario), num_envs)
    states = [_State.of(simulator, simulator.reset(seed, options))]
    steps: list[Step] = []
    finished_at = np.full(simulator.num_envs, np.inf)
    for step in run(simulator, policy, states[0].observations):
        steps.append(step)
        states.append(_State.of(simulator, step.outcome.observations))
        met = step.running & (simulator.status == RENDEZVOUS)
        finished_at[met] = simulator.time[met]
    outcomes = [step.outcome for step in steps]
    return Trajectory(
        scenario=simulator.scenario,
        times=np.arange(len(states), dtype=np.float64) * simulator.scenario.tau,
        positions=np.stack([state.positions for state in states]),
        headings=np.stack([state.headings for state in states]),
        active=np.stack([state.active for state in states]),
        lyapunov=np.stack([state.lyapunov for state in states]),
        lyapunov_before_merge=np.stack([outcome.lyapunov_before_merge for outcome in outcomes]),
        lyapunov_after_merge=np.stack([outcome.lyapunov_after_merge for outcome in outcomes]),
        observations=np.stack([state.observations for state in states]),
        actions=np.stack([step.actions for step in steps]),
        rewards=np.stack([outcome.rewards for outcome in outcomes]),
        contacts=np.stack([outcome.contact for outcome in outcomes]),
        success=simulator.status == RENDEZVOUS,
        rendezvous_time=finished_at,
        obstacles=simulator.obstacles,
    )


class _State(NamedTuple):
    positions: NDArray[np.float64]
    headings: NDArray[np.float64]
    active: NDArray[np.bool_]
    lyapunov: NDArray[np.float64]
    observations: NDArray[np.float32]

    @classmethod
    def of(cls, simulator: Simulator, observations: NDArray[np.float32]) -> _State:
        return cls(
            simulator.positions,
            simulator.headings,
            simulator.active,
            simulator.lyapunov(),
            observations,
        )
