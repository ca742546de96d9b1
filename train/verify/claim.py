"""What a claim is: an experiment that can fail. What is measured of it, by what it is judged, and
the tasks of it.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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


Verdict = tuple[Array, Mask]
"""Margin of each team (negative is bad, rounding aside), and whether the claim held."""
Draw = Callable[[np.random.Generator, int, float], Case]
"""(random numbers, number of the batch, smallest ε) → what its teams share."""
Law = Callable[[Case, int, np.random.Generator], Policy]
"""(case, B, random numbers) → policy."""
Bound = Callable[[Case, Simulator], Array]
"""(case, teams at their start) → time limits (B,), s."""
Judge = Callable[[Record], Verdict]
Promise = Callable[[Scenario, Step], Array]
"""(scenario, step) → what V must fall in it (B,), m²/s, if nobody merges."""


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
    timed: bool = False
    """Whether ``bound`` is a theorem's, so that T/bound is worth reporting."""


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


# ---- what V must fall in a step ------------------------------------------------------------------


def no_rise(scenario: Scenario, step: Step) -> Array:
    """V does not rise."""
    return np.zeros(len(step.running))


def as_chosen(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ f_iᵀu_i with what the law chose, within the speed limit, and by 0 at least
    (theory 4), m²/s.
    """
    u = step.actions.astype(np.float64)
    speed = np.linalg.norm(u, axis=-1, keepdims=True)
    u *= scenario.speed_limit / np.maximum(speed, scenario.speed_limit)
    f = scenario.observation_layout.net_bearing(step.observations)
    return scenario.tau * np.maximum(np.sum(f * u, axis=(-2, -1)), 0.0)


def by_law_1(scenario: Scenario, step: Step) -> Array:
    """The same with u_i = f_i, whatever was chosen."""
    f = scenario.observation_layout.net_bearing(step.observations)
    return as_chosen(scenario, step._replace(actions=f))


# ---- judges --------------------------------------------------------------------------------------

_FLOAT64 = 1e-12
_FLOAT32 = 2.0**-20


def falls(record: Record) -> Verdict:
    """V falls by what is promised in every step, up to its first merge."""
    return record.slack, record.fell


def meets(record: Record) -> Verdict:
    """All have met by the time limit; the margin is the share of it that is left."""
    return 1.0 - record.times / record.limit, record.times <= record.limit


def stays_apart(record: Record) -> Verdict:
    """No team of a disconnected graph meets: the margin is robots left less pieces."""
    more = record.left - _pieces(record.case.scenario)
    return more.astype(np.float64), (more == 0) & np.isinf(record.times)


def merges_within_bound(record: Record) -> Verdict:
    """V rises at a merge by no more than theory 5 allows."""
    return -record.excess, record.excess * record.start <= _FLOAT64 * (1.0 + record.start)


def is_lemma_1(record: Record) -> Verdict:
    """Σ‖f_i‖ ≥ 2 max a_ij; law (1) moves at f_i."""
    return record.total - 1.0, record.total >= 1.0 - _FLOAT32


def rounding(scenario: Scenario, lyapunov: Array) -> Array:
    """By how much rounding alone can make V miss its promise, m²/s.

    V is summed in float64. Rows and actions are float32: f_i is off by 2⁻²⁴ D̄, u_i by as much
    again, in up to three components; V changes by 2 f_iᵀδu_i τ ≤ 2 D̄ · 2√3 · 2⁻²⁴ D̄ τ < 2⁻²¹ D̄²τ
    for each robot. Arcs have angles in float32 too, which doubles it.
    """
    sent = _FLOAT32 * scenario.n_robots * scenario.max_degree**2 * scenario.tau
    return _FLOAT64 * lyapunov + sent


def _pieces(scenario: Scenario) -> int:
    return len(scenario.sensing_graph.components(scenario.n_robots))


# ---- a batch -------------------------------------------------------------------------------------


def measure(claim: Claim, case: Case, policy: Policy, seed: int) -> Record:
    """Run BATCH teams until each has met or is out of time.

    A team in which V has not fallen as the claim demands is not waited for.
    """
    scenario = case.scenario
    simulator = Simulator(scenario, BATCH)
    observations = simulator.reset(seed, case.options)
    limit = claim.bound(case, simulator)
    # one step more: a bound falls within a step
    simulator.set_max_steps(math.ceil(float(limit.max()) / scenario.tau) + 1)
    endless = np.full(BATCH, np.inf)
    record = Record(
        case=case,
        start=simulator.lyapunov(),
        limit=limit,
        times=endless.copy(),
        slack=endless.copy(),
        fell=np.ones(BATCH, dtype=np.bool_),
        excess=-endless,
        left=np.zeros(BATCH, dtype=np.int64),
        total=np.zeros(BATCH),
    )
    heaviest, pieces = simulator.weights.max(axis=(-2, -1)), _pieces(scenario)
    for number, step in enumerate(steps_of(simulator, policy, observations)):
        if number == 0:
            record.total = np.linalg.norm(step.actions, axis=-1).sum(axis=-1) / (2 * heaviest)
        _note(record, step, simulator, claim.promise)
        undecided = (simulator.active.sum(axis=-1) > pieces) & ~simulator.ended
        if not (undecided & (record.fell | (falls not in claim.judges))).any():
            break
    record.left = simulator.active.sum(axis=-1)
    return record


def _note(record: Record, step: Step, simulator: Simulator, promise: Promise) -> None:
    """Take one step into the record: V before its first merge, rises at merges, who has met."""
    out, on = step.outcome, step.running
    calm = out.lyapunov_after_merge == out.lyapunov_before_merge
    promised = np.where(calm, promise(record.case.scenario, step), 0.0)
    slack = step.lyapunov - out.lyapunov_before_merge - promised
    record.slack[on] = np.minimum(record.slack, slack / record.start)[on]
    record.fell &= ~on | (slack >= -rounding(record.case.scenario, step.lyapunov))
    record.excess[on] = np.maximum(record.excess, out.merge_excess / record.start)[on]
    met = on & (out.status == RENDEZVOUS)
    record.times[met] = simulator.time[met]


def check(claim: Claim, seed: int, batch: int, trials: int, least_margin: float) -> Finding:
    """Run one batch of a claim, by its number, with margins ε of ``least_margin`` or more, and
    count ``trials`` of its teams; the same arguments give the same finding.
    """
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    case = claim.draw(random, batch, least_margin)
    policy = claim.law(case, BATCH, random)
    record = measure(claim, case, policy, int(random.integers(2**40)))
    verdicts = [judge(record) for judge in claim.judges]
    held = np.logical_and.reduce([ok for _, ok in verdicts])[:trials]
    ratio = np.max((record.times / record.limit)[:trials]) if claim.timed else math.nan
    margin = float(np.min(verdicts[0][0][:trials]))
    return Finding(len(held), margin, float(ratio), int(np.sum(~held)))


# ---- tasks ---------------------------------------------------------------------------------------

_MOST = 256
"""Tasks of a claim."""


@dataclass(frozen=True)
class Block:
    """Some batches of one claim, a task of its own."""

    claim: Claim
    batches: tuple[tuple[int, int], ...]
    """Numbers, and teams that count."""
    seed: int
    min_alignment: float

    @property
    def name(self) -> str:
        """Of its cell."""
        return f"{self.claim.name}-{self.batches[0][0]:07d}"


class Seen(NamedTuple):
    """What a block says."""

    finding: Finding
    seconds: float
    first: int | None
    """Number of the first batch with a violation."""


def blocks_of(
    claim: Claim, batches: Sequence[tuple[int, int]], seed: int, min_alignment: float
) -> list[Block]:
    """The batches of a claim, cut into tasks."""
    size = math.ceil(len(batches) / _MOST)
    cuts = range(0, len(batches), size)
    return [Block(claim, tuple(batches[k : k + size]), seed, min_alignment) for k in cuts]


def look(block: Block) -> Seen:
    """Check the batches of a block."""
    began, claim = time.perf_counter(), block.claim
    found = {k: check(claim, block.seed, k, n, block.min_alignment) for k, n in block.batches}
    first = next((k for k, finding in found.items() if finding.violations), None)
    return Seen(worst(list(found.values())), time.perf_counter() - began, first)
