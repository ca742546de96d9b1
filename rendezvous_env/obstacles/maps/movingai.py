"""Maps of the MovingAI benchmarks: a header, then a line of characters for each row.

    type octile
    height 3
    width 4
    map
    @@..
    .T..
    ....

"." and "G" are ground, "S" is swamp; "@" and "O" are out of bounds, "T" is trees, "W" is water.
"""

from pathlib import Path

import numpy as np

from ...checks import counted, raise_invalid, short_repr
from .grid import MAX_CELLS, Area, Pose, area_of

TERRAIN = ".GS@OTW"
"""Characters of a map."""


def read(path: Path, cell_size: float, passable: str) -> Area:
    """Obstacles of a map: all cells except ``passable`` ones, centred at the origin.

    Args:
        path: the .map file.
        cell_size: edge of a cell, m.
        passable: characters of cells that are no obstacles.
    """
    if unknown := [mark for mark in passable if mark not in TERRAIN]:
        raise_invalid("passable", unknown[0], f"characters of {TERRAIN!r}")
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a MovingAI map: {error.reason}; it is ASCII text") from error
    height, width = _header(path, lines)
    rows = lines[4 : 4 + height]
    if len(rows) < height:
        raise ValueError(f"{path}: has {counted(len(rows), 'row')} of cells; height says {height}")
    for k, row in enumerate(rows):
        place = f"{path}, line {5 + k}"
        if len(row) != width:
            raise ValueError(f"{place}: has {counted(len(row), 'cell')}; width says {width}")
        if strange := [mark for mark in row if mark not in TERRAIN]:
            raise ValueError(f"{place}: {strange[0]!r} is no terrain; known are {TERRAIN!r}")
    cells = np.array([list(row) for row in rows])
    occupied = ~np.isin(cells, list(passable))
    pose = Pose(cell_size, -0.5 * width * cell_size, -0.5 * height * cell_size)
    return area_of(occupied[::-1], pose)


def _header(path: Path, lines: list[str]) -> tuple[int, int]:
    sizes = {}
    wanted = ("type octile", "height N", "width N", "map")
    for k, what in enumerate(wanted):
        words = lines[k].split() if k < len(lines) else []
        key = what.split()[0]
        fits = len(words) == len(what.split()) and words[0] == key
        if key in ("height", "width"):
            fits = fits and words[1].isdecimal() and 0 < int(words[1]) <= MAX_CELLS
            sizes[key] = int(words[1]) if fits else 0
        if not fits:
            found = short_repr(" ".join(words))
            raise ValueError(f"{path}, line {k + 1}: is {found}; it must be {what!r}")
    if sizes["height"] * sizes["width"] > MAX_CELLS:
        size = f"{sizes['width']} x {sizes['height']} cells"
        raise ValueError(f"{path}: has {size}; the maximum is {MAX_CELLS}; crop it")
    return sizes["height"], sizes["width"]
