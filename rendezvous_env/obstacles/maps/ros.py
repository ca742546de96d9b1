"""Maps of the ROS packages map_server and nav2_map_server: a YAML file beside an image.

An image has the value v of a pixel, 0 to 255, averaged over its colours. With ``negate`` 0 the
occupancy is p = (255 − v)/255, else v/255. The modes are those of the packages:

    trinary   occupied if p > occupied_thresh, free if p < free_thresh, else unknown
    scale     as trinary, and linear from 0 to 100 between both; transparent pixels are unknown
    raw       v itself from 0 to 100; larger values are unknown

``origin`` is the pose (x, y, yaw) of the lower left corner, m and rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...checks import choice, is_sequence, load, number, positive, raise_invalid, short_repr
from .grid import MAX_CELLS, Area, Pose, area_of

MODES = ("trinary", "scale", "raw")
UNKNOWN = -1.0
"""Occupancy of unknown cells; others have 0 to 100."""
_KEYS = ("image", "resolution", "origin")


class Thresholds(NamedTuple):
    """Occupancies p, 0 to 1, above which a cell is occupied, and below which it is free."""

    occupied: float
    free: float


def read(path: Path, unknown: str, min_occupancy: float) -> Area:
    """Obstacles of a map: unknown cells if ``unknown`` is "occupied", and occupied ones.

    Args:
        path: the YAML file.
        unknown: "occupied" or "free".
        min_occupancy: occupancy, 0 to 100, from which a cell is an obstacle.
    """
    settings = _settings(path)

    def named(key: str) -> str:
        return f"{path}: {key}"

    resolution = positive(named("resolution"), settings["resolution"], "m")
    pose = Pose(resolution, *_origin(named("origin"), settings["origin"]))
    mode = choice(named("mode"), settings.get("mode", "trinary"), MODES)
    negate = settings.get("negate", 0)
    if negate not in (0, 1):
        raise_invalid(named("negate"), negate, "0 or 1")
    image = settings["image"]
    if not isinstance(image, str):
        raise_invalid(named("image"), image, "the path of an image, relative to this file")
    values, opaque = _pixels(path, path.parent / image)
    limits = Thresholds(1.0, 0.0) if mode == "raw" else _thresholds(named, settings)
    occupancy = occupancy_of(values, opaque, mode, bool(negate), limits)
    is_obstacle = occupancy >= min_occupancy
    if unknown == "occupied":
        is_obstacle |= occupancy == UNKNOWN
    return area_of(is_obstacle[::-1], pose)


def occupancy_of(
    values: NDArray[np.float64],
    opaque: NDArray[np.bool_],
    mode: str,
    negate: bool,
    limits: Thresholds,
) -> NDArray[np.float64]:
    """Occupancy of pixels, 0 to 100 or UNKNOWN, from their values, 0 to 255."""
    if mode == "raw":
        whole = np.round(values)
        return np.where(whole <= 100.0, whole, UNKNOWN)
    p = (values if negate else 255.0 - values) / 255.0
    between = np.full(p.shape, UNKNOWN)
    if mode == "scale":
        span = max(limits.occupied - limits.free, 1e-12)
        between = np.where(opaque, np.rint(100.0 * (p - limits.free) / span), UNKNOWN)
    found = np.where(p > limits.occupied, 100.0, np.where(p < limits.free, 0.0, between))
    return np.where(opaque | (mode == "trinary"), found, UNKNOWN)


def _settings(path: Path) -> Mapping[str, Any]:
    yaml = load("yaml", "a ROS map", "maps")
    try:
        settings = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a YAML file: {short_repr(str(error))[1:-1]}") from error
    if not isinstance(settings, Mapping):
        raise ValueError(f"{path}: is {short_repr(settings)}; it must be a table of settings")
    if missing := [key for key in _KEYS if key not in settings]:
        raise ValueError(f"{path}: {missing[0]} is missing; a ROS map needs {', '.join(_KEYS)}")
    return settings


def _origin(field: str, value: Any) -> tuple[float, ...]:
    pose = tuple(value) if is_sequence(value) else ()
    if len(pose) != 3:
        raise_invalid(field, value, "three numbers: x and y in m, and the yaw in rad")
    return tuple(number(f"{field}[{k}]", one) for k, one in enumerate(pose))


def _thresholds(named: Any, settings: Mapping[str, Any]) -> Thresholds:
    occupied, free = (
        number(named(key), settings.get(key, default), 0.0, 1.0)
        for key, default in (("occupied_thresh", 0.65), ("free_thresh", 0.196))
    )
    if free > occupied:
        raise_invalid(named("free_thresh"), free, f"at most occupied_thresh, {occupied:g}")
    return Thresholds(occupied, free)


def _pixels(path: Path, image: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Values (rows, columns) of an image, 0 to 255, the top row first, and opaque pixels."""
    pil = load("PIL.Image", "the image of a map", "maps")
    try:
        with pil.open(image) as file:
            if file.width * file.height > MAX_CELLS:
                size = f"{file.width} x {file.height} pixels"
                raise ValueError(f"{image}: has {size}; the maximum is {MAX_CELLS}; crop it")
            return _grey(file)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: image is {str(image)!r}; it does not exist") from error
    except (OSError, SyntaxError, pil.DecompressionBombError) as error:
        raise ValueError(f"{image}: not an image: {short_repr(str(error))[1:-1]}") from error


def _grey(file: Any) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    if file.mode.startswith("I"):  # 16 bits
        values = np.asarray(file.convert("I"), dtype=np.float64) / 257.0
        return values, np.ones(values.shape, np.bool_)
    pixels = np.asarray(file.convert("RGBA"), dtype=np.float64)
    return pixels[..., :3].mean(axis=-1), pixels[..., 3] == 255.0
