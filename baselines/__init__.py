"""Policies: observations in, actions out, never a position, but for those that say
``privileged`` in their names.
"""

from . import (
    blind_policies,
    field_laws,
    laws,
    learned,
    obstacle_avoidance,
    privileged_laws,
    privileged_planner,
    pursuit,
    tank_policies,
)
from .policy import Policy, RealTimePolicy, make, names
from .robot_policy import RobotPolicy
from .vector_policies import HeadingPolicy, TankPolicy

__all__ = [
    "HeadingPolicy",
    "Policy",
    "RealTimePolicy",
    "RobotPolicy",
    "TankPolicy",
    "blind_policies",
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
