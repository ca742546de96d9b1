"""What a bearing that is wrong by an angle η can do to a net bearing (guarantees, section 11)."""

from __future__ import annotations

import math
from typing import Any

from ..experiment.checks import number


def check_bearing_error(bearing_error: Any) -> float:
    """η, rad, from 0 to π/2.

    Args:
        bearing_error: what was given.

    Raises:
        ValueError: saying what was given.
    """
    return number("bearing_error", bearing_error, 0.0, math.pi / 2.0, "rad")


def error_chord(bearing_error: float) -> float:
    """2 sin(η/2): a net bearing is wrong by no more than e_i = 2 sin(η/2) D_i (theorem N1).

    Args:
        bearing_error: η, rad.

    Returns:
        e_i/D_i, a number without unit.
    """
    return 2.0 * math.sin(0.5 * bearing_error)
