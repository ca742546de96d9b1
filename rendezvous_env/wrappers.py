"""HeadingVectorWrapper for PettingZoo: under it any policy keeps Theorem 2's guarantee."""

from __future__ import annotations

from .faces.filter_wrapper import FilterWrapper, base_of
from .guarantee.steering import Steering
from .rendezvous_v0 import RendezvousParallelEnv


class HeadingVectorWrapper(FilterWrapper):
    """Robots choose a heading vector h_i instead of an action; law (4) moves them.

        ṗ_i = h_i h_iᵀ f_i                                              (Zhao & Zheng, eq. 4)

    The raw vector of any policy becomes h_i by ``certified_heading`` (theorem C), so that without
    obstacles all robots meet within the certificate's time bound whatever the policy does.
    Velocities are scaled by r/(2 D_i τ) where the step is longer than certified (theory 4).
    Nonholonomic robots choose turn rates through the gate of theory 3 and drive with v = mᵀf.

    ## Action space

    ``Box(−1, 1, (d,))``, a raw vector in the frame that is observed; its length does not count. For
    nonholonomic robots ``Box(−1, 1, (1,))`` or ``(2,)``: turn rates in units of ``max_turn_rate``.

    ## Observation space

    The rows of the base environment. With ``frame="net_bearing"`` (single integrators) in a frame
    whose x axis is along f_i, so that any network is rotation-equivariant: exactly in 2-D; in 3-D
    the second axis comes from the row with the longest part across f_i. While ‖f_i‖ < δ the last
    frame is kept.

    ## Infos

    Those of the base environment, and ``alignment`` = |h_iᵀf_i|/‖f_i‖ (NaN where f_i = 0) and
    ``lyapunov_rate`` = −2 (h_iᵀf_i)², both of the last base step.

    Args:
        env: a rendezvous parallel environment.
        min_alignment: ε, in (0, 1).
        max_turn_rate: ω_max, rad/s; for nonholonomic robots the scenario's limit holds too.
        frame: "net_bearing" or "local".
        decision_period: base steps for which a raw vector is held; the certified heading follows
            f_i in each. Rewards are summed, and a robot that merges on the way ends with its
            last observation.
        certified: False lets the raw vector through as h_i, without any guarantee.
        bearing_error: η, rad: V never rises between merges while no bearing is wrong by more.
            Robots then go max(0, h_iᵀf_i − e_i) along h_i, e_i = 2 sin(η/2) D_i (theorem N1').

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
        bearing_error: float = 0.0,
    ) -> None:
        self.steering = Steering(
            base_of(env, "HeadingVectorWrapper").scenario,
            1,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
            bearing_error=bearing_error,
        )
        super().__init__(env, self.steering, "steering", decision_period)
