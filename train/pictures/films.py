"""Moving pictures as files: GIF by Pillow, MP4 by the ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.drawing.palette import OBSTACLE, OBSTACLE_EDGE, ROBOTS, mixed

from ..errors import UserError

Frames = Iterable[NDArray[np.uint8]]
ENDINGS = (".gif", ".mp4")
_SHARES = (0.0, 0.15, 0.3, 0.5, 0.65, 0.8)
"""Of white in a colour: paths are lighter than robots, and edges are smooth."""


def rate(path: Path, fps: int) -> float:
    """Pictures a second that a file can have: a GIF counts in hundredths of a second, from two."""
    return 100 / max(2, round(100 / fps)) if _ending(path) == ".gif" else float(fps)


def check(path: Path) -> None:
    """Refuse a film for which a library is missing, before any work is spent on it.

    Raises:
        UserError: saying what to install.
    """
    _library("PIL.Image" if _ending(path) == ".gif" else "imageio_ffmpeg")
    _library("pygame")


def write(path: Path, ending: str, frames: Frames, fps: float) -> None:
    """Write a film.

    Args:
        path: of the file.
        ending: one of ENDINGS, what kind of film.
        frames: (height, width, 3) each, of equal and even size.
        fps: as ``rate`` gives it.
    """
    {".gif": _write_gif, ".mp4": _write_mp4}[ending](path, frames, fps)


def _ending(path: Path) -> str:
    return path.suffix.lower()


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise UserError(
            f"{name.partition('.')[0]} is not installed; pip install rendezvous-env[render]"
        ) from error


def _write_gif(path: Path, frames: Frames, fps: float) -> None:
    image = _library("PIL.Image")
    palette = image.new("P", (1, 1))
    palette.putpalette(_palette())

    def reduced() -> Iterator[Any]:
        for frame in frames:
            picture = image.fromarray(frame)
            yield picture.quantize(palette=palette, dither=image.Dither.NONE)

    pictures = reduced()
    first = next(pictures)
    duration = round(1000 / fps)
    first.save(path, format="GIF", save_all=True, append_images=pictures, duration=duration, loop=0)


def _palette() -> list[int]:
    """Red, green, blue, red, …: the colours of the pictures and what they fade into."""
    white, black = (255, 255, 255), (0, 0, 0)
    greys = [mixed(black, white, step / 15) for step in range(16)]
    dark = [mixed(robot, black, 0.5) for robot in ROBOTS]
    colours = (*ROBOTS, OBSTACLE, OBSTACLE_EDGE)
    faded = [mixed(colour, white, share) for colour in colours for share in _SHARES]
    edges = [
        mixed(OBSTACLE, other, share) for other in (OBSTACLE_EDGE, *ROBOTS) for share in (0.3, 0.6)
    ]
    return list(chain.from_iterable([*greys, *dark, *faded, *edges]))


def _write_mp4(path: Path, frames: Frames, fps: float) -> None:
    pictures = iter(frames)
    first = next(pictures)
    height, width = first.shape[:2]
    writer = _library("imageio_ffmpeg").write_frames(
        str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2
    )
    writer.send(None)
    try:
        for frame in chain([first], pictures):
            writer.send(frame.tobytes())
    finally:
        writer.close()
