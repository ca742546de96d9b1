"""PPO-Lagrangian (Ray, Achiam & Amodei 2019) on the cost channel, with one critic."""

from ..ppo import algorithm

ALGORITHM = algorithm(
    "PPO-Lagrangian: touches cost λ, which grows while an episode has more than 0.1 of them",
    "Lagrangian",
    "none",
    safety="none",
    touch_penalty=0.0,
    limit=0.1,
)
