"""Scenarios at several levels of a sensor imperfection."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.sensors.sensing import Sensing

from ..checks import UserError, unknown_name, user_error

Level = float | str | None
_EXACT = "none"
"""Level of the exact sensor, for any field."""
_FIELDS = tuple(field.name for field in fields(Sensing))


def _shown(level: Level) -> str:
    """A level as text."""
    if isinstance(level, float | int):
        return f"{level:.4g}"
    return _EXACT if level is None else level


@dataclass(frozen=True)
class Sweep:
    """A scenario at several levels of one sensor field."""

    base: Scenario
    field: str  # of ``rv.Sensing``
    levels: tuple[Level, ...]  # in the order given
    scenarios: tuple[Scenario, ...]  # the base at each level

    @property
    def labels(self) -> list[str]:
        """The levels as text."""
        return [_shown(level) for level in self.levels]

    @property
    def name(self) -> str:
        """Base name of its files."""
        return f"levels-{self.base.name}-{self.field.replace('_', '-')}"


def sweeps(scenarios: Sequence[Scenario], words: Sequence[str]) -> list[Sweep]:
    """Sweeps of each scenario from strings such as ``noise=0,0.1,0.2``."""
    found: dict[str, tuple[Level, ...]] = {}
    for word in words:
        name, _, listed = word.partition("=")
        if name not in _FIELDS:
            raise unknown_name(f"--sensing {word}: field of a sensor", name, _FIELDS)
        levels = tuple(_level(name, text) for text in listed.split(",") if text)
        if len(levels) < 2 or len(set(levels)) < len(levels):
            raise UserError(f"--sensing {word}: name two or more levels, as in {name}=0,0.1")
        if name in found:
            raise UserError(f"--sensing {word}: {name} is named twice; list its levels once")
        found[name] = levels
    return [
        Sweep(base, field, levels, tuple(_at(base, field, level) for level in levels))
        for base in scenarios
        for field, levels in found.items()
    ]


def _level(field: str, text: str) -> Level:
    """Parse a level, as a number if possible."""
    if text == _EXACT:
        exact: Level = getattr(Sensing(), field)
        return exact
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() else number


def _at(base: Scenario, field: str, level: Level) -> Scenario:
    """Scenario at a level, or unchanged if it already has that level."""
    change: dict[str, Any] = {field: level}
    with user_error(f"--sensing {field}={level}: ", ValueError, TypeError):
        sensing = replace(base.sensing, **change)
        if sensing == base.sensing:
            return base
        name = f"{base.name}-{field.replace('_', '-')}-{_shown(level)}"
        return base.replace(name=name, sensing=sensing)


def rows_of(sweep: Sweep, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of levels.csv for a sweep, from rows of results.csv.

    Columns of the scenario, sensor field and level precede each row; the level of the exact sensor
    is empty if it is not a number.
    """
    return [
        {"base": sweep.base.name, "field": sweep.field, "level": level} | row
        for level, scenario in zip(sweep.levels, sweep.scenarios, strict=True)
        for row in rows
        if row["scenario"] == scenario.name
    ]
