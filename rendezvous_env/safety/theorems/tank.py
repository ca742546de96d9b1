"""Theorem D: the energy tank admits any motion while each robot's stored energy lasts.

**Assumptions.** Fixed, undirected, connected graph, bearings of all neighbours with errors at most
η. With s_i = min(1, r/(2 D_i τ), v_max/‖f_i‖), a displacement Δ_i changes the stored energy
A_i, A_i(0) = B_i ≥ 0, by

    G_i = 2 f_i·Δ_i − (2/r) D_i ‖Δ_i‖² − ε² τ s_i ‖f_i‖².

With errors see docs/guarantees.md, 11.

**Promise.** V + ΣA_i does not increase in a step without merge or contact, so V ≤ V0⁺ + (n−1) r W +
ΣB_i. Without walls, for single integrators,

    T ≤ (V0⁺ + (n−1) r W + ΣB_i) max_m m/(q_m² s_min) + (n−1) τ,

q_m = 2ε c_m − 2 (1+ε) m D̄_m sin(η/2) > 0 as in N1' with β = 0, s_min = min(1, r/(2D̄τ), v_max/D̄).
On complete graphs of equal weights a without obstacles, stored energy follows V at merges, and

    T ≤ ((V(0) + ΣB_i)/(n−1) + (n−1) r a) max_m m (m−1)/(q_m² s_min) + (n−1) τ.

Proof: docs/proofs.md, D.
"""

from ...scenario.scenario import Scenario
from . import assumptions as given
from . import constants as known
from .noise import certified_bounds
from .theorem import Asked, Theorem, TheoremBounds


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bound on V alone, with walls and for nonholonomic robots."""
    return TheoremBounds(
        lyapunov=known.tank_bounds(scenario, asked.budget, asked.observes_merges)[0]
    )


def bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Time bound."""
    most, each = known.tank_bounds(scenario, asked.budget, asked.observes_merges)
    words = "theorem D: all robots meet in finite time under energy tanks, for any velocities"
    words += f", with bearing errors of {asked.error:.4g} rad" * (asked.error > 0)
    who, even_so = "a tank of this alignment", "; V stays bounded even so"
    return certified_bounds(scenario, asked, most, each, 0.0, words, who, even_so)


_KEPT = *given.KEPT, given.rounding_pays_little
THEOREMS = (
    Theorem("D", ("tank",), given.UNHINDERED, bounds, every_step="ledger"),
    Theorem("D, the bound on V", ("tank",), _KEPT, lyapunov_bounds, False, "ledger"),
)
