"""LinkKeepingWrapper for PettingZoo: any motion, projected so that no link grows longer."""

from __future__ import annotations

from ..guarantee.links import LinkKeeping
from ..rendezvous_v0 import RendezvousParallelEnv
from .filter_wrapper import FilterWrapper, base_of


class LinkKeepingWrapper(FilterWrapper):
    """Robots say where they want to go; they go as near to that as their links allow.

        v_i = λ d_i q_i + (1 − λ) P(wanted)                         (theorem R c, guarantees 12)

    P is the projection onto the velocities with which no link grows longer whatever the others do,
    as long as they do the same, and q_i the point of least norm of the robot's bearings. So with a
    sensor of limited range a link that is shorter than range − (n − 1) r/2 is never lost but by a
    merge, and if such links connect the team at the start, all meet in finite time whatever the
    policy does. Claimed for motion without contacts: an obstacle turns robots aside.

    ## Action space

    ``Box(−1, 1, (d,))``, the wanted velocity in units of v_max, in the frame that is observed; a
    longer one is scaled to v_max.

    ## Observation space

    The rows of the base environment, with ``frame="net_bearing"`` turned as by
    ``HeadingVectorWrapper``.

    ## Infos

    Those of the base environment, and of the last base step ``alignment`` = |h_iᵀf_i|/‖f_i‖, h_i
    the direction of motion (NaN without any), and ``lyapunov_rate`` = −2 f_iᵀv_i, m²/s², which is
    never positive while no bearing errs by more than ``bearing_error``.

    Args:
        env: a rendezvous parallel environment of robots whose action is their velocity, and who see
            each other or not: with a field of view, rows that drop out, or robots and obstacles
            that hide others sight is not so, or ends for other reasons than distance.
        share: λ, in (0, 1]: how much of the velocity is the link-keeping law's. The promised time
            is in inverse proportion to it.
        bearing_error: η, rad: links are kept while no bearing is wrong by more. For η < π/(2n) all
            meet (theorem R d).
        frame: "net_bearing" or "local".
        decision_period: base steps for which a wish is held; it is projected in each. Rewards are
            summed, and a robot that merges on the way ends with its last observation.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right, or why the robots of
            this scenario cannot keep their links.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        self.links = LinkKeeping(
            base_of(env, "LinkKeepingWrapper").scenario,
            1,
            share=share,
            bearing_error=bearing_error,
            frame=frame,
        )
        super().__init__(env, self.links, "links", decision_period)
