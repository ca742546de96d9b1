"""PPO that pays for its first touch."""

from ..ppo import algorithm

ALGORITHM = algorithm("PPO; a robot's first touch costs it 1", "penalty", "none", safety="none")
