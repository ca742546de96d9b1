"""The style of figures, and writing them; the drawing library is imported late."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from ..results import atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN, PAGE = 3.5, 7.16
"""Widths of a column and of a page of two columns, inch: those of IEEE journals."""
SMALL = 7
"""Size of the smallest letters, points."""
_DPI = 200
_STYLE = {
    "pdf.fonttype": 42,  # TrueType; IEEE refuses Type 3
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "figure.titlesize": 8,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "text.parse_math": False,  # names may have a $
}

P = ParamSpec("P")
R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """A function that draws or writes a figure, in this style, whatever a matplotlibrc says."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        from matplotlib.style import context

        with context(["default", _STYLE]):
            return draw(*args, **kwargs)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """A figure of a size in inches, without a window system."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


@styled
def save(figure: Figure, path: Path, run: str = "") -> None:
    """Write a figure as PNG or PDF, by the name's ending, whole or not at all; the id of its run is
    the file's subject.
    """
    about = {"Subject": f"rendezvous compare, run {run}"} if run else None
    with atomic(path) as temporary:
        ending = path.suffix.lower().removeprefix(".")
        figure.savefig(temporary, format=ending, metadata=about, dpi=_DPI)
