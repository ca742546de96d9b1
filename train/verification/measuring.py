"""Run the teams of a case and take down what a claim is judged by."""

from __future__ import annotations

import math

import numpy as np

from rendezvous_env import Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.trajectory import Policy, Step
from rendezvous_env.trajectory import run as steps_of

from .cases import BATCH, Case
from .claim import Array, Claim, Promise, Record
from .judging import falls, rounding


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
