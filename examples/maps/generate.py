"""Draws the maps rooms, cave and office of this folder, 512 x 512 cells of 5 cm.

    python examples/maps/generate.py            # into this folder
    python examples/maps/generate.py out/maps

Every map is a ROS map: a YAML file beside a black and white image.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

SIZE, RESOLUTION = 512, 0.05  # cells, m
WALL, DOOR = 4, 28  # cells
YAML = """image: {name}.png
resolution: {resolution}
origin: [{corner}, {corner}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
mode: trinary
"""


def rooms(random):
    """A grid of rooms with a door in every wall, and a pillar in some rooms."""
    occupied, step = outer_walls(), SIZE // 6
    for k in range(1, 6):
        occupied[:, k * step : k * step + WALL] = True
        occupied[k * step : k * step + WALL, :] = True
    for k in range(1, 6):
        for row in range(6):
            start = row * step + WALL + int(random.integers(4, step - DOOR - WALL - 4))
            occupied[start : start + DOOR, k * step : k * step + WALL] = False
            start = row * step + WALL + int(random.integers(4, step - DOOR - WALL - 4))
            occupied[k * step : k * step + WALL, start : start + DOOR] = False
    for row in range(6):
        for column in range(6):
            if random.random() < 0.4:
                y, x = row * step + step // 2, column * step + step // 2
                occupied[y - 5 : y + 5, x - 5 : x + 5] = True
    return occupied


def cave(random):
    """Cellular automaton: a cell is rock where most of its neighbours are."""
    occupied = random.random((SIZE // 4, SIZE // 4)) < 0.44
    for _ in range(6):
        padded = np.pad(occupied, 1, constant_values=True).astype(int)
        around = sum(np.roll(padded, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1))
        occupied = around[1:-1, 1:-1] >= 5
    occupied = np.kron(occupied, np.ones((4, 4), bool))
    for _ in range(3):  # rounds the corners
        padded = np.pad(occupied, 2, constant_values=True).astype(int)
        around = sum(
            np.roll(padded, (dy, dx), (0, 1)) for dy in range(-2, 3) for dx in range(-2, 3)
        )
        occupied = around[2:-2, 2:-2] >= 13
    return occupied | outer_walls()


def office(random):
    """Two corridors that cross, with offices and desks on both sides."""
    occupied, middle, half = outer_walls(), SIZE // 2, 22
    for low, high in ((0, middle - half), (middle + half, SIZE)):
        for left, right in ((0, middle - half), (middle + half, SIZE)):
            for room in split(random, low, high, left, right):
                furnish(random, occupied, *room)
    occupied[middle - half : middle + half, WALL:-WALL] = False
    occupied[WALL:-WALL, middle - half : middle + half] = False
    return occupied


def split(
    random: np.random.Generator, low: int, high: int, left: int, right: int
) -> Iterator[tuple[int, int, int, int]]:
    """Rooms of a block: it is divided until its edges are short."""
    height, width = high - low, right - left
    if max(height, width) < 130:
        yield low, high, left, right
    elif height > width:
        at = low + height // 2 + int(random.integers(-12, 13))
        yield from split(random, low, at, left, right)
        yield from split(random, at, high, left, right)
    else:
        at = left + width // 2 + int(random.integers(-12, 13))
        yield from split(random, low, high, left, at)
        yield from split(random, low, high, at, right)


def furnish(random, occupied, low, high, left, right):
    """Walls of a room with a door in each, and desks."""
    occupied[low:high, left : left + WALL] = True
    occupied[low:high, right - WALL : right] = True
    occupied[low : low + WALL, left:right] = True
    occupied[high - WALL : high, left:right] = True
    y, x = (low + high - DOOR) // 2, (left + right - DOOR) // 2
    for near, far in ((left, left + WALL), (right - WALL, right)):
        if 0 < near and far < SIZE:
            occupied[y : y + DOOR, near:far] = False
    for near, far in ((low, low + WALL), (high - WALL, high)):
        if 0 < near and far < SIZE:
            occupied[near:far, x : x + DOOR] = False
    for _ in range(2):
        y = int(random.integers(low + 20, high - 36))
        x = int(random.integers(left + 20, right - 48))
        occupied[y : y + 14, x : x + 28] = True


def outer_walls():
    """A map that is free within its outer walls."""
    occupied = np.ones((SIZE, SIZE), bool)
    occupied[WALL:-WALL, WALL:-WALL] = False
    return occupied


MAPS = {"rooms": rooms, "cave": cave, "office": office}


def main() -> None:
    """Write the maps."""
    parser = argparse.ArgumentParser(description="Draw the maps rooms, cave and office.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for seed, (name, draw) in enumerate(MAPS.items()):
        occupied = draw(np.random.default_rng(seed))
        Image.fromarray(~occupied).save(folder / f"{name}.png", optimize=True)
        corner = -0.5 * SIZE * RESOLUTION
        text = YAML.format(name=name, resolution=RESOLUTION, corner=corner)
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
