"""Sensors drawn at random, so that a policy learns to trust no single one of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rendezvous_env.sensors.sensing import Sensing

Range = tuple[float, float]


@dataclass(frozen=True)
class SensingRanges:
    """Domain randomisation over ``Sensing``: the distribution of a group's sensor.

    A field that has a range departs from the sensor given with ``chance``, each on its own, and is
    then uniform in its range. None, and no words for ``occlusion``, leave a field as it is.

    Raises:
        ValueError: naming the field, its value and what would be right.
    """

    noise: Range | None = None
    """rad."""
    bias: Range | None = None
    """rad."""
    dropout: Range | None = None
    range: Range | None = None
    """m."""
    field_of_view: Range | None = None
    """rad."""
    occlusion: tuple[str, ...] = ()
    """Words of ``Sensing.occlusion``, all as likely."""
    delay: tuple[int, int] | None = None
    """Steps, both ends included."""
    chance: float = 0.5

    def __post_init__(self) -> None:
        for name, given in self._given().items():
            for value in given:
                Sensing(**{name: value})
            if name != "occlusion" and not given[0] <= given[1]:
                low, high = given
                raise ValueError(f"sensing.{name} is from {low} to {high}; it must be LOW ≤ HIGH")
        if not 0.0 <= self.chance <= 1.0:
            raise ValueError(f"chance is {self.chance}; it must be in [0, 1]")

    def _given(self) -> dict[str, Any]:
        """The fields that have a range, by name."""
        return {name: given for name, given in asdict(self).items() if given and name != "chance"}

    def __bool__(self) -> bool:
        return bool(self._given())

    def draw(self, sensing: Sensing, *key: int) -> Sensing:
        """The sensor that belongs to a key of whole numbers from 0 on; other fields stay."""
        random, drawn = np.random.default_rng(key), {}
        for name, given in self._given().items():
            departs, share = random.random(2)
            if departs >= self.chance:
                continue
            if name == "occlusion":
                drawn[name] = given[int(share * len(given))]
            elif name == "delay":
                drawn[name] = given[0] + int(share * (given[1] - given[0] + 1))
            else:
                drawn[name] = given[0] + share * (given[1] - given[0])
        return replace(sensing, **drawn)
