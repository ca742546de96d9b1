"""The wrappers with a guarantee for the vector environment: the same, for B teams at once."""

from __future__ import annotations

from ..guarantee.energy_tank import EnergyTank
from ..guarantee.gains import Gains
from ..guarantee.links import LinkKeeping
from ..guarantee.steering import Steering
from .spaces import team_box
from .vector_env import RendezvousVectorEnv
from .vector_filter_wrapper import VectorFilterWrapper, check_ours

__all__ = [
    "EnergyTankWrapper",
    "GainWrapper",
    "HeadingVectorWrapper",
    "LinkKeepingWrapper",
    "team_box",
]


class HeadingVectorWrapper(VectorFilterWrapper):
    """Teams choose heading vectors h_i; law (4) moves them, and any policy keeps theorem C.

    Actions, observations, arguments and guarantee are those of ``wrappers.HeadingVectorWrapper``,
    in arrays: raw vectors (B, n, k) in [−1, 1], observations (B, n, rows, d). Infos carry
    "alignment" and "lyapunov_rate", (B, n) each, of the last base step. A team that ends within
    a decision period stands still for the rest of it; one that has begun anew has forgotten its
    headings.

    Args:
        env: a RendezvousVectorEnv, in any autoreset mode.
        min_alignment: ε, in (0, 1).
        max_turn_rate: ω_max, rad/s.
        frame: "net_bearing" or "local".
        decision_period: base steps for which a raw vector is held.
        certified: False lets the raw vector through as h_i, without any guarantee.
        bearing_error: η, rad: V never rises between merges while no bearing is wrong by more.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousVectorEnv,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
        certified: bool = True,
        bearing_error: float = 0.0,
    ) -> None:
        self.steering = Steering(
            check_ours(env, "HeadingVectorWrapper").scenario,
            env.num_envs,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
            bearing_error=bearing_error,
            num_threads=env.simulator.num_threads,
        )
        super().__init__(env, self.steering, "steering", decision_period)


class EnergyTankWrapper(VectorFilterWrapper):
    """Teams say where they want to go; their robots' energy tanks say how long V may rise for it.

    Actions, observations, arguments and guarantee are those of ``tank_wrapper.EnergyTankWrapper``,
    in arrays: wishes (B, n, a) in [−1, 1], observations (B, n, rows, d). Infos carry "tank",
    "carried_out", "alignment" and "lyapunov_rate", (B, n) each, of the last base step; the tank of
    a robot that is gone is 0. A team that ends within a decision period stands still for the rest
    of it, and its tanks rest with it; one that has begun anew has its budget.

    Args:
        env: a RendezvousVectorEnv, in any autoreset mode.
        budget: B_i, the level of each robot's tank at the start of an episode, m²/s.
        min_alignment: ε, in (0, 1).
        frame: "net_bearing" or "local".
        decision_period: base steps for which a wish is held; the ledger is kept in each.
        observe_level: whether robots see the level of their own tank, in one row more.
        bearing_error: η, rad: the promises hold while no bearing is wrong by more.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousVectorEnv,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        decision_period: int = 1,
        observe_level: bool = False,
        bearing_error: float = 0.0,
    ) -> None:
        self.tank = EnergyTank(
            check_ours(env, "EnergyTankWrapper").scenario,
            env.num_envs,
            budget=budget,
            min_alignment=min_alignment,
            frame=frame,
            observe_level=observe_level,
            bearing_error=bearing_error,
            num_threads=env.simulator.num_threads,
        )
        super().__init__(env, self.tank, "tank", decision_period)


class GainWrapper(VectorFilterWrapper):
    """Teams weigh their robots' neighbours; the hull of a team never grows.

    Actions, observations, arguments and guarantee are those of ``gain_wrapper.GainWrapper``, in
    arrays: weights (B, n, K) in [0, 1], observations (B, n, rows, d). Infos carry "gain",
    "alignment" and "lyapunov_rate", (B, n) each, of the last base step. A team that ends within a
    decision period stands still for the rest of it.

    Args:
        env: a RendezvousVectorEnv of robots whose action is their velocity, in any autoreset mode.
        min_gain: least Σ_j c_ij of a robot that sees somebody, m/s; None is a*.
        max_gain: the most, m/s; None is D̄. Never more than r/τ.
        frame: "net_bearing" or "local".
        decision_period: base steps for which weights are held.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousVectorEnv,
        min_gain: float | None = None,
        max_gain: float | None = None,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        self.gains = Gains(
            check_ours(env, "GainWrapper").scenario,
            env.num_envs,
            min_gain=min_gain,
            max_gain=max_gain,
            frame=frame,
            num_threads=env.simulator.num_threads,
        )
        super().__init__(env, self.gains, "gains", decision_period)


class LinkKeepingWrapper(VectorFilterWrapper):
    """Teams say where they want to go; their robots go as near to that as their links allow.

    Actions, observations, arguments and guarantee are those of
    ``link_keeping_wrapper.LinkKeepingWrapper``, in arrays: wishes (B, n, d) in [−1, 1],
    observations (B, n, rows, d). Infos carry "alignment" and "lyapunov_rate", (B, n) each, of the
    last base step. A team that ends within a decision period stands still for the rest of it.

    Args:
        env: a RendezvousVectorEnv of robots whose action is their velocity and whose sight is
            symmetric, in any autoreset mode.
        share: λ, in (0, 1]: how much of each velocity is the link-keeping law's.
        bearing_error: η, rad: links are kept while no bearing is wrong by more.
        frame: "net_bearing" or "local".
        decision_period: base steps for which a wish is held; it is projected in each.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right, or why the robots of
            this scenario cannot keep their links.
    """

    def __init__(
        self,
        env: RendezvousVectorEnv,
        share: float = 0.5,
        bearing_error: float = 0.0,
        frame: str = "net_bearing",
        decision_period: int = 1,
    ) -> None:
        self.links = LinkKeeping(
            check_ours(env, "LinkKeepingWrapper").scenario,
            env.num_envs,
            share=share,
            bearing_error=bearing_error,
            frame=frame,
            num_threads=env.simulator.num_threads,
        )
        super().__init__(env, self.links, "links", decision_period)
