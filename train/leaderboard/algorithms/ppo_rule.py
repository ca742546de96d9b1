"""PPO over the rule that leads round obstacles, without a guarantee."""

from ..ppo import algorithm

ALGORITHM = algorithm(
    "PPO whose choices the joined rule leads round obstacles; a first touch costs 1",
    "rule",
    "none",
    safety="rule",
)
