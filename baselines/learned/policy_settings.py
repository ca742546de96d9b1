"""Settings of learned policies, and quantities derived from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.checks import check_int, is_sequence, number, raise_invalid
from rendezvous_env.field_checks import check_fields
from rendezvous_env.limits import LARGEST
from rendezvous_env.safety.settings import check_margin
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from ..search.memory_kernels import COLUMNS
from .feature_kernels import CONTEXT_COLUMNS, LEVEL_COLUMNS, WALL_COLUMNS
from .features import VERSION, FeatureLayout

ANGLES = np.array([0.0, 0.3, -0.3, 0.6, -0.6, 1.0, -1.0, 1.4, -1.4])
"""Choices with certified headings, rad counter-clockwise from f; 0 is the unmodified rule."""
ALL_ROUND = np.array([*ANGLES, 1.9, -1.9, 2.5, -2.5, np.pi])
"""Choices with a tank, which allows motion away from f, rad."""
COMMANDS = (
    *((1.0, rate) for rate in (0.0, 0.2, -0.2, 0.5, -0.5, 1.0, -1.0)),
    *((0.0, rate) for rate in (0.0, 0.2, -0.2, 0.5, -0.5, 1.0, -1.0)),
    *((-1.0, rate) for rate in (0.0, 1.0, -1.0)),
)
"""Choices without a filter: speed and turn rate in units of their limits."""
CHOICES = len(ANGLES)
_Width = Annotated[int, partial(check_int, least=1, most=2**12)]
_Positive = Annotated[float, partial(number, least=1e-9, most=1e9)]
_NotNegative = Annotated[float, partial(number, least=0.0, most=1e9)]


def memory_of(written: Any) -> Any:
    """Kind of memory from stored settings; older versions stored whether it was enabled."""
    return ("none", "features")[written] if isinstance(written, bool) else written


def _widths(field: str, value: Any) -> tuple[int, ...]:
    """Widths of layers, from a list of JSON."""
    if not is_sequence(value):
        raise_invalid(field, value, "integers")
    return tuple(check_int(field, width, 1, 2**12) for width in value)


def _margin(_: str, value: Any) -> float:
    return check_margin(value)


def time_unit(scenario: Scenario) -> float:
    """Time r/v_max, s, in which a robot drives the merge radius."""
    return float(scenario.merge_radius / scenario.action_bounds[0])


@dataclass(frozen=True)
class PolicySettings:
    """Settings of a learned policy, without its weights."""

    set_width: _Width  # width of the networks that read one row
    hidden: Annotated[tuple[int, ...], _widths]  # widths of the following layers
    clearance: Annotated[float, partial(number, least=0.0, most=math.pi)]  # rad
    persistence: _NotNegative  # of the base controller, as its clearance
    min_alignment: Annotated[float, _margin]
    """Minimum alignment ε of the certified heading, or of the tank."""
    max_turn_rate: _Positive  # of the certified heading, rad/s
    decision_time: _Positive  # s between decisions; without a filter in units of r/v_max
    guarantee: Literal["heading", "tank", "none"] = "heading"
    budget: _NotNegative = 0.0  # initial energy of a tank, in units of r D̄
    memory: Literal["none", "features", "recurrent"] = "none"
    """Memory beyond the last decision: none, features of walls (with a tank), or recurrent."""
    memory_units: _Width = 64  # of the recurrent unit

    def __post_init__(self) -> None:
        """Validate the values."""
        check_fields(self)

    def to_plain(self) -> dict[str, Any]:
        """Settings as plain data, with the version of the features."""
        return asdict(self) | {"perception": VERSION}

    @classmethod
    def from_plain(cls, plain: Any) -> PolicySettings:
        """Settings from the result of ``to_plain``, or from that of a version without tanks.

        Raises:
            ValueError: for missing or unknown fields, or another version of the features.
        """
        if not isinstance(plain, Mapping) or plain.get("perception") != VERSION:
            version = plain.get("perception") if isinstance(plain, Mapping) else plain
            raise ValueError(f"perception is {version!r}; this version has {VERSION}")
        given = {field.name: field.default for field in fields(cls) if field.default is not MISSING}
        given |= {key: value for key, value in plain.items() if key != "perception"}
        if wrong := sorted(set(given) ^ set(cls.__dataclass_fields__)):
            raise ValueError(f"field {wrong[0]!r} is missing or unknown")
        return cls(**given | {"memory": memory_of(given["memory"])})

    @property
    def promised_margin(self) -> float | None:
        """ε of theorem C, reduced where ‖f‖ < 2δ; None with a tank."""
        return self.min_alignment if self.guarantee == "heading" else None

    @property
    def units(self) -> int:
        """Size of the recurrent state of each robot; 0 without one."""
        return self.memory_units if self.memory == "recurrent" else 0

    @property
    def angles(self) -> NDArray[np.float64]:
        """Available choices, rad; none without a filter."""
        return {"heading": ANGLES, "tank": ALL_ROUND, "none": ANGLES[:0]}[self.guarantee]

    @property
    def commands(self) -> tuple[tuple[float, float], ...]:
        """Available speeds and turn rates, in units of their limits; none with a filter."""
        return COMMANDS if self.guarantee == "none" else ()

    @property
    def choices(self) -> int:
        """Number of available choices."""
        return len(self.angles) + len(self.commands)

    def decision_period(self, scenario: Scenario) -> int:
        """Steps between decisions in a scenario; 1 if a step is longer."""
        unit = time_unit(scenario) if self.guarantee == "none" else 1.0
        return max(1, round(self.decision_time * unit / scenario.tau))

    def budget_of(self, scenario: Scenario) -> float:
        """Budget B of each tank in a scenario, m²/s."""
        return min(self.budget * unit_of_tanks(scenario), LARGEST)

    def layout(self, neighbour_slots: int, obstacle_slots: int) -> FeatureLayout:
        """Feature layout for given numbers of slots."""
        columns = 0
        if self.guarantee == "none":
            columns = COLUMNS - CONTEXT_COLUMNS
        if self.guarantee == "tank":
            columns = LEVEL_COLUMNS + (WALL_COLUMNS if self.memory == "features" else 0)
        return FeatureLayout(neighbour_slots, obstacle_slots, columns)

    def layout_of(self, scenario: Scenario) -> FeatureLayout:
        """Feature layout in a scenario."""
        rows = scenario.observation_layout
        return self.layout(rows.neighbour_slots, rows.obstacle_slots)
