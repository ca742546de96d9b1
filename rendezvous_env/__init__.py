"""Bearing-only multi-robot rendezvous: the environment.

Robots see in which direction their neighbours and the edges of obstacles lie, never how far, and
must all meet.
"""

from . import rendezvous_v0, vector
from .compilation import kernel
from .equations.robots.motion import FREE, SLID, STOPPED, Motion
from .equations.robots.motion import describe as describe_motion
from .experiment import graphs, scenarios
from .experiment.observation_layout import ObservationLayout
from .experiment.obstacles import Capsule, Disc, ObstacleField, Polygon, Sphere
from .experiment.rewards import RewardWeights
from .experiment.robot_models import RobotModel, register_robot_model
from .experiment.scenario import Scenario, TimeStepWarning
from .experiment.sensing import Sensing
from .experiment.walls import WallField
from .faces.gain_wrapper import GainWrapper
from .faces.link_keeping_wrapper import LinkKeepingWrapper
from .faces.tank_wrapper import EnergyTankWrapper
from .faces.training.by_name import training_env
from .first_use import announce
from .guarantee.certificate import Certificate, certificate
from .guarantee.heading import certified_heading
from .gymnasium_env import make_vec
from .registration import register
from .rendezvous_v0 import parallel_env
from .simulator import Simulator
from .trajectory import Trajectory, rollout
from .wrappers import HeadingVectorWrapper

__version__ = "0.1.0"
__all__ = [
    "FREE",
    "SLID",
    "STOPPED",
    "Capsule",
    "Certificate",
    "Disc",
    "EnergyTankWrapper",
    "GainWrapper",
    "HeadingVectorWrapper",
    "LinkKeepingWrapper",
    "Motion",
    "ObservationLayout",
    "ObstacleField",
    "Polygon",
    "RewardWeights",
    "RobotModel",
    "Scenario",
    "Sensing",
    "Simulator",
    "Sphere",
    "TimeStepWarning",
    "Trajectory",
    "WallField",
    "certificate",
    "certified_heading",
    "describe_motion",
    "graphs",
    "kernel",
    "make_vec",
    "parallel_env",
    "register_robot_model",
    "rendezvous_v0",
    "rollout",
    "scenarios",
    "training_env",
    "vector",
]

register()
announce()
