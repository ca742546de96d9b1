"""The single integrator: a robot whose action is its velocity (paper, section II).

ṗ = v,    ‖v‖ ≤ v_max
"""

import math
from typing import NamedTuple

from ..compilation import kernel
from ..physics.vectors import dot, scaled, to_global
from .motion import Motion, describe
from .robot_models import RobotModel, register_robot_model


class SingleIntegrator(NamedTuple):
    """ṗ = v: the action is a velocity, m/s."""

    duration: float  # τ, s
    speed_limit: float  # v_max, m/s


@kernel(inline="code")
def speed_scale(square_speed, limit):
    """Speed ‖v‖, m/s, from its square, and the limiting factor min(1, v_max/‖v‖).

    Applies to accelerations, m/s², likewise.
    """
    speed = math.sqrt(square_speed)
    return speed, limit_factor(speed, limit)


@kernel(inline="code")
def limit_factor(speed, limit):
    """Factor min(1, v_max/‖v‖) on a velocity, a number without unit, of ‖v‖ and v_max, m/s."""
    return limit / speed if speed > limit else 1.0


@kernel(inline="code")
def _propose(model, action, frame, memory):
    """τ R v, with ‖v‖ limited."""
    speed, factor = speed_scale(dot(action, action), model.speed_limit)
    scale = model.duration * factor
    return scaled(to_global(frame, action), scale), speed * scale


describe(SingleIntegrator, Motion(_propose, drifts=False))
register_robot_model(
    RobotModel(
        "single_integrator",
        dims=(2, 3),
        constants=lambda scenario: SingleIntegrator(scenario.tau, scenario.speed_limit),
        bounds=lambda scenario: [scenario.speed_limit] * scenario.dim,
        bounded=True,
    )
)
