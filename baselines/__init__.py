"""Scripted policies: observations in, actions out, never a position, but for those that say
``privileged`` in their names.
"""

from . import laws, obstacle_avoidance, privileged_planner, tank_policies
from .policy import Policy, make, names

__all__ = [
    "Policy",
    "laws",
    "make",
    "names",
    "obstacle_avoidance",
    "privileged_planner",
    "tank_policies",
]
