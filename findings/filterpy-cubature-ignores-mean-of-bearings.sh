#!/usr/bin/env bash
# FilterPy's CubatureKalmanFilter accepts z_mean_fn and never calls it, so bearings average linearly.
#
# Versions: filterpy 2.0.0, numpy 2.4.6, scipy 1.17.1, Python 3.11.
# Input: target 10 m away, standard deviation 1 m along both axes, one bearing of sigma 0.06 degrees,
#   2 degrees ahead; z_mean_fn is the circular mean, residual_z wraps; at 0 and at 179 degrees.
# Guess: z_mean_fn gives the predicted bearing, as in UnscentedKalmanFilter with the same functions.
# Seen: at 0 degrees both filters turn by +2. At 179 the unscented one turns by +2, the cubature one
#   by -2.8, away from the measurement; z_mean_fn is called 0 times. The sums that follow the mean
#   do not use residual_z either. So bearing-only tracks behind a robot diverge without an error.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from filterpy.kalman import CubatureKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

calls = 0


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def circular_mean(bearings, weights=None):
    global calls
    calls += 1
    weights = np.full(len(bearings), 1 / len(bearings)) if weights is None else weights
    return np.array([np.arctan2(weights @ np.sin(bearings[:, 0]), weights @ np.cos(bearings[:, 0]))])


def turned(kind, degrees):
    """Change of the estimated bearing (degrees) by a measurement 2 degrees ahead, and calls of the mean."""
    global calls
    calls = 0
    points = {"points": MerweScaledSigmaPoints(2, 0.5, 2, 1)} if kind is UnscentedKalmanFilter else {}
    tracker = kind(
        dim_x=2, dim_z=1, dt=1.0, hx=lambda x: np.array([np.arctan2(x[1], x[0])]), fx=lambda x, dt: x,
        z_mean_fn=circular_mean, residual_z=lambda a, b: wrapped(a - b), **points,
    )
    angle = np.radians(degrees)
    tracker.x = 10 * np.array([np.cos(angle), np.sin(angle)])
    tracker.P, tracker.Q, tracker.R = np.eye(2), np.zeros((2, 2)), np.array([[1e-6]])
    tracker.predict()
    tracker.update(np.array([wrapped(angle + np.radians(2))]))
    x, y = np.ravel(tracker.x)
    return np.degrees(wrapped(np.arctan2(y, x) - angle)), calls


for kind in (UnscentedKalmanFilter, CubatureKalmanFilter):
    for degrees in (0, 179):
        change, called = turned(kind, degrees)
        print(f"{kind.__name__} at {degrees}: turned by {change:+.2f} degrees, mean called {called} times")
        assert (called == 0) == (kind is CubatureKalmanFilter), "the cubature filter calls z_mean_fn now"
        if kind is CubatureKalmanFilter and degrees == 179:
            assert change < -2, "the cubature filter turns towards the measurement now"
        else:
            assert abs(change - 2) < 0.05
PYTHON
