"""Policies: functions from observations to actions.

Only oracles, with ``privileged`` in their names, read positions.
"""

from . import laws, learned
from .filtered_policies import HeadingPolicy, TankPolicy
from .laws import literature_laws as field_laws
from .laws import pursuit
from .obstacle_rules import mixed_rules, obstacle_avoidance, search_and_pursue, tank_policies
from .policy import Policy, RealTimePolicy, make, names
from .references import blind_policies, privileged_laws, privileged_planner
from .robot_policy import RobotPolicy
from .trained_policy import TrainedPolicy

__all__ = [
    "HeadingPolicy", "Policy", "RealTimePolicy", "RobotPolicy", "TankPolicy", "TrainedPolicy",
    "blind_policies", "field_laws", "laws", "learned", "make", "mixed_rules", "names",
    "obstacle_avoidance", "privileged_laws", "privileged_planner", "pursuit", "search_and_pursue",
    "tank_policies",
]  # fmt: skip


def __dir__() -> list[str]:
    """Public names; submodules remain importable."""
    return [*__all__, "__all__", "__doc__", "__file__", "__name__", "__path__"]
