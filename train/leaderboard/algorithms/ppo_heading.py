"""PPO under certified headings."""

from ..ppo import algorithm

ALGORITHM = algorithm(
    "PPO under certified headings; a first touch costs 1", "heading", "heading", safety="heading"
)
