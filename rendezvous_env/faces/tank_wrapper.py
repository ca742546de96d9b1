"""EnergyTankWrapper for PettingZoo: any motion, while each robot's own ledger lasts."""

from __future__ import annotations

from ..guarantee.energy_tank import EnergyTank
from ..rendezvous_v0 import RendezvousParallelEnv
from .filter_wrapper import FilterWrapper, base_of


class EnergyTankWrapper(FilterWrapper):
    """Robots say where they want to go; their energy tanks say how long V may rise for it.

        A_i ← A_i + G_i(Δ_i),   G_i(Δ) = 2 f_i·Δ − (2/r) D_i ‖Δ‖² − ε² τ s_i ‖f_i‖²  (guarantees 8)

    What a robot wants is carried out while A_i + G_i ≥ 0, even straight away from f_i. Otherwise
    law (4) moves it along the wanted direction, projected onto the cap |hᵀf_i| ≥ ε‖f_i‖, or along
    f_i if it wants nothing, and that fills the tank. So V ≤ V(0) + n·budget until the first merge,
    and without obstacles all robots meet in finite time whatever the policy does (theorem D).

    ## Action space

    ``Box(−1, 1, (d,))``, the wanted velocity in units of v_max, in the frame that is observed; a
    longer one is scaled to v_max. For other robot models the base action in units of its bounds.
    For nonholonomic robots the ledger has no term ε², and there is no time bound; with an empty
    tank they drive with v = s mᵀf and turn through the gate of theory 3.

    ## Observation space

    The rows of the base environment, with ``frame="net_bearing"`` (single integrators) turned as by
    ``HeadingVectorWrapper``. With ``observe_level`` one row more, the last: (A_i/(r D̄), 0, …), its
    length the level of the robot's own tank in units of twice the most that a step can earn. The
    robot knows it from its own past: it is nothing that it sees.

    ## Infos

    Those of the base environment, and of the last base step

    | key | |
    |---|---|
    | tank | A_i after it, m²/s; 0 for a robot that has merged: the survivor has it |
    | carried_out | whether the wish was, or law (4) in its place |
    | alignment | |h_iᵀf_i|/‖f_i‖, h_i the direction of motion or the body axis; NaN without any |
    | lyapunov_rate | −2 f_iᵀΔ_i/τ, m²/s²: positive where V is made to rise |

    In a step with contact a robot books min(0, G_i): the bound on V is claimed for motion without
    contacts. A survivor's tank is the sum of both.

    Args:
        env: a rendezvous parallel environment.
        budget: B_i, the level of each robot's tank at the start of an episode, m²/s.
        min_alignment: ε, in (0, 1): how fast robots are promised to meet.
        frame: "net_bearing" or "local".
        decision_period: base steps for which a wish is held; the ledger is kept in each. Rewards
            are summed, and a robot that merges on the way ends with its last observation.
        observe_level: whether robots see the level of their own tank.
        bearing_error: η, rad: the promises hold while no bearing is wrong by more; each step is
            charged what that could feign.

    Raises:
        TypeError: for another kind of environment.
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        budget: float = 0.0,
        min_alignment: float = 0.05,
        frame: str = "net_bearing",
        decision_period: int = 1,
        observe_level: bool = False,
        bearing_error: float = 0.0,
    ) -> None:
        self.tank = EnergyTank(
            base_of(env, "EnergyTankWrapper").scenario,
            1,
            budget=budget,
            min_alignment=min_alignment,
            frame=frame,
            observe_level=observe_level,
            bearing_error=bearing_error,
        )
        super().__init__(env, self.tank, "tank", decision_period)
