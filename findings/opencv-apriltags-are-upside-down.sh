#!/usr/bin/env bash
# AprilTags drawn by OpenCV are upside down for the AprilTag library: headings differ by 180 degrees.
#
# Versions: opencv-python-headless 4.11.0.86, pupil-apriltags 1.0.4.post11, numpy 1.26.4, Python 3.11.
# Input: tag 0 of family 36h11, seen from the front: OpenCV's picture, and the bits of the family's
#   own code word 0xd5d628584 row by row, 1 white.
# Guess: both pictures are equal, so the tag has rotation 0 about the optical axis in either.
# Seen: both have id 0 and no bit errors, but OpenCV's picture is the other turned by 180 degrees.
#   pupil-apriltags gives rotations 0 and 180 degrees; cv2.aruco takes its own picture as upright.
#   So a robot's heading is reversed if one library prints its tag and the other one reads it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==4.11.0.86 pupil-apriltags==1.0.4.post11 numpy==1.26.4
"$folder/venv/bin/python" - <<'PYTHON'
import cv2
import numpy as np
from pupil_apriltags import Detector

family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
word = np.array([0xD5D628584 >> (35 - bit) & 1 for bit in range(36)], np.uint8)
tags = {"family": np.pad(255 * word.reshape(6, 6), 1), "OpenCV": cv2.aruco.generateImageMarker(family, 0, 8)}
detector = Detector(families="tag36h11")
turns = {}
for name, tag in tags.items():
    image = np.pad(np.kron(tag, np.ones((20, 20), np.uint8)), 100, constant_values=255)
    centre = image.shape[0] / 2
    found = detector.detect(image, estimate_tag_pose=True, camera_params=(500, 500, centre, centre), tag_size=0.1)
    corners, ids, _ = cv2.aruco.ArucoDetector(family).detectMarkers(image)
    assert len(found) == 1 and found[0].tag_id == 0 and found[0].hamming == 0 and ids.ravel().tolist() == [0]
    rotation = np.degrees(np.arctan2(found[0].pose_R[1, 0], found[0].pose_R[0, 0])) % 360
    first = "upright" if (corners[0][0, 0] < centre).all() else "upside down"  # first corner: top left of the tag
    turns[name] = (round(rotation) % 360, first)
    print(f"picture of {name}: pupil-apriltags {rotation:.2f} degrees, cv2.aruco {first}")
assert (np.rot90(tags["family"], 2) == tags["OpenCV"]).all(), "the pictures are not turned by 180 degrees now"
assert turns == {"family": (0, "upside down"), "OpenCV": (180, "upright")}, "the libraries read another turn now"
PYTHON
