#!/usr/bin/env bash
# ir-sim's lidar2d over a full circle has its first and last beam in one direction, and a wider spacing.
#
# Versions: ir-sim 2.12.0, numpy 2.4.6, shapely 2.2.0, matplotlib 3.11.2, scipy 1.17.1, Python 3.11.
# Input: lidar2d with angle_range 2 pi and number 8; equal discs 3 m ahead and 3 m behind the robot.
# Guess: eight directions 45 degrees apart, so each disc is hit by one beam, at 2.5 m.
# Seen: beams from -180 to +180 degrees, both included, 51.4 degrees apart: seven directions. The disc
#   behind is hit twice and the one ahead never, since no beam points ahead. So bearings computed as
#   multiples of 45 degrees are wrong, and an average over hits counts the rear twice.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ir-sim==2.12.0 numpy==2.4.6 shapely==2.2.0 matplotlib==3.11.2 scipy==1.17.1
cat > "$folder/world.yaml" <<'YAML'
world: {height: 20, width: 20}
robot:
  - kinematics: {name: diff}
    shape: {name: circle, radius: 0.2}
    state: [10, 10, 0]
    sensors: [{name: lidar2d, range_min: 0, range_max: 5, angle_range: 6.283185307179586, number: 8}]
obstacle:
  - {shape: {name: circle, radius: 0.5}, state: [13, 10, 0]}
  - {shape: {name: circle, radius: 0.5}, state: [7, 10, 0]}
YAML
cd "$folder"
MPLBACKEND=agg venv/bin/python - <<'PYTHON'
import irsim
import numpy as np

env = irsim.make("world.yaml", display=False)
env.step()
lidar = env.robot_list[0].sensors[0]
scan = lidar.get_scan()
angles = np.degrees(lidar.angle_list)
reported = np.degrees(scan["angle_min"] + scan["angle_increment"] * np.arange(8))
directions = np.unique(np.round(angles % 360, 6))
print("beams (degrees):", angles.round(1).tolist())
print("ranges (m):", scan["ranges"].round(3).tolist(), "· distinct directions:", len(directions))
assert np.allclose(angles, reported)
assert len(directions) == 7 and np.isclose(np.diff(angles), 360 / 7).all(), "the beams have another spacing now"
assert np.allclose(scan["ranges"], [2.5, 5, 5, 5, 5, 5, 5, 2.5]), "the discs are hit by other beams now"
PYTHON
