"""The claims of docs/theory.md, and the times by which they say that all have met."""

from __future__ import annotations

import numpy as np

from rendezvous_env import Simulator
from rendezvous_env.safety.theorems.constants import merge_rise_allowance
from rendezvous_env.safety.theorems.descent import time_bound

from .adversaries import at_fixed_angle, by_name, certified, unicycle_laws
from .cases import (
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
from .claim import (
    Array,
    Claim,
    as_chosen,
    by_law_1,
    falls,
    is_lemma_1,
    meets,
    merges_within_bound,
    no_rise,
    stays_apart,
)

PATIENCE = 500.0
"""Nonholonomic robots have no time bound; after this many seconds they are held not to meet."""


def bound_a(case: Case, teams: Simulator) -> Array:
    """Of theorem A, s."""
    return time_bound(case.scenario, teams.lyapunov())


def bound_c(case: Case, teams: Simulator) -> Array:
    """Of theorems B and C, s."""
    return time_bound(case.scenario, teams.lyapunov(), min_alignment=case.margin)


def bound_of_pieces(case: Case, teams: Simulator) -> Array:
    """Time by which each piece of a disconnected graph has met, s: the proof of A holds for it."""
    scenario = case.scenario
    above = teams.lyapunov() + merge_rise_allowance(scenario)
    return 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(case: Case, teams: Simulator) -> Array:
    """No theorem's: PATIENCE."""
    return np.full(teams.num_envs, PATIENCE)


def no_time(case: Case, teams: Simulator) -> Array:
    """One step shows what there is to see."""
    return np.zeros(teams.num_envs)


_law_1 = by_name("bearing-only")

CLAIMS: tuple[Claim, ...] = (
    Claim("lemma-1", "Σ‖f‖ ≥ 2 max a", draw_unlimited, _law_1, no_time, (is_lemma_1,), no_rise),
    Claim(
        "theorem-1",
        "law (1): V falls by τ Σ‖f‖² in every step, connected teams meet",
        *(draw_case, _law_1, bound_a, (falls, meets), by_law_1, True),
    ),
    Claim(
        "necessity",
        "law (1): a disconnected graph leaves one robot for each piece",
        *(draw_disconnected, _law_1, bound_of_pieces, (stays_apart,), no_rise),
    ),
    Claim(
        "theorem-2",
        "any policy under certified headings: V never rises between merges, all meet",
        *(draw_case, certified, bound_c, (falls, meets), as_chosen, True),
    ),
    Claim(
        "theorem-3",
        "unicycles meet under (7) with (8) or ω = cos t",
        *(draw_unicycles, unicycle_laws, patience, (meets,), no_rise),
    ),
    Claim(
        "theorem-4",
        "3-D nonholonomic robots meet under (12), (17)",
        *(draw_3d, by_name("nonholonomic-3d"), patience, (meets,), no_rise),
    ),
    Claim("bound-A", "law (1): T ≤ A", draw_case, _law_1, bound_a, (meets,), by_law_1, True),
    Claim(
        "bound-B",
        "headings at a fixed angle to f: T ≤ B",
        *(draw_case, at_fixed_angle, bound_c, (meets, falls), as_chosen, True),
    ),
    Claim(
        "bound-C",
        "any policy under certified headings: T ≤ C",
        *(draw_case, certified, bound_c, (meets,), as_chosen, True),
    ),
    Claim(
        "gate",
        "any turn rates through the gate: V never rises between merges, all meet",
        *(draw_nonholonomic, certified, patience, (meets, falls), no_rise),
    ),
    Claim(
        "certified-step",
        "τ = r/(2D̄), law (4): V falls by τ Σ(hᵀf)² in every step",
        *(draw_case, at_fixed_angle, bound_c, (falls,), as_chosen),
    ),
    Claim(
        "local-scaling",
        "4 to 10 times that step, scaled: V never rises between merges, all meet",
        *(draw_long_steps, certified, bound_c, (falls, meets), as_chosen, True),
    ),
    Claim(
        "merge-rise",
        "V rises at a merge by at most r max(0, D_i + D_j − 4 a_ij)",
        *(draw_trees, certified, bound_c, (merges_within_bound,), as_chosen),
    ),
)
