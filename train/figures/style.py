"""Style and output of figures; Matplotlib is imported late."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from ..results import atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN, PAGE = 3.5, 7.16
"""Widths of one and two columns of IEEE journals, inch."""
SMALL = 7
"""Smallest font size, points."""
_DPI = 200
_STYLE = {
    "pdf.fonttype": 42,  # TrueType; IEEE rejects Type 3
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
    """Decorator that applies this style, independent of a matplotlibrc."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        from matplotlib.style import context

        with context(["default", _STYLE]):
            return draw(*args, **kwargs)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """New figure of a size in inches, without a window system."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


@styled
def save(figure: Figure, path: Path, run: str = "") -> None:
    """Write a figure as PNG or PDF atomically, with the run id as the file's subject."""
    about = {"Subject": f"rendezvous compare, run {run}"} if run else None
    with atomic(path) as temporary:
        ending = path.suffix.lower().removeprefix(".")
        figure.savefig(temporary, format=ending, metadata=about, dpi=_DPI)
