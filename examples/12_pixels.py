"""Robots with camera images: a film, and the errors of the detector.

MuJoCo renders four images of 64 × 64 pixels per robot. Coloured blobs are robots, dark columns
are obstacles. Needs the extra mujoco: pip install '.[mujoco]'
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from train.pixels import pixels

EVERY, PAUSE = 3, 1500  # steps per frame of the film; pause at its end, ms
STRIP = 81  # pixels: height of an image strip with its label
QUARTERS = (1, 0, 3, 2)  # cameras from left to right


class Looks:
    """Compare detected bearings with true positions."""

    def __init__(self):
        self.errors, self.hidden = [], []  # rad, NaN for no detection

    def __call__(self, simulator, eyes, pictures, seen):
        """Process one step."""
        places, alive = simulator.positions[0], np.flatnonzero(simulator.active[0])
        for robot in alive:
            found = dict(zip(seen[robot].colours, seen[robot].bearings, strict=True))
            for other in alive[alive != robot]:
                x, y = places[other] - places[robot]
                wrong = found.get(other, np.nan) - (np.arctan2(y, x) - eyes.yaw(robot))
                self.errors.append(abs((wrong + np.pi) % (2 * np.pi) - np.pi))
                between = [k for k in alive if k not in (robot, other)]
                self.hidden.append(hidden(simulator, robot, other, between))

    def summary(self):
        """Quantiles of the error, degrees, and fractions of missed detections."""
        errors, hidden = np.degrees(self.errors), np.array(self.hidden)
        missed, found = np.isnan(errors), errors[~np.isnan(errors)]
        return {
            "looks": len(errors),
            "median": np.median(found),
            "p99": np.quantile(found, 0.99),
            "worst": found.max(),
            "rms": np.sqrt((found**2).mean()),
            "missed": missed.mean(),
            "missed_in_sight": missed[~hidden].mean(),
            "found_though_hidden": (~missed[hidden]).mean(),
        }


def hidden(simulator, robot, other, between):
    """Whether a disc or another lamp blocks the line of sight to a robot."""
    places, discs = simulator.positions[0], simulator.obstacles[0]
    way = places[other] - places[robot]
    length = np.linalg.norm(way)
    centres = np.concatenate([discs[:, 3:5], places[between]]) - places[robot]
    radii = np.append(discs[:, 2], [simulator.scenario.merge_radius / 2] * len(between))
    along = np.clip(centres @ way / length, 0, length)
    apart = np.linalg.norm(centres - along[:, None] * way / length, axis=1)
    return ((apart < radii) & (along < length)).any()


class Film:
    """Film: top view and camera images; black marks are bearings, red ones obstacle edges."""

    def __init__(self):
        self.pictures, self.steps = [], 0

    def __call__(self, simulator, eyes, pictures, seen):
        """Process one step."""
        if self.steps % EVERY == 0:
            side = np.concatenate([strip(*one) for one in zip(pictures, seen, strict=True)])
            above = eyes.from_above()
            margin = np.full((len(side) - len(above), above.shape[1], 3), 255, np.uint8)
            self.pictures.append(np.hstack([np.concatenate([above, margin]), side]))
        self.steps += 1

    def write(self, path, step):
        """Write a GIF in real time, for a step length in s."""
        labelled = [label(Image.fromarray(picture)) for picture in self.pictures]
        first, *others = [picture.quantize(48) for picture in labelled]
        lasts = [round(1000 * EVERY * step)] * len(others) + [PAUSE]
        first.save(path, save_all=True, append_images=others, duration=lasts, loop=0)


def label(picture):
    """Name the robot of each image strip, and explain the marks."""
    draw = ImageDraw.Draw(picture)
    for k in range(picture.height // STRIP):
        place = picture.width - 4 * 64 + 3, STRIP * (k + 1) - 15
        draw.text(place, f"robot {k}: bearings black, obstacle edges red", fill=(0, 0, 0))
    return picture


def strip(pictures, found):
    """Camera images of one robot side by side, with marks."""
    out = np.concatenate([pictures[k] for k in QUARTERS], axis=1)
    if found is not None:
        out[:8, [column(angle) for angle in found.bearings]] = 0
        out[-8:, [column(angle) for angle in found.edges.ravel()]] = (200, 0, 0)
    return np.concatenate([out, np.full((STRIP - len(out), out.shape[1], 3), 255, np.uint8)])


def column(angle):
    """Column of a direction in an image strip."""
    k = round(angle / (np.pi / 2))
    across = 32 * (1 - np.tan(angle - k * np.pi / 2))
    return 64 * QUARTERS.index(k % 4) + int(np.clip(across, 0, 63))


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--policy", default="learned")
parser.add_argument("--episodes", type=int, default=10)
parser.add_argument("--seed", type=int, default=3)
parser.add_argument("--film", type=Path, default=None, help="a GIF of the first episode")
given = parser.parse_args()

looks = Looks()
seeds = range(given.seed, given.seed + given.episodes)
found = list(pixels.play(given.policy, seeds, looks))
print(f"{sum(one.collision_free for one in found)} of {len(found)} episodes met without a contact")
for name, value in looks.summary().items():
    print(f"{name}: {value:.3g}")
if given.film is not None:
    film = Film()
    list(pixels.play(given.policy, seeds[:1], film))
    film.write(given.film, pixels.SCENARIO.tau)
