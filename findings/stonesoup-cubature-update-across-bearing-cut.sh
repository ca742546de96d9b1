#!/usr/bin/env bash
# Stone Soup's cubature filter loses its estimate where bearings pass from +180 to -180 degrees.
#
# Versions: stonesoup 1.9.1, numpy 2.4.6, scipy 1.17.1, Python 3.11.
# Input: a target 10 m from the sensor, standard deviation 1 m along both axes; one bearing of
#   sigma 0.06 degrees, 1 degree beside the prediction; target due east (0) or due west (180 degrees).
# Guess: extended, unscented and cubature updates agree at both places, since all use type Bearing.
# Seen: due east all three agree. Due west the cubature update corrects half a degree, and the summed
#   position variance grows from 2 to about 215 square metres; the others give 1. Its mean wraps, but
#   its second moments are sums of products of plain angles. So a good bearing ruins the track there.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-compile stonesoup==1.9.1 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PYTHON'
from datetime import datetime

import numpy as np
from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing
from stonesoup.types.angle import Bearing
from stonesoup.types.array import StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.updater.kalman import CubatureKalmanUpdater, ExtendedKalmanUpdater, UnscentedKalmanUpdater

TIME = datetime(2026, 1, 1)
SENSOR = Cartesian2DToBearing(4, (0, 2), np.array([[1e-6]]))


def update(kind, degrees):
    """Correction of the bearing (degrees) and summed position variance after one update."""
    angle = np.radians(degrees)
    place = StateVector([10 * np.cos(angle), 0, 10 * np.sin(angle), 0])
    prior = GaussianStatePrediction(place, np.diag([1, 0.1, 1, 0.1]), timestamp=TIME)
    bearing = StateVector([Bearing(angle + np.radians(1))])
    detection = Detection(bearing, timestamp=TIME, measurement_model=SENSOR)
    posterior = kind(SENSOR).update(SingleHypothesis(prior, detection))
    x, y = (float(posterior.state_vector[axis, 0]) for axis in (0, 2))
    correction = (np.degrees(np.arctan2(y, x)) - degrees + 180) % 360 - 180
    return correction, float(posterior.covar[0, 0] + posterior.covar[2, 2])


for kind in (ExtendedKalmanUpdater, UnscentedKalmanUpdater, CubatureKalmanUpdater):
    for degrees in (0, 180):
        correction, variance = update(kind, degrees)
        print(f"{kind.__name__} at {degrees}: corrected by {correction:.3f} degrees, variance {variance:.3f}")
        if kind is CubatureKalmanUpdater and degrees == 180:
            assert variance > 100 and abs(correction - 1) > 0.4, "the cubature update wraps now"
        else:
            assert abs(correction - 1) < 0.05 and abs(variance - 1) < 0.01
PYTHON
