"""Vector environment wrappers with guarantees, and training environments."""

from .envs.spaces import team_box
from .envs.training import training_env
from .envs.vector_wrappers import (
    EnergyTankWrapper,
    GainWrapper,
    GuaranteeWrapper,
    HeadingVectorWrapper,
    LinkKeepingWrapper,
)

__all__ = [
    "EnergyTankWrapper", "GainWrapper", "GuaranteeWrapper", "HeadingVectorWrapper",
    "LinkKeepingWrapper", "team_box", "training_env",
]  # fmt: skip
