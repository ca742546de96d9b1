"""The claims of docs/theory.md, each an experiment that can fail: who plays on which teams, and
what is looked at in every step (``monitors``).
"""

from __future__ import annotations

import itertools
import math
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import baselines
from rendezvous_env import Simulator
from rendezvous_env.safety.heading import flexible_velocity
from rendezvous_env.safety.theorems.constants import merge_rise_allowance
from rendezvous_env.safety.theorems.descent import time_bound

from .adversarial_bearings import across, unit
from .cases import BATCH, draw_disconnected, draw_team, draw_trees, draw_turning
from .falsification import Policy, Trial, begin
from .monitors import Watch

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int, float], Trial]
"""(random numbers, number of the batch, smallest ε) → what its teams share, and who plays."""
Law = Callable[[Trial, np.random.Generator], Policy]
Bound = Callable[[Trial, Simulator], Array]
"""(trial, teams at their start) → time limits (B,), s."""

PATIENCE = 500.0
"""Nonholonomic robots have no time bound worth waiting for; after this many seconds they are held
not to meet."""

# ---- by when they meet ---------------------------------------------------------------------------


def bound_a(trial: Trial, teams: Simulator) -> Array:
    """Of theorem A, s."""
    return time_bound(trial.scenario, teams.lyapunov())


def bound_c(trial: Trial, teams: Simulator) -> Array:
    """Of theorems B and C, s."""
    margin = trial.arguments["min_alignment"]
    return time_bound(trial.scenario, teams.lyapunov(), min_alignment=margin)


def bound_of_pieces(trial: Trial, teams: Simulator) -> Array:
    """Time by which each piece of a disconnected graph has met, s: the proof of A holds for it."""
    scenario = trial.scenario
    above = teams.lyapunov() + merge_rise_allowance(scenario)
    return 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(trial: Trial, teams: Simulator) -> Array:
    """No theorem's: PATIENCE."""
    return np.full(teams.num_envs, PATIENCE)


# ---- who plays, where it is no adversary ---------------------------------------------------------


def cosine_or_not(trial: Trial, random: np.random.Generator) -> Policy:
    """Unicycles under (7) with (8), or with ω = cos t."""
    law = baselines.make(str(random.choice(["unicycle", "unicycle-cosine"])), trial.scenario)
    return lambda seen, now: law(seen, now.time)


def at_fixed_angle(trial: Trial, random: np.random.Generator) -> Policy:
    """Law (4) with hᵀf = ε‖f‖ always, each robot to a side of its own."""
    scenario, epsilon = trial.scenario, trial.arguments["min_alignment"]
    axis = random.normal(size=(BATCH, scenario.n_robots, scenario.dim))
    side = random.choice([-1.0, 1.0], size=(BATCH, scenario.n_robots, 1))

    def policy(seen: Any, now: Any) -> Array:
        f = scenario.observation_layout.net_bearing(seen)
        h = epsilon * unit(f) + side * math.sqrt(1 - epsilon**2) * unit(across(f, axis))
        return flexible_velocity(f, h)

    return policy


# ---- the claims ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Claim:
    """One row of the table."""

    name: str
    statement: str
    draw: Draw
    bound: Bound
    numbers: tuple[str, ...]
    """Of monitors.ALL; the first one's margin is reported, and a team that breaks any violates the
    claim. "time" is ``bound``, all others are at most 0."""
    law: Law | None = None
    """Who plays; None is law (1), or the paper's of robots that turn, and under certified headings
    adversaries."""

    @property
    def timed(self) -> bool:
        """Whether ``bound`` is a theorem's, so that T/bound is worth reporting."""
        return self.bound is not patience


_law_1 = partial(draw_team, by="law")
_unicycles = partial(draw_turning, by="law", dims=(2,))
_space = partial(draw_turning, by="law", dims=(3,))
_long_steps = partial(draw_team, step_factors=(4.0, 10.0))

CLAIMS: tuple[Claim, ...] = (
    Claim("lemma-1", "Σ‖f‖ ≥ 2 max a", _law_1, bound_a, ("lemma",)),
    Claim(
        "theorem-1",
        "law (1): V falls by τ Σ‖f‖² in every step, connected teams meet",
        *(_law_1, bound_a, ("law_descent", "time")),
    ),
    Claim(
        "necessity",
        "law (1): a disconnected graph leaves one robot for each piece",
        *(draw_disconnected, bound_of_pieces, ("pieces", "time")),
    ),
    Claim(
        "theorem-2",
        "any policy under certified headings: V never rises between merges, all meet",
        *(draw_team, bound_c, ("descent", "time")),
    ),
    Claim(
        "theorem-3",
        "unicycles meet under (7) with (8) or ω = cos t",
        *(_unicycles, patience, ("time",), cosine_or_not),
    ),
    Claim(
        "theorem-4",
        "3-D nonholonomic robots meet under (12), (17)",
        *(_space, patience, ("time",)),
    ),
    Claim("bound-A", "law (1): T ≤ A", _law_1, bound_a, ("time",)),
    Claim(
        "bound-B",
        "headings at a fixed angle to f: T ≤ B",
        *(_law_1, bound_c, ("time", "descent"), at_fixed_angle),
    ),
    Claim(
        "bound-C",
        "any policy under certified headings: T ≤ C",
        *(draw_team, bound_c, ("time",)),
    ),
    Claim(
        "gate",
        "any turn rates through the gate: V never rises between merges, all meet",
        *(draw_turning, patience, ("time", "descent")),
    ),
    Claim(
        "certified-step",
        "τ = r/(2D̄), law (4): V falls by τ Σ(hᵀf)² in every step",
        *(_law_1, bound_c, ("descent",), at_fixed_angle),
    ),
    Claim(
        "local-scaling",
        "4 to 10 times that step, scaled: V never rises between merges, all meet",
        *(_long_steps, bound_c, ("descent", "time")),
    ),
    Claim(
        "merge-rise",
        "V rises at a merge by at most r max(0, D_i + D_j − 4 a_ij)",
        *(draw_trees, bound_c, ("merge_rise",)),
    ),
)


# ---- what is found -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Finding:
    """What one batch says about a claim, or several."""

    trials: int
    margin: float
    """Worst over the teams; negative is bad, rounding aside."""
    time_over_bound: float
    """Worst over the teams; NaN where the claim names no time."""
    violations: int
    seconds: float = 0.0
    first: int | None = None
    """Number of the first batch with a violation."""


def worst(findings: Sequence[Finding]) -> Finding:
    """What several batches say together."""
    return Finding(
        trials=sum(finding.trials for finding in findings),
        margin=min(finding.margin for finding in findings),
        time_over_bound=max(finding.time_over_bound for finding in findings),
        violations=sum(finding.violations for finding in findings),
        seconds=sum(finding.seconds for finding in findings),
        first=next((one.first for one in findings if one.first is not None), None),
    )


def check(claim: Claim, seed: int, batch: int, trials: int, least_margin: float) -> Finding:
    """Run one batch of a claim, by its number, with margins ε of ``least_margin`` or more, until
    each team has met, is out of time or has broken one of the claim's numbers; and count ``trials``
    of its teams. Every base step is looked at, also where choices are held for several. The same
    arguments give the same finding, but for the seconds.
    """
    began = time.perf_counter()
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    trial = claim.draw(random, batch, least_margin)
    wrapped, seen, policy = begin(replace(trial, period=1), 0.0, BATCH)
    policy = policy if claim.law is None else claim.law(trial, random)
    teams = wrapped.unwrapped.simulator
    limit = claim.bound(trial, teams)
    kept = {name: np.zeros(BATCH) for name in claim.numbers if name != "time"}
    watch = Watch(wrapped.unwrapped, kept, 1, 0.0, climbing=True)
    # one step more: a bound falls within a step
    teams.set_max_steps(math.ceil(limit.max() / watch.held) + 1)
    wrong, chosen = np.zeros(BATCH, dtype=np.bool_), np.empty(0)
    for step in itertools.count():
        if not (np.isinf(watch.met) & ~teams.ended & ~wrong).any():
            break
        if step % trial.period == 0:
            chosen = np.asarray(policy(seen, watch.now), dtype=np.float32)
        seen, *_, infos = wrapped.step(chosen)
        wrong |= watch.look(infos).any(axis=0)
    if "time" in claim.numbers:
        wrong |= watch.met > limit
    late = watch.met / limit
    margins = 1.0 - late if claim.numbers[0] == "time" else -watch.closeness[claim.numbers[0]]
    return Finding(
        trials=trials,
        margin=float(margins[:trials].min()),
        time_over_bound=float(late[:trials].max()) if claim.timed else math.nan,
        violations=int(wrong[:trials].sum()),
        seconds=time.perf_counter() - began,
        first=batch if wrong[:trials].any() else None,
    )


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


def blocks_of(
    claim: Claim, batches: Sequence[tuple[int, int]], seed: int, min_alignment: float
) -> list[Block]:
    """The batches of a claim, cut into tasks."""
    size = math.ceil(len(batches) / _MOST)
    cuts = range(0, len(batches), size)
    return [Block(claim, tuple(batches[k : k + size]), seed, min_alignment) for k in cuts]


def look(block: Block) -> Finding:
    """Check the batches of a block."""
    claim, seed, margin = block.claim, block.seed, block.min_alignment
    return worst([check(claim, seed, k, count, margin) for k, count in block.batches])
