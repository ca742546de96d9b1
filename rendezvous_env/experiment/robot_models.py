"""What a robot model is to an experiment: actions, limits, what it keeps and senses.

Its equations are named by the type of its constants, see ``equations.motion``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..equations.double_integrator import DoubleIntegrator
from ..equations.kinematics import Nonholonomic3D, SingleIntegrator, Unicycle

MOST_KEPT = 4
"""Numbers that a robot model may keep from step to step."""


@dataclass(frozen=True)
class RobotModel:
    """One robot model."""

    name: str
    dims: tuple[int, ...]
    """Dimensions of space it exists in."""
    constants: Callable[[Any], Any]
    """Scenario → the NamedTuple of constants that its equations take; it must have the fields
    ``duration``, s, and ``speed_limit``, m/s, which no motion exceeds."""
    bounds: Callable[[Any], list[float]]
    """Scenario → symmetric bound on each number of an action."""
    n_angles: int = 0
    """Angles that make up its attitude, the first numbers that it keeps; without any its frame is
    fixed."""
    n_kept: Callable[[int], int] | None = None
    """Dimension → numbers kept from step to step; None is ``n_angles``."""
    senses: str | None = None
    """What the last row of an observation is: "gravity", "velocity", or nothing."""
    action: str = "velocity, m/s"
    """What an action is, in words."""
    theorem: str | None = None
    """Which theorem covers its own law in continuous time; None where none does."""
    bounded: bool = False
    """Whether the time bounds of theory 3 hold for it."""

    def memory_size(self, dim: int) -> int:
        """Numbers that a robot keeps from step to step."""
        return self.n_angles if self.n_kept is None else self.n_kept(dim)

    @property
    def nonholonomic(self) -> bool:
        """Whether the robot can only move along its body axis."""
        return self.n_angles > 0

    @property
    def senses_gravity(self) -> bool:
        """Whether the observation has a gravity row: law (17) needs the pitch."""
        return self.senses == "gravity"

    @property
    def senses_velocity(self) -> bool:
        """Whether the observation has a row for the robot's own velocity."""
        return self.senses == "velocity"


ROBOT_MODELS: dict[str, RobotModel] = {}


def register_robot_model(model: RobotModel) -> None:
    """Make a robot model known by its name.

    Its equations must have been described by ``equations.motion.describe``.

    Raises:
        ValueError: if the name is taken, or the model keeps too many numbers.
    """
    if model.name in ROBOT_MODELS:
        raise ValueError(f"robot model {model.name!r} is already registered")
    for dim in model.dims:
        if model.memory_size(dim) > MOST_KEPT:
            raise ValueError(
                f"robot model {model.name!r} keeps {model.memory_size(dim)} numbers; at most "
                f"{MOST_KEPT} can be kept"
            )
    ROBOT_MODELS[model.name] = model


register_robot_model(
    RobotModel(
        "single_integrator",
        dims=(2, 3),
        constants=lambda scenario: SingleIntegrator(scenario.tau, scenario.speed_limit),
        bounds=lambda scenario: [scenario.speed_limit] * scenario.dim,
        bounded=True,
    )
)
register_robot_model(
    RobotModel(
        "unicycle",
        dims=(2,),
        constants=lambda scenario: Unicycle(
            scenario.tau, scenario.speed_limit, scenario.turn_limit
        ),
        bounds=lambda scenario: [scenario.speed_limit, scenario.turn_limit],
        n_angles=1,
        action="v, ω: m/s, rad/s",
        theorem="theorem 3",
    )
)
register_robot_model(
    RobotModel(
        "nonholonomic_3d",
        dims=(3,),
        constants=lambda scenario: Nonholonomic3D(
            scenario.tau, scenario.speed_limit, 10 * scenario.turn_limit, scenario.turn_limit
        ),
        # law (17) divides ω_α by cos β; at its bound it saturates
        bounds=lambda scenario: [
            scenario.speed_limit,
            10 * scenario.turn_limit,
            scenario.turn_limit,
        ],
        n_angles=2,
        senses="gravity",
        action="v, ω_α, ω_β: m/s, rad/s, rad/s",
        theorem="theorem 4",
    )
)
register_robot_model(
    RobotModel(
        "double_integrator",
        dims=(2, 3),
        constants=lambda scenario: DoubleIntegrator(
            scenario.tau, scenario.speed_limit, scenario.acceleration_limit, (0.0,) * scenario.dim
        ),
        bounds=lambda scenario: [scenario.acceleration_limit] * scenario.dim,
        n_kept=lambda dim: dim,
        senses="velocity",
        action="acceleration, m/s²",
    )
)
