"""What a robot model is to an experiment: actions, limits, what it keeps and senses.

Its equations are named by the type of its constants, see ``equations.motion``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..equations.robots.double_integrator import DoubleIntegrator
from ..equations.robots.kinematics import Nonholonomic3D, SingleIntegrator, Unicycle
from .checks import shown

MOST_KEPT = 4
"""Numbers that a robot model may keep from step to step."""
_SENSES = (None, "gravity", "velocity")


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
    keeps_velocity: bool = False
    """Whether the numbers that it keeps after its angles are its velocity in the global frame, m/s,
    never longer than the speed limit."""
    senses: str | None = None
    """What the last row of an observation is: "gravity", "velocity", or nothing."""
    action: str = "velocity, m/s"
    """What an action is, in words."""
    theorem: str | None = None
    """Which theorem covers its own law in continuous time, e.g. "theorem 3"; None where none
    does."""
    bounded: bool = False
    """Whether theorems 1, 2, A and C with the time bounds of theory 3 hold for it: its action is
    its velocity."""

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


def register_robot_model(model: RobotModel, *, replace: bool = False) -> None:
    """Make a robot model known by its name.

    Its equations must have been described by ``equations.motion.describe``.

    Args:
        model: the model.
        replace: whether it may take the place of another of that name (in a notebook).

    Raises:
        ValueError: if it is no RobotModel, its name is taken, it exists in no space, keeps too many
            numbers or senses what no robot can.
    """
    if not isinstance(model, RobotModel):
        raise ValueError(f"model is {shown(model)}; it must be a RobotModel")
    who = f"robot model {model.name!r}"
    if model.name in ROBOT_MODELS and not replace:
        raise ValueError(f"{who} is already registered; replace=True puts this one in its place")
    if not model.dims or not set(model.dims) <= {2, 3}:
        raise ValueError(f"{who} has dims {shown(model.dims)}; they must be of 2 and 3")
    if model.senses not in _SENSES:
        raise ValueError(f"{who} senses {shown(model.senses)}; it must be one of {_SENSES}")
    for dim in model.dims:
        size = model.memory_size(dim)
        if not model.n_angles <= size <= MOST_KEPT:
            raise ValueError(
                f"{who} keeps {size} numbers; it must be from {model.n_angles}, its angles, to "
                f"{MOST_KEPT}"
            )
        if model.keeps_velocity and size != model.n_angles + dim:
            raise ValueError(
                f"{who} keeps {size} numbers; with its velocity in {dim}-D it must be "
                f"{model.n_angles + dim}"
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
        keeps_velocity=True,
        senses="velocity",
        action="acceleration, m/s²",
    )
)
