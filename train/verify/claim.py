"""What a claim is, what is measured of it, by what it is judged, and what is found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.trajectory import Policy, Step
from rendezvous_env.trajectory import run as steps_of

from .cases import BATCH, Case

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass
class Record:
    """What was measured of a batch; all arrays (B,)."""

    case: Case
    start: Array
    """V(0), m²/s."""
    limit: Array
    """Time by which the team must have met, s."""
    times: Array
    """Of the rendezvous, s; inf without."""
    slack: Array
    """Least of what V fell in a step beyond what is promised, over V(0)."""
    fell: Mask
    """Whether V kept the promise in every step, rounding aside."""
    excess: Array
    """Largest rise of V at a merge beyond its bound, over V(0)."""
    left: NDArray[np.int64]
    """Robots left at the end."""
    total: Array
    """Σ‖u_i‖ at the start over 2 max a_ij; u_i are the speeds the law chose."""
    watched: Array
    """Least of what the claim's watch has found; inf without one."""


Verdict = tuple[Array, Mask]
"""Margin of each team (negative is bad, rounding aside), and whether the claim held."""
Draw = Callable[[np.random.Generator, int, float], Case]
Law = Callable[[Case, int, np.random.Generator], Policy]
"""(case, B, random numbers) → policy."""
Bound = Callable[[Case, Simulator], Array]
"""(case, teams at their start) → time limits (B,), s."""
Judge = Callable[[Record], Verdict]
Promise = Callable[[Scenario, Step], Array]
"""(scenario, step) → what V must fall in it (B,), m²/s, if nobody merges."""
Watch = Callable[[Simulator, Case], Callable[[Step], Array]]
"""(teams at their start, case) → what is asked after every step: by how much each keeps a promise
of its own, (B,); negative where it is broken, rounding aside."""


@dataclass(frozen=True)
class Claim:
    """One row of the table."""

    name: str
    statement: str
    draw: Draw
    law: Law
    bound: Bound
    judges: tuple[Judge, ...]
    """The first one's margin is reported; a team that fails any violates the claim."""
    promise: Promise
    """What V must fall in each step."""
    timed: bool = False
    """Whether ``bound`` is a theorem's, so that T/bound is worth reporting."""
    watch: Watch | None = None
    """What else is measured in every step, for the judge ``keeps``."""
    patience: float = 1.0
    """Times ``bound`` for which teams are waited for: more than 1 where it bounds a mean."""


@dataclass(frozen=True)
class Finding:
    """What one batch says about a claim, or several."""

    trials: int
    margin: float
    """Worst over the teams."""
    time_over_bound: float
    """Worst over the teams; NaN where the claim names no time."""
    violations: int


def worst(findings: Sequence[Finding]) -> Finding:
    """What several batches say together."""
    return Finding(
        trials=sum(finding.trials for finding in findings),
        margin=min(finding.margin for finding in findings),
        time_over_bound=max(finding.time_over_bound for finding in findings),
        violations=sum(finding.violations for finding in findings),
    )


def anything(scenario: Scenario, step: Step) -> Array:
    """Nothing."""
    return np.full(len(step.running), -np.inf)


def no_rise(scenario: Scenario, step: Step) -> Array:
    """V does not rise."""
    return np.zeros(len(step.running))


def by_law_1(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ f_iᵀu_i with u_i = f_i, within the speed limit (theory 4), m²/s."""
    f = scenario.observation_layout.net_bearing(step.observations)
    return scenario.tau * np.sum(f * _limited(f, scenario), axis=(-2, -1))


def as_chosen(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ f_iᵀu_i with what the law chose, at least 0 (theory 4), m²/s."""
    f = scenario.observation_layout.net_bearing(step.observations)
    u = _limited(step.actions.astype(np.float64), scenario)
    return scenario.tau * np.maximum(np.sum(f * u, axis=(-2, -1)), 0.0)


def _limited(velocities: Array, scenario: Scenario) -> Array:
    """Velocities (..., d) scaled to the speed limit, m/s."""
    speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
    return velocities * (scenario.speed_limit / np.maximum(speed, scenario.speed_limit))


_FLOAT64 = 1e-12
_FLOAT32 = 2.0**-20
_WATCHED = 1e-9
_CONFIDENCE = 3.0
"""Standard errors."""


def falls(record: Record) -> Verdict:
    """V falls by what is promised in every step, up to its first merge."""
    return record.slack, record.fell


def meets(record: Record) -> Verdict:
    """All have met by the time limit; the margin is the share of it that is left."""
    margin = 1.0 - record.times / record.limit
    return margin, record.times <= record.limit


def meets_on_average(record: Record) -> Verdict:
    """The mean of T/bound over the teams of a batch is at most 1, with three standard errors to
    spare.
    """
    ratio = record.times / record.limit
    spread = np.std(ratio, ddof=1) if np.isfinite(ratio).all() else np.inf
    margin = 1.0 - np.mean(ratio) - _CONFIDENCE * spread / np.sqrt(len(ratio))
    return np.full(len(ratio), margin), np.full(len(ratio), bool(margin >= 0))


def stays_apart(record: Record) -> Verdict:
    """No team of a disconnected graph meets: the margin is robots left less pieces."""
    scenario = record.case.scenario
    pieces = len(scenario.sensing_graph.components(scenario.n_robots))
    return (record.left - pieces).astype(np.float64), (record.left == pieces) & np.isinf(
        record.times
    )


def merges_within_bound(record: Record) -> Verdict:
    """V rises at a merge by no more than theory 5 allows."""
    return -record.excess, record.excess * record.start <= _FLOAT64 * (1.0 + record.start)


def is_lemma_1(record: Record) -> Verdict:
    """Σ‖f_i‖ ≥ 2 max a_ij; law (1) moves at f_i."""
    return record.total - 1.0, record.total >= 1.0 - _FLOAT32


def keeps(record: Record) -> Verdict:
    """What the claim watches has kept its promise in every step; watches are shares of a length,
    of which rounding takes far less than 10⁻⁹.
    """
    return record.watched, record.watched >= -_WATCHED


def rounding(scenario: Scenario, lyapunov: Array) -> Array:
    """By how much rounding alone can make V miss its promise, m²/s.

    V is summed in float64. Rows and actions are float32: f_i is off by 2⁻²⁴ D̄, u_i by as much
    again, in up to three components; V changes by 2 f_iᵀδu_i τ ≤ 2 D̄ · 2√3 · 2⁻²⁴ D̄ τ < 2⁻²¹ D̄²τ
    for each robot. Arcs have angles in float32 too, which doubles it.
    """
    return (
        _FLOAT64 * lyapunov + _FLOAT32 * scenario.n_robots * scenario.max_degree**2 * scenario.tau
    )


def measure(claim: Claim, case: Case, policy: Policy, seed: int) -> Record:
    """Run BATCH teams until each has met or is out of time.

    A team in which V has not fallen as the claim demands is not waited for. A law that looks at
    positions is shown the teams before the first step (``watch``).
    """
    scenario = case.scenario
    simulator = Simulator(scenario, BATCH)
    observations = simulator.reset(seed, case.options)
    if hasattr(policy, "watch"):
        policy.watch(simulator)
    limit = claim.bound(case, simulator)
    # one step more: a bound falls within a step
    simulator.set_max_steps(math.ceil(claim.patience * float(limit.max()) / scenario.tau) + 1)
    heaviest = simulator.weights.max(axis=(-2, -1))
    record = _blank(case, simulator.lyapunov(), limit)
    watch = claim.watch(simulator, case) if claim.watch else None
    pieces = len(scenario.sensing_graph.components(scenario.n_robots))
    for number, step in enumerate(steps_of(simulator, policy, observations)):
        if number == 0:
            record.total = np.linalg.norm(step.actions, axis=-1).sum(axis=-1) / (2 * heaviest)
        _note(record, step, simulator, claim.promise)
        if watch:
            record.watched[step.running] = np.minimum(record.watched, watch(step))[step.running]
        undecided = (simulator.active.sum(axis=-1) > pieces) & ~simulator.ended
        waited_for = record.fell | (falls not in claim.judges)
        if not (undecided & waited_for).any():
            break
    record.left = simulator.active.sum(axis=-1)
    return record


def _blank(case: Case, start: Array, limit: Array) -> Record:
    return Record(
        case=case,
        start=start,
        limit=limit,
        times=np.full(BATCH, np.inf),
        slack=np.full(BATCH, np.inf),
        fell=np.ones(BATCH, dtype=np.bool_),
        excess=np.full(BATCH, -np.inf),
        left=np.zeros(BATCH, dtype=np.int64),
        total=np.zeros(BATCH),
        watched=np.full(BATCH, np.inf),
    )


def _note(record: Record, step: Step, simulator: Simulator, promise: Promise) -> None:
    """Take one step into the record: V before its first merge, rises at merges, who has met."""
    out, on = step.outcome, step.running
    calm = out.lyapunov_after_merge == out.lyapunov_before_merge
    promised = np.where(calm, promise(record.case.scenario, step), 0.0)
    slack = step.lyapunov - out.lyapunov_before_merge - promised
    error = rounding(record.case.scenario, step.lyapunov)
    record.slack[on] = np.minimum(record.slack, slack / record.start)[on]
    record.fell &= ~on | (slack >= -error)
    record.excess[on] = np.maximum(record.excess, out.merge_excess / record.start)[on]
    met = on & (out.status == RENDEZVOUS)
    record.times[met] = simulator.time[met]
