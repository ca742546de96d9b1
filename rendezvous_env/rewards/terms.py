"""The terms of the team reward (design, section 6): their weights and their sum.

The reward may use the global state; observations never do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from ..checks import check_fields, names_unknown_fields
from ..compilation import kernel
from ..field_docs import lists_fields
from .custom_terms import as_custom

CLEARANCE_PENALTY = 4  # place of a weight whose term is only worked out where it is not zero


@lists_fields
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
    custom: Annotated[Mapping[str, float] | tuple[tuple[str, float], ...], as_custom] = field(
        default=(), kw_only=True
    )
    """Weights of terms of your own, by the names under which ``reward_term`` registered them."""

    def __post_init__(self) -> None:
        check_fields(self, "reward.{}")

    @property
    def built_in(self) -> tuple[float, ...]:
        """The weights w of ``team_reward``, in its order."""
        return tuple(value for name, value in vars(self).items() if name != "custom")

    def to_plain(self) -> dict[str, Any]:
        """The weights as plain data for TOML."""
        plain = asdict(self) | {"custom": dict(self.custom)}
        return {key: value for key, value in plain.items() if value != {}}


def earned_in_episode(
    weights: RewardWeights,
    progress: float,
    share: float,
    contacts: float,
    met: bool,
) -> dict[str, float]:
    """What each built-in term but the penalty of clearance adds up to in an episode, by name.

    Args:
        weights: w.
        progress: (V_0 − V_T)/V_0, without unit.
        share: of the time limit that passed, without unit.
        contacts: one for each robot and step, without unit.
        met: whether all robots met.
    """
    terms = {
        "progress": weights.progress * progress,
        "time_penalty": -weights.time_penalty * share,
        "collision_penalty": -weights.collision_penalty * contacts,
        "rendezvous_bonus": weights.rendezvous_bonus * met,
    }
    return {name: float(value) for name, value in terms.items() if getattr(weights, name) != 0.0}


@kernel(inline="code")
def team_reward(progress, time_share, contacts, closeness, met, weights):
    """Team reward of one step, a number without unit like all that it is made of.

        w₀ progress − w₁ time_share − w₂ contacts − w₄ closeness + w₃ if met

    Progress is (V_t − V_{t+1})/V_0, the time share τ / time limit, closeness
    Σ_i max(0, 1 − clearance_i/range), and w ``RewardWeights.built_in``; ``contacts`` counts robots
    in contact with an obstacle.
    """
    reward = weights[0] * progress - weights[1] * time_share - weights[2] * contacts
    reward = reward - weights[CLEARANCE_PENALTY] * closeness
    return reward + weights[3] if met else reward
