"""All that a learned policy is, beside its weights, and what is made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.limits import LARGEST
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from .feature_kernels import LEVEL_COLUMNS, WALL_COLUMNS
from .features import VERSION, FeatureLayout
from .plain_data import check_field_types, check_types

ANGLES = np.array([0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0, 1.4, -1.4])
"""Choices where headings are certified, rad counter-clockwise from f; 0 is the rule itself."""
ALL_ROUND = np.array([*ANGLES, 1.9, -1.9, 2.5, -2.5, np.pi])
"""Choices where a tank pays for going away from f, rad."""
CHOICES = len(ANGLES)
_WIDEST = 2**12
_RANGES = {
    "set_width": (1, _WIDEST), "clearance": (0.0, math.pi), "persistence": (0.0, 1e9),
    "min_alignment": (1e-9, 1.0), "max_turn_rate": (1e-9, 1e9), "decision_time": (1e-9, 1e9),
    "budget": (0.0, 1e9), "memory_units": (1, _WIDEST),
}  # fmt: skip


def memory_of(written: Any) -> Any:
    """The kind of memory that was written down; versions with one kind wrote whether it is on."""
    return ("none", "features")[written] if isinstance(written, bool) else written


@dataclass(frozen=True)
class PolicySettings:
    """All that a policy is, beside its weights."""

    set_width: int  # of the networks that read one row
    hidden: tuple[int, ...]  # widths of the layers behind them
    clearance: float  # of the guide, rad
    persistence: float  # of the guide
    min_alignment: float  # ε, which the certified heading keeps, or which the tank owes
    max_turn_rate: float  # of the certified heading, rad/s
    decision_time: float  # s between decisions
    guarantee: Literal["heading", "tank"] = "heading"
    budget: float = 0.0  # of each tank at the start, in units of r D̄, for teams of any size
    memory: Literal["none", "features", "recurrent"] = "none"
    """Beside the last decisions nothing, with a tank features of walls, or a recurrent unit's."""
    memory_units: int = 64  # of the recurrent unit

    def __post_init__(self) -> None:
        """Refuse what no network and no heading can have."""
        check_field_types(self)
        for name, (least, most) in _RANGES.items():
            if not least <= getattr(self, name) <= most:
                raise ValueError(
                    f"{name} is {getattr(self, name)}; it must be in [{least}, {most}]"
                )
        if not all(1 <= width <= _WIDEST for width in self.hidden):
            raise ValueError(f"hidden is {self.hidden}; each must be in [1, {_WIDEST}]")

    def to_plain(self) -> dict[str, Any]:
        """As plain data, with the version of the features that the weights belong to."""
        return asdict(self) | {"perception": VERSION}

    @classmethod
    def from_plain(cls, plain: Any) -> PolicySettings:
        """What ``to_plain`` gave, or that of a version without tanks; a ValueError for missing or
        unknown fields, or other features.
        """
        if not isinstance(plain, Mapping) or plain.get("perception") != VERSION:
            version = plain.get("perception") if isinstance(plain, Mapping) else plain
            raise ValueError(f"perception is {version!r}; this version has {VERSION}")
        given = {field.name: field.default for field in fields(cls) if field.default is not MISSING}
        given |= {key: value for key, value in plain.items() if key != "perception"}
        if wrong := sorted(set(given) ^ set(cls.__dataclass_fields__)):
            raise ValueError(f"field {wrong[0]!r} is missing or unknown")
        check_types(given, {"hidden": list[int] | tuple[int, ...]})
        memory = memory_of(given["memory"])
        return cls(**given | {"hidden": tuple(given["hidden"]), "memory": memory})

    @property
    def promised_margin(self) -> float | None:
        """ε of theorem C, kept but where ‖f‖ < 2δ, where it fades; None with a tank."""
        return self.min_alignment if self.guarantee == "heading" else None

    @property
    def units(self) -> int:
        """Numbers that a recurrent unit keeps for each robot; 0 without one."""
        return self.memory_units if self.memory == "recurrent" else 0

    @property
    def angles(self) -> NDArray[np.float64]:
        """What can be chosen, rad."""
        return ANGLES if self.guarantee == "heading" else ALL_ROUND

    def decision_period(self, scenario: Scenario) -> int:
        """Base steps between decisions in a scenario; 1 where a step is longer."""
        return max(1, round(self.decision_time / scenario.tau))

    def budget_of(self, scenario: Scenario) -> float:
        """B of each tank in a scenario, m²/s."""
        return min(self.budget * unit_of_tanks(scenario), LARGEST)

    def layout(self, neighbour_slots: int, obstacle_slots: int) -> FeatureLayout:
        """What the network is shown, with so many slots."""
        columns = 0
        if self.guarantee == "tank":
            columns = LEVEL_COLUMNS + (WALL_COLUMNS if self.memory == "features" else 0)
        return FeatureLayout(neighbour_slots, obstacle_slots, columns)

    def layout_of(self, scenario: Scenario) -> FeatureLayout:
        """What the network is shown in a scenario."""
        rows = scenario.observation_layout
        return self.layout(rows.neighbour_slots, rows.obstacle_slots)
