"""How figures look on paper: widths of a column and a page, sizes of letters, fonts that journals
take; and how they are written.

The drawing library is imported when a figure is made.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.render.palette import OBSTACLE, OBSTACLE_EDGE, ROBOTS

from ..results import atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN, PAGE = 3.5, 7.16
"""Widths of a column and of a page of two columns, inch: those of IEEE journals."""
SMALL = 7
"""Size of the smallest letters, points."""
_DPI = 200
_COLOURS = 128
"""Of a PNG file, which is then a quarter as large; figures have few and shades between them."""
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
}

P = ParamSpec("P")
R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """A function that draws or writes a figure, in this style."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        from matplotlib import rc_context

        with rc_context(_STYLE):  # type: ignore[arg-type]  # names of settings as plain strings
            return draw(*args, **kwargs)

    return drawn


def new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches that no window system has to show."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


@styled
def save(figure: Figure, path: Path, run: str = "") -> None:
    """Write a figure as PNG or PDF, by the name's ending, whole or not at all.

    Args:
        figure: to write.
        path: of the file.
        run: id of the run that it shows; it goes into the file as its subject.
    """
    about = {"Subject": f"rendezvous compare, run {run}"} if run else {}
    ending = path.suffix.lower().removeprefix(".")
    with atomic(path) as temporary:
        if ending == "png":
            _save_png(figure, temporary, about)
        else:
            figure.savefig(temporary, format=ending, metadata=about or None)


def _save_png(figure: Figure, path: Path, about: dict[str, str]) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
    palette, indices = _reduced(pixels)
    few = Image.fromarray(indices, mode="P")
    few.putpalette(palette.flatten().tolist())
    texts = PngInfo()
    for name, text in about.items():
        texts.add_text(name, text)
    few.save(path, format="PNG", optimize=True, pnginfo=texts, dpi=(_DPI, _DPI))


def _reduced(pixels: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A palette (k, 3) and each pixel's place in it: the colours of robots and obstacles, and those
    of most pixels. So a colour of few pixels is not mixed with another one, and white stays white.
    """
    packed = pixels.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32)
    found, inverse, counts = np.unique(packed, return_inverse=True, return_counts=True)
    colours = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=-1).astype(np.int32)
    known = np.array([*ROBOTS, OBSTACLE, OBSTACLE_EDGE], dtype=np.int32)
    most = np.argsort(-counts, kind="stable")[: _COLOURS - len(known)]
    palette = np.concatenate([known, colours[most]])
    far = np.abs(colours[:, None] - palette).sum(axis=-1)
    nearest = far.argmin(axis=1).astype(np.uint8)
    return palette.astype(np.uint8), nearest[inverse].reshape(packed.shape)
