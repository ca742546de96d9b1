"""Named reward terms and their weights. The reward may use the global state; observations never
do.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from .checks import names_unknown_fields, number


@names_unknown_fields("reward")
@dataclass(frozen=True)
class RewardWeights:
    """Weights of the terms of the team reward; every robot gets the team reward.

    Raises:
        ValueError: naming a weight that is not a finite number.
    """

    progress: float = 1.0
    """Times (V_t − V_{t+1})/V_0, which adds up to at most 1 over an episode."""
    time_penalty: float = 0.1
    """Paid evenly over the time limit."""
    collision_penalty: float = 0.1
    """Paid for each robot in contact with an obstacle, in each step."""
    rendezvous_bonus: float = 1.0
    """Earned once, when all robots have become one."""
    clearance_penalty: float = 0.0
    """Paid in each step for each robot, times 1 − clearance/``obstacle_range`` where it is nearer
    to an obstacle than that."""

    def __post_init__(self) -> None:
        for field in fields(self):
            weight = number(f"reward.{field.name}", getattr(self, field.name))
            object.__setattr__(self, field.name, weight)
