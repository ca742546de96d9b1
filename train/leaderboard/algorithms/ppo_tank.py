"""PPO under energy tanks."""

from ..ppo import algorithm

ALGORITHM = algorithm(
    "PPO under energy tanks of the shipped budget; a first touch costs 1",
    "tank",
    "tank",
    safety="tank",
)
