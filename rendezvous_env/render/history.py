"""History of an episode for rendering; recorded only if pictures are drawn."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .scene import Bools, Floats


class Moment(NamedTuple):
    """State of one environment after a step."""

    steps: int
    time: float  # s
    positions: Floats  # (n, d), m; a merged robot has its survivor's position
    headings: Floats  # (n, k), rad: none, yaw, or yaw and pitch
    merged_into: NDArray[np.int64]  # (n,)
    contact: Bools  # (n,), in the step
    lyapunov: float  # V, m²/s
    obstacles: Floats  # (M, width), a table of ``obstacles.obstacle_set``, where they are
    failed: Bools  # (n,), robots that have crashed, are adversarial or observe nothing

    @property
    def active(self) -> Bools:
        """True if each robot is active (not merged), (n,)."""
        return self.merged_into == np.arange(len(self.merged_into))


class History(NamedTuple):
    """Episode of one environment since the renderer's first observation."""

    obstacles: Floats  # (M, width), a table of ``obstacles.obstacle_set``, at the first moment
    initial_lyapunov: float  # V at the start of the episode, m²/s
    moments: list[Moment]
