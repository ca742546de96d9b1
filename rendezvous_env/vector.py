"""The vector environment's wrappers with a guarantee, and teams to train in."""

from __future__ import annotations

from .faces.spaces import team_box
from .faces.training.doors import training_env
from .faces.vector_wrappers import (
    EnergyTankWrapper,
    GainWrapper,
    HeadingVectorWrapper,
    LinkKeepingWrapper,
)

__all__ = [
    "EnergyTankWrapper",
    "GainWrapper",
    "HeadingVectorWrapper",
    "LinkKeepingWrapper",
    "team_box",
    "training_env",
]
