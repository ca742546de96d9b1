"""Which way robots face, for pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def facing(headings: NDArray[np.float64], dim: int) -> NDArray[np.float64]:
    """Unit vectors along the bodies of robots.

    Args:
        headings: (..., k), rad: yaw, or yaw and pitch.
        dim: d, 2 or 3.

    Returns:
        (..., d).
    """
    yaw, pitch = headings[..., 0], headings[..., 1:].sum(axis=-1)
    flat = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch)], axis=-1)
    return flat if dim == 2 else np.concatenate([flat, np.sin(pitch)[..., None]], axis=-1)
