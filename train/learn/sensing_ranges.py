"""Domain randomisation over the fields of ``Sensing``."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rendezvous_env.sensors.sensing import Sensing

Ranges = Mapping[str, tuple[Any, ...]]
"""By field of ``Sensing``: its minimum and maximum, or the values that "occlusion" may take."""


def check_ranges(ranges: Ranges, chance: float) -> None:
    """Validate ranges; a ValueError names the field."""
    for name, given in ranges.items():
        for value in given:
            Sensing(**{name: value})
        if name != "occlusion" and not given[0] <= given[1]:
            low, high = given
            raise ValueError(f"sensing.{name} is from {low} to {high}; it must be LOW ≤ HIGH")
    if "delay" in ranges and "delay_time" in ranges:
        raise ValueError("sensing.delay and sensing.delay_time both have a range; omit one of them")
    if not 0.0 <= chance <= 1.0:
        raise ValueError(f"chance is {chance}; it must be in [0, 1]")


def draw(sensing: Sensing, ranges: Ranges, chance: float, key: tuple[int, ...]) -> Sensing:
    """Sensor sampled from a key of non-negative integers.

    Each field with a range is sampled independently with probability ``chance``, uniformly over
    its closed range. Other fields keep their value.
    """
    random, drawn = np.random.default_rng(key), {}
    for name, given in ranges.items():
        departs, share = random.random(2)
        if departs >= chance:
            continue
        if name == "occlusion":
            drawn[name] = given[int(share * len(given))]
        elif name == "delay":
            drawn[name] = given[0] + int(share * (given[1] - given[0] + 1))
        else:
            drawn[name] = given[0] + share * (given[1] - given[0])
    if "delay_time" in drawn:  # instead of the scenario's own
        drawn["delay"] = 0
    elif "delay" in drawn:
        drawn["delay_time"] = 0.0
    return replace(sensing, **drawn)
