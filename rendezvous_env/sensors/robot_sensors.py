"""Sensors that differ between the robots of a team."""

from __future__ import annotations

import dataclasses
from typing import Any

from .. import checks, field_checks
from .sensing import PER_ROBOT, Sensing

_one = field_checks.of_class(Sensing)


def as_sensing(field: str, value: Any) -> Sensing:
    """Sensor model of all robots, from one Sensing or table, or a list with one for each robot.

    Raises:
        ValueError: for sensors of a list that differ in other fields than ``PER_ROBOT``.
    """
    if not checks.is_sequence(value):
        return _one(field, value)
    if len(value) == 0:
        checks.raise_invalid(field, value, "a Sensing, or a list of one for each robot")
    sensors = [_sensor(field, robot, own) for robot, own in enumerate(value)]
    fields = {one.name: _combined(field, one.name, sensors) for one in dataclasses.fields(Sensing)}
    return Sensing(**fields)


def _sensor(field: str, robot: int, own: Any) -> Sensing:
    """Sensor of one robot; errors about its fields name the robot."""
    try:
        return _one(f"{field}[{robot}]", own)
    except ValueError as error:
        raise ValueError(str(error).replace("sensing.", f"{field}[{robot}].", 1)) from error


setattr(as_sensing, "made", Sensing)  # noqa: B010 - as ``of_class``, for hints on its fields


def _combined(field: str, name: str, sensors: list[Sensing]) -> Any:
    """A field of the sensors of all robots: one value, or a list in a field of ``PER_ROBOT``."""
    values = [getattr(sensor, name) for sensor in sensors]
    for robot, (value, sensor) in enumerate(zip(values, sensors, strict=True)):
        if name in PER_ROBOT and (given := sensor.list_given(name)) is not None:
            wanted = "one value, not a list, in the sensor of one robot"
            checks.raise_invalid(f"{field}[{robot}].{name}", given, wanted)
        if name not in PER_ROBOT and value != values[0]:
            raise ValueError(
                f"{field}[{robot}].{name} is {checks.short_repr(value)}; it must be "
                f"{checks.short_repr(values[0])} as that of robot 0: sensors of a team may differ "
                f"in every field but {name}, which applies to the observations of all robots"
            )
    return values[0] if all(value == values[0] for value in values) else tuple(values)
