"""Bearing-only multi-robot rendezvous: the environment.

Each robot measures bearings to its neighbours and to obstacle edges, without ranges. All robots
must meet.
"""

from importlib import import_module as _import_module
from typing import Any as _Any

from . import graphs, rendezvous_v0, vector
from .compilation import kernel
from .deprecation import warn_renamed as _warn_renamed
from .envs.gymnasium_env import make_vec, register
from .envs.training import register_preset as _register_preset
from .envs.training_parallel_env import training_env
from .envs.wrappers import (
    EnergyTankWrapper,
    GainWrapper,
    GuaranteeWrapper,
    HeadingVectorWrapper,
    LinkKeepingWrapper,
)
from .obstacles.capsule import Capsule
from .obstacles.disc import Disc, Sphere
from .obstacles.fields import ObstacleField
from .obstacles.moving import Moving
from .obstacles.polygon import Polygon
from .obstacles.walls import WallField
from .rendezvous_v0 import parallel_env
from .rewards.custom_terms import RewardStep, reward_term
from .rewards.terms import RewardWeights
from .robots.activation import Activation
from .robots.events import Events
from .robots.motion import FREE, SLID, STOPPED, Motion
from .robots.motion import describe as describe_motion
from .robots.robot_models import RobotModel, register_robot_model
from .safe_names import install as _install_safe_names
from .safety.heading import certified_heading
from .safety.safety_filter import SafetyFilter, register_filter
from .safety.theorems.certificate import Certificate, certificate
from .scenario import scenarios
from .scenario.observation_layout import ObservationLayout
from .scenario.scenario import Scenario, TimeStepWarning
from .sensors.custom_sensors import ObservationBatch, sensor_imperfection
from .sensors.sensing import Sensing
from .simulator import Simulator
from .trajectory import Trajectory, rollout

__version__ = "0.2.0"
__all__ = [
    "FREE", "SLID", "STOPPED", "Activation", "Capsule", "Certificate", "Disc",
    "EnergyTankWrapper", "Events", "GainWrapper", "GuaranteeWrapper", "HeadingVectorWrapper",
    "LinkKeepingWrapper", "Motion", "Moving", "ObservationBatch", "ObservationLayout",
    "ObstacleField", "Polygon", "RewardStep", "RewardWeights", "RobotModel", "SafetyFilter",
    "Scenario", "Sensing", "Simulator", "Sphere", "TimeStepWarning", "Trajectory", "WallField",
    "certificate", "certified_heading", "describe_motion", "graphs", "kernel", "make_vec",
    "parallel_env", "register_filter", "register_robot_model", "rendezvous_v0", "reward_term",
    "rollout", "scenarios", "sensor_imperfection", "training_env", "vector",
]  # fmt: skip


def __getattr__(name: str) -> _Any:
    """Former names."""
    if name == "Seen":
        _warn_renamed("rv.Seen", "rv.ObservationBatch")
        return ObservationBatch
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Public names; submodules are importable but not listed."""
    return [*__all__, "__all__", "__doc__", "__file__", "__name__", "__path__", "__version__"]


def _shipped_preset() -> _Any:
    """Load the learning preset from the package ``baselines``, which has the shipped policies."""
    return _import_module("rendezvous_env.baselines.learned.training_environment").ShippedPreset()


_install_safe_names()
_register_preset(_shipped_preset)
rendezvous_v0.register()
register()
