"""Estimation of sensor models from logs of bearings with ground truth; NumPy and SciPy only."""

from .fit import SensorFit, fit_sensor
from .log import SensorLog, Track
from .tables import LogError, from_tables

__all__ = ["LogError", "SensorFit", "SensorLog", "Track", "fit_sensor", "from_tables"]
