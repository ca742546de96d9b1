"""Team reward: weights and sum of its terms.

The reward may use the global state; observations never do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from ..compilation import kernel
from ..field_checks import check_fields, names_unknown_fields
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from .custom_terms import as_custom

CLEARANCE_PENALTY = 4  # index of a weight whose term is computed only if it is not zero


@lists_fields
@names_unknown_fields("reward")
@dataclass(frozen=True)
class RewardWeights:
    """Weights of the terms of the team reward, which every robot receives.

    Raises:
        ValueError: naming a weight that is not a finite number.
    """

    progress: float = 1.0
    """Weight of (V_t − V_{t+1})/V_0, whose sum over an episode is at most 1."""
    time_penalty: float = 0.1
    """Cost of an episode of full length, spread evenly over the time limit."""
    collision_penalty: float = 0.1
    """Cost per robot in contact with an obstacle and step."""
    rendezvous_bonus: float = 1.0
    """Reward at rendezvous, given once."""
    clearance_penalty: float = 0.0
    """Cost per robot and step, times max(0, 1 − clearance/``obstacle_range``)."""
    custom: Annotated[Mapping[str, float] | tuple[tuple[str, float], ...], as_custom] = field(
        default=(), kw_only=True
    )
    """Weights of custom terms by their name in ``reward_term``."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        check_fields(self, "reward.{}")

    @property
    def built_in(self) -> tuple[float, ...]:
        """Weights w of ``team_reward``, in order."""
        return tuple(value for name, value in vars(self).items() if name != "custom")

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML."""
        plain = asdict(self) | {"custom": dict(self.custom)}
        return {key: value for key, value in plain.items() if value != {}}


def earned_in_episode(
    weights: RewardWeights,
    progress: float,
    share: float,
    contacts: float,
    met: bool,
) -> dict[str, float]:
    """Sums of the built-in terms over an episode, by name, without the clearance penalty.

    Args:
        weights: w.
        progress: (V_0 − V_T)/V_0, without unit.
        share: elapsed fraction of the time limit, without unit.
        contacts: number of contacts, one for each robot and step, without unit.
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
    """Team reward of one step, dimensionless.

        w₀ progress − w₁ time_share − w₂ contacts − w₄ closeness + w₃ if met

    Progress is (V_t − V_{t+1})/V_0, the time share τ / time limit, closeness
    Σ_i max(0, 1 − clearance_i/range), and w ``RewardWeights.built_in``; ``contacts`` counts robots
    in contact with an obstacle.
    """
    reward = weights[0] * progress - weights[1] * time_share - weights[2] * contacts
    reward = reward - weights[CLEARANCE_PENALTY] * closeness
    return reward + weights[3] if met else reward
