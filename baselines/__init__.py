"""Policies: observations in, actions out, never a position, but for those that say
``privileged`` in their names.
"""

from . import (
    field_laws,
    laws,
    learned,
    obstacle_avoidance,
    privileged_laws,
    privileged_planner,
    pursuit,
    tank_policies,
)
from .policy import Policy, make, names

__all__ = [
    "Policy",
    "field_laws",
    "laws",
    "learned",
    "make",
    "names",
    "obstacle_avoidance",
    "privileged_laws",
    "privileged_planner",
    "pursuit",
    "tank_policies",
]
