"""The claims of docs/theory.md as experiments that can fail: draw a case, run it, judge it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import baselines
from rendezvous_env import Scenario, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.guarantee.heading import flexible_velocity
from rendezvous_env.guarantee.lyapunov import merge_rise_allowance, time_bound
from rendezvous_env.trajectory import Policy, Step
from rendezvous_env.trajectory import run as steps_of

from .adversaries import Steered, across, adversary
from .cases import (
    BATCH,
    Case,
    draw_3d,
    draw_case,
    draw_disconnected,
    draw_long_steps,
    draw_nonholonomic,
    draw_trees,
    draw_unicycles,
    draw_unlimited,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PATIENCE = 500.0
"""Nonholonomic robots have no time bound; after this many seconds they are held not to meet."""
_FLOAT64 = 1e-12
_FLOAT32 = 2.0**-20


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
Law = Callable[[Case, int, np.random.Generator], Policy]
"""(case, B, random numbers) → policy."""
Bound = Callable[[Case, Array], Array]
"""(case, V(0) (B,)) → time limits (B,), s."""
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
    """What V must fall in each step."""
    timed: bool = False
    """Whether ``bound`` is a theorem's, so that T/bound is worth reporting."""


@dataclass(frozen=True)
class Finding:
    """What one batch says about a claim."""

    trials: int
    margin: float
    """Worst over the teams."""
    time_over_bound: float
    """Worst over the teams; NaN where the claim names no time."""
    violations: int
    case: Case


def check(claim: Claim, seed: int, batch: int, trials: int, least_margin: float) -> Finding:
    """Run one batch of a claim; the same arguments give the same finding.

    Args:
        claim: what to check.
        seed: of the whole run.
        batch: number of the batch.
        trials: how many of its BATCH teams to count.
        least_margin: smallest ε to draw.
    """
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    case = claim.draw(random, batch, least_margin)
    policy = claim.law(case, BATCH, random)
    start_seed = int(random.integers(2**40))
    record = measure(claim, case, policy, start_seed)
    verdicts = [judge(record) for judge in claim.judges]
    held = np.logical_and.reduce([ok for _, ok in verdicts])[:trials]
    ratio = np.max((record.times / record.limit)[:trials]) if claim.timed else math.nan
    margin = float(np.min(verdicts[0][0][:trials]))
    return Finding(len(held), margin, float(ratio), int(np.sum(~held)), case)


# ---- measuring -----------------------------------------------------------------------------------


def measure(claim: Claim, case: Case, policy: Policy, seed: int) -> Record:
    """Run BATCH teams until each has met or is out of time.

    A team in which V has not fallen as the claim demands is not waited for.
    """
    scenario = case.scenario
    simulator = Simulator(scenario, BATCH)
    observations = simulator.reset(seed, case.options)
    start = simulator.lyapunov()
    limit = claim.bound(case, start)
    # one step more: a bound falls within a step
    simulator.set_max_steps(math.ceil(float(limit.max()) / scenario.tau) + 1)
    heaviest = simulator.weights.max(axis=(-2, -1))
    record = _blank(case, start, limit)
    pieces = len(scenario.sensing_graph.components(scenario.n_robots))
    for number, step in enumerate(steps_of(simulator, policy, observations)):
        if number == 0:
            record.total = np.linalg.norm(step.actions, axis=-1).sum(axis=-1) / (2 * heaviest)
        _note(record, step, simulator, claim.promise)
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
    )


def _note(record: Record, step: Step, simulator: Simulator, promise: Promise) -> None:
    """Take one step into the record: V before its first merge, rises at merges, who has met."""
    out, on = step.outcome, step.running
    calm = out.lyapunov_after_merge == out.lyapunov_before_merge
    promised = np.where(calm, promise(record.case.scenario, step), 0.0)
    slack = step.lyapunov - out.lyapunov_before_merge - promised
    rounding = _rounding(record.case.scenario, step.lyapunov)
    record.slack[on] = np.minimum(record.slack, slack / record.start)[on]
    record.fell &= ~on | (slack >= -rounding)
    record.excess[on] = np.maximum(record.excess, out.merge_excess / record.start)[on]
    met = on & (out.status == RENDEZVOUS)
    record.times[met] = simulator.time[met]


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


def _rounding(scenario: Scenario, lyapunov: Array) -> Array:
    """By how much rounding alone can make V miss its promise, m²/s.

    V is summed in float64. Rows and actions are float32: f_i is off by 2⁻²⁴ D̄, u_i by as much
    again, in up to three components; V changes by 2 f_iᵀδu_i τ ≤ 2 D̄ · 2√3 · 2⁻²⁴ D̄ τ < 2⁻²¹ D̄²τ
    for each robot. Arcs have angles in float32 too, which doubles it.
    """
    return (
        _FLOAT64 * lyapunov + _FLOAT32 * scenario.n_robots * scenario.max_degree**2 * scenario.tau
    )


# ---- judging -------------------------------------------------------------------------------------


def falls(record: Record) -> Verdict:
    """V falls by what is promised in every step, up to its first merge."""
    return record.slack, record.fell


def meets(record: Record) -> Verdict:
    """All have met by the time limit; the margin is the share of it that is left."""
    margin = 1.0 - record.times / record.limit
    return margin, record.times <= record.limit


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


# ---- laws ----------------------------------------------------------------------------------------


def by_name(name: str) -> Law:
    """A scripted policy."""
    return lambda case, num_envs, random: baselines.make(name, case.scenario)


def unicycle_laws(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """(7) with (8), or with ω = cos t."""
    name = str(random.choice(["unicycle", "unicycle-cosine"]))
    return baselines.make(name, case.scenario)


def certified(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All adversaries under the certified heading, or under the gate."""
    scenario = case.scenario
    turn_rate = float(random.uniform(1.0, 10.0))
    return Steered(
        scenario,
        num_envs,
        adversary(scenario, num_envs, random, max_turn_rate=turn_rate),
        decision_period=int(random.choice([1, 1, 5])),
        min_alignment=case.margin,
        max_turn_rate=turn_rate,
        frame=str(random.choice(["net_bearing", "local"])),
    )


def at_fixed_angle(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (4) with hᵀf = ε‖f‖ always, each robot to a side of its own."""
    scenario, epsilon = case.scenario, case.margin
    axis = random.normal(size=(num_envs, scenario.n_robots, scenario.dim))
    side = random.choice([-1.0, 1.0], size=(num_envs, scenario.n_robots, 1))

    def policy(observations: NDArray[np.float32], time: Array) -> NDArray[np.float32]:
        f = scenario.observation_layout.net_bearing(observations)
        h = epsilon * _unit(f) + side * math.sqrt(1 - epsilon**2) * _unit(across(f, axis))
        return flexible_velocity(f, h).astype(np.float32)

    return policy


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


# ---- time limits ---------------------------------------------------------------------------------


def bound_a(case: Case, start: Array) -> Array:
    """Of theorem A, s."""
    return time_bound(case.scenario, start)


def bound_b(case: Case, start: Array) -> Array:
    """Of theorem B, s."""
    return time_bound(case.scenario, start) / case.margin**2


def bound_c(case: Case, start: Array) -> Array:
    """Of theorem C, s."""
    return time_bound(case.scenario, start, min_alignment=case.margin)


def bound_of_pieces(case: Case, start: Array) -> Array:
    """Time by which each piece of a disconnected graph has met, s: the proof of A holds for it."""
    scenario = case.scenario
    above = start + merge_rise_allowance(scenario)
    return 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(case: Case, start: Array) -> Array:
    """No theorem's: PATIENCE."""
    return np.full(start.shape, PATIENCE)


def no_time(case: Case, start: Array) -> Array:
    """One step shows what there is to see."""
    return np.zeros(start.shape)


# ---- the claims ----------------------------------------------------------------------------------

_law_1 = by_name("bearing-only")

CLAIMS = (
    Claim(
        "lemma-1",
        "Σ‖f‖ ≥ 2 max a",
        draw_unlimited,
        _law_1,
        no_time,
        (is_lemma_1,),
        no_rise,
    ),
    Claim(
        "theorem-1",
        "law (1): V falls by τ Σ‖f‖² in every step, connected teams meet",
        draw_case,
        _law_1,
        bound_a,
        (falls, meets),
        by_law_1,
        timed=True,
    ),
    Claim(
        "necessity",
        "law (1): a disconnected graph leaves one robot for each piece",
        draw_disconnected,
        _law_1,
        bound_of_pieces,
        (stays_apart,),
        no_rise,
    ),
    Claim(
        "theorem-2",
        "any policy under certified headings: V never rises between merges, all meet",
        draw_case,
        certified,
        bound_c,
        (falls, meets),
        as_chosen,
        timed=True,
    ),
    Claim(
        "theorem-3",
        "unicycles meet under (7) with (8) or ω = cos t",
        draw_unicycles,
        unicycle_laws,
        patience,
        (meets,),
        no_rise,
    ),
    Claim(
        "theorem-4",
        "3-D nonholonomic robots meet under (12), (17)",
        draw_3d,
        by_name("nonholonomic-3d"),
        patience,
        (meets,),
        no_rise,
    ),
    Claim(
        "bound-A",
        "law (1): T ≤ A",
        draw_case,
        _law_1,
        bound_a,
        (meets,),
        by_law_1,
        timed=True,
    ),
    Claim(
        "bound-B",
        "headings at a fixed angle to f: T ≤ B",
        draw_case,
        at_fixed_angle,
        bound_b,
        (meets, falls),
        as_chosen,
        timed=True,
    ),
    Claim(
        "bound-C",
        "any policy under certified headings: T ≤ C",
        draw_case,
        certified,
        bound_c,
        (meets,),
        as_chosen,
        timed=True,
    ),
    Claim(
        "gate",
        "any turn rates through the gate: V never rises between merges, all meet",
        draw_nonholonomic,
        certified,
        patience,
        (meets, falls),
        no_rise,
    ),
    Claim(
        "certified-step",
        "τ = r/(2D̄), law (4): V falls by τ Σ(hᵀf)² in every step",
        draw_case,
        at_fixed_angle,
        bound_b,
        (falls,),
        as_chosen,
    ),
    Claim(
        "local-scaling",
        "4 to 10 times that step, scaled: V never rises between merges, all meet",
        draw_long_steps,
        certified,
        bound_c,
        (falls, meets),
        as_chosen,
        timed=True,
    ),
    Claim(
        "merge-rise",
        "V rises at a merge by at most r max(0, D_i + D_j − 4 a_ij)",
        draw_trees,
        certified,
        bound_c,
        (merges_within_bound,),
        as_chosen,
    ),
)
