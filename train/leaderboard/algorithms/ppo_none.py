"""PPO, and nothing that keeps it safe."""

from ..ppo import algorithm

ALGORITHM = algorithm(
    "PPO on the team's reward alone", "none", "none", safety="none", touch_penalty=0.0
)
