"""Which robots a learned policy can steer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..policy import is_single_integrator

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario


def can_steer(scenario: Scenario) -> bool:
    """Whether its robots are single integrators in the plane."""
    return is_single_integrator(scenario) and scenario.dim == 2


def check_readable(scenario: Scenario) -> None:
    """Refuse robots that a learned policy cannot steer.

    Raises:
        ValueError: unless they are single integrators in the plane.
    """
    if not can_steer(scenario):
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots in {scenario.dim}-D; "
            "learned policies steer single_integrator robots in 2-D"
        )
