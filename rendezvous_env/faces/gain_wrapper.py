"""GainWrapper for PettingZoo: one weight per neighbour, and the hull of the team never grows."""

from __future__ import annotations

from ..guarantee.gains import Gains
from ..rendezvous_v0 import RendezvousParallelEnv
from .filter_wrapper import FilterWrapper, base_of


class GainWrapper(FilterWrapper):
    """Robots weigh their neighbours; they move along the weighted bearings.

        v_i = Σ_j c_ij g_ij,   c_ij ∝ w_j a_ij,   min_gain ≤ Σ_j c_ij ≤ max_gain    (theorem G)

    Whatever the weights are, the convex hull of the team never grows, on any graph: directed,
    switching, or never connected at once. While every robot sees somebody all meet in finite time.
    V is not watched: it may rise.

    ## Action space

    ``Box(0, 1, (K,))``, a weight for each neighbour row, in the order of the rows that are seen.
    Rows that are absent do not count. If the others are all zero, they count alike. Then all of
    them are scaled as a whole.

    ## Observation space

    The rows of the base environment, with ``frame="net_bearing"`` turned as by
    ``HeadingVectorWrapper``.

    ## Infos

    Those of the base environment, and of the last base step

    | key | |
    |---|---|
    | gain | Σ_j c_ij, m/s; 0 for a robot that sees nobody |
    | alignment | |h_iᵀf_i|/‖f_i‖, h_i the direction of motion; NaN without any |
    | lyapunov_rate | −2 f_iᵀv_i, m²/s²: positive where V is made to rise |

    Args:
        env: a rendezvous parallel environment of robots whose action is their velocity.
        min_gain: m/s; None is a*. The promised time is in inverse proportion to it.
        max_gain: m/s; None is D̄. Never more than r/τ: a robot that goes farther in one step may
            leave the hull.
        frame: "net_bearing" or "local".
        decision_period: base steps for which weights are held. Rewards are summed, and a robot that
            merges on the way ends with its last observation.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        min_gain: float | None = None,
        max_gain: float | None = None,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        self.gains = Gains(
            base_of(env, "GainWrapper").scenario,
            1,
            min_gain=min_gain,
            max_gain=max_gain,
            frame=frame,
        )
        super().__init__(env, self.gains, "gains", decision_period)
