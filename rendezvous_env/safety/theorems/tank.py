"""Theorem D: the energy tank, any motion at all while each robot's own energy budget lasts.

**Assumptions.** Fixed, undirected, connected graph, bearings of all neighbours, wrong by η at
most. With s_i = min(1, r/(2 D_i τ), v_max/‖f_i‖) a robot's tank A_i(0) = B_i ≥ 0 earns

    G_i = 2 f_i·Δ_i − (2/r) D_i ‖Δ_i‖² − ε² τ s_i ‖f_i‖²

by a displacement Δ_i; with errors see docs/guarantees.md, 11.

**Promise.** V + ΣA_i does not rise in a step without merge or contact, so V ≤ V0⁺ + (n−1) r W +
ΣB_i; and without walls, for robots whose action is their velocity,

    T ≤ (V0⁺ + (n−1) r W + ΣB_i) max_m m/(q_m² s_min) + (n−1) τ,

q_m = 2ε c_m − 2 (1+ε) m D̄_m sin(η/2) > 0 as in N1' with β = 0, s_min = min(1, r/(2D̄τ), v_max/D̄).
Where everyone sees everyone, all weights a, no obstacles, levels follow V at merges, and

    T ≤ ((V(0) + ΣB_i)/(n−1) + (n−1) r a) max_m m (m−1)/(q_m² s_min) + (n−1) τ.

Proof: docs/proofs.md, D.
"""

from ...scenario.scenario import Scenario
from . import assumptions as given
from . import constants as known
from .noise import certified_bounds
from .theorem import Asked, Bounds, Theorem


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """V alone: with walls, and for robots that turn."""
    return Bounds(lyapunov=known.tank_bounds(scenario, asked.budget, asked.observes_merges)[0])


def bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """The time."""
    most, each = known.tank_bounds(scenario, asked.budget, asked.observes_merges)
    words = "theorem D: whatever is wanted, all robots meet in finite time while a tank keeps count"
    words += f" and charges errors of {asked.error:.4g} rad" * (asked.error > 0)
    who, even_so = "a tank of this margin", "; V stays bounded even so"
    return certified_bounds(scenario, asked, most, each, 0.0, words, who, even_so)


_KEPT = *given.KEPT, given.rounding_pays_little
THEOREMS = (
    Theorem("D", ("tank",), given.UNHINDERED, bounds, every_step="ledger"),
    Theorem("D, the bound on V", ("tank",), _KEPT, lyapunov_bounds, False, "ledger"),
)
