#!/usr/bin/env bash
# GTSAM gives a point at a robot's own place the bearing 0 in the plane, and a nan residual in space.
#
# Versions: gtsam 4.3.0, numpy 1.26.4, Python 3.11.
# Input: Pose2 and Pose3 at the place of a point (two robots that have met), with bearing factors.
# Guess: both raise or return nan, since this direction does not exist.
# Seen: Pose2.bearing returns Rot2 of angle 0 in any heading; BearingFactor2D reports a finite error
#   against it, with zero derivatives. Pose3.bearing returns a Unit3 of length 0, and BearingFactor3D
#   a residual of nan. So where two robots have met, a graph in the plane carries a constant false
#   residual that no step reduces, and the cost of the same graph in space is nan.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet gtsam==4.3.0 numpy==1.26.4
"$folder/venv/bin/python" - <<'PYTHON'
import gtsam
import numpy as np

flat, space = gtsam.Values(), gtsam.Values()
pose = gtsam.Pose2(1.0, 2.0, 0.5)
flat.insert(1, pose)
flat.insert(2, np.array([1.0, 2.0]))
space.insert(1, gtsam.Pose3())
space.insert(2, np.zeros(3))
planar = gtsam.BearingFactor2D(1, 2, gtsam.Rot2(0.3), gtsam.noiseModel.Isotropic.Sigma(1, 1.0))
spatial = gtsam.BearingFactor3D(
    1, 2, gtsam.Unit3(np.array([1.0, 0.0, 0.0])), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
)
angle = pose.bearing(np.array([1.0, 2.0])).theta()
residual = planar.unwhitenedError(flat)
derivatives, _ = planar.linearize(flat).jacobian()
direction = gtsam.Pose3().bearing(np.zeros(3)).point3()
in_space, cost = spatial.unwhitenedError(space), spatial.error(space)
print("plane: bearing", angle, "residual", residual, "derivatives", derivatives.ravel())
print("space: bearing", direction, "residual", in_space, "cost", cost)
assert angle == 0.0 and np.allclose(residual, -0.3), "the planar bearing is another now"
assert not derivatives.any(), "the planar derivatives are not zero now"
assert not direction.any() and np.isnan([*in_space, cost]).all(), "the spatial bearing is another now"
PYTHON
