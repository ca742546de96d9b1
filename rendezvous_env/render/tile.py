"""Where in a picture each of several teams is drawn."""

from __future__ import annotations

import math


def columns_of(count: int) -> int:
    """Teams in a row of a picture of so many."""
    return math.ceil(math.sqrt(count))


def cell(team: int, count: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a team's part of a picture, pixels.

    Args:
        team: which.
        count: how many teams the picture has.
        width: of the whole picture, pixels.
        height: likewise.
    """
    columns = columns_of(count)
    rows = math.ceil(count / columns)
    row, column = divmod(team, columns)
    return (
        column * width // columns,
        row * height // rows,
        (column + 1) * width // columns,
        (row + 1) * height // rows,
    )
