"""Laws: pure functions from observations to velocities, and the corresponding policies."""

from rendezvous_env.safety.heading import flexible_velocity
from rendezvous_env.safety.links import link_keeping_law

from .literature_laws import (
    cyclic_pursuit_law,
    nearest_pursuit_law,
    rounded_bearings,
    smallest_sector_law,
    unit_mean_law,
)
from .paper_laws import (
    LawPolicy,
    bearing_only_law,
    damped_law,
    degree_of,
    nonholonomic_3d_law,
    pitch_of,
    unicycle_cosine_law,
    unicycle_law,
)
from .pursuit import Pursuit, Windshield

__all__ = [
    "LawPolicy", "Pursuit", "Windshield", "bearing_only_law", "cyclic_pursuit_law", "damped_law",
    "degree_of", "flexible_velocity", "link_keeping_law", "nearest_pursuit_law",
    "nonholonomic_3d_law", "pitch_of", "rounded_bearings", "smallest_sector_law",
    "unicycle_cosine_law", "unicycle_law", "unit_mean_law",
]  # fmt: skip
