"""From a random field to what draws it."""

from __future__ import annotations

from ..experiment.obstacles import Field, ObstacleField
from ..experiment.walls import LAYOUTS
from .draw_field import FieldRules
from .draw_walls import WallRules


def field_rules(field: Field) -> FieldRules | WallRules:
    """The rules by which the obstacles of an episode are drawn, see ``fields``."""
    if isinstance(field, ObstacleField):
        return FieldRules(
            counts=field.count_range,
            radii=field.radius,
            region=field.region,
            keep_out=field.keep_out,
            overlap=field.overlap,
            passage=field.passage,
        )
    return WallRules(
        layout=list(LAYOUTS).index(field.layout),
        sizes=field.size,
        openings=field.opening,
        thickness=field.thickness,
        region=field.region,
        keep_out=field.keep_out,
    )
