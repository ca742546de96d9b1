"""The wrappers with a guarantee for the vector environment: the same, for B teams at once."""

from __future__ import annotations

from .faces.vector_env import RendezvousVectorEnv
from .faces.vector_filter_wrapper import VectorFilterWrapper, check_ours, team_box
from .guarantee.energy_tank import EnergyTank
from .guarantee.steering import Steering

__all__ = ["EnergyTankWrapper", "HeadingVectorWrapper", "team_box"]


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
    ) -> None:
        self.steering = Steering(
            check_ours(env, "HeadingVectorWrapper").scenario,
            env.num_envs,
            min_alignment=min_alignment,
            max_turn_rate=max_turn_rate,
            frame=frame,
            certified=certified,
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
    ) -> None:
        self.tank = EnergyTank(
            check_ours(env, "EnergyTankWrapper").scenario,
            env.num_envs,
            budget=budget,
            min_alignment=min_alignment,
            frame=frame,
            observe_level=observe_level,
            num_threads=env.simulator.num_threads,
        )
        super().__init__(env, self.tank, "tank", decision_period)
