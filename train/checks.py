"""Settings that cannot be, refused before any work: by flag, value and what would be right."""

from __future__ import annotations

import math
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

_LONGEST_NAME = 255  # bytes of one part of a path, on every common file system


class UserError(Exception):
    """Ends a command with one line instead of a traceback: the user asked for what cannot be.

    The message says what would be right.
    """


def check_fields(config: Any) -> None:
    """Refuse what no setting of any command may be: NaN, ±∞, text that no file can be called.

    Args:
        config: a dataclass.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    for field in fields(config):
        value = getattr(config, field.name)
        for one in value if isinstance(value, tuple) else (value,):
            _check_value(_name(field), one)


def check_least(config: Any, **least: float) -> None:
    """Refuse numbers below a bound; None is no number and passes.

    Args:
        config: a dataclass.
        **least: by the name of the field.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    for name, bound in least.items():
        for one in _numbers(config, name):
            if not one >= bound:
                raise UserError(f"{flag(name)} is {one}; it must be {bound} or more")


def check_most(config: Any, **most: float) -> None:
    """Refuse numbers above a bound; as ``check_least``."""
    for name, bound in most.items():
        for one in _numbers(config, name):
            if not one <= bound:
                raise UserError(f"{flag(name)} is {one}; it must be {bound} or less")


def _numbers(config: Any, name: str) -> list[float]:
    value = getattr(config, name)
    return [one for one in (value if isinstance(value, tuple) else (value,)) if one is not None]


def check_text(name: str, text: str) -> None:
    """Refuse text that no file can be called, and no terminal shows."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(f"{name} is {text!r}; it must be text in UTF-8") from None
    if "\0" in text:
        raise UserError(f"{name} is {text!r}; it must not hold the character NUL")


_FLAGS = {
    "on": "backend",
    "fresh": "overwrite",
    "keep": "keep-trajectories",
    "ceiling": "oracle-runs",
}
"""Flags that are not called as their fields."""


def flag(name: str) -> str:
    """What the command line calls a field."""
    return "--" + _FLAGS.get(name, name.replace("_", "-"))


def _name(field: Field[Any]) -> str:
    return field.name if "Positional" in str(field.type) else flag(field.name)


def _check_value(name: str, value: Any) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise UserError(f"{name} is {value}; it must be a finite number")
    if isinstance(value, str | Path):
        check_text(name, str(value))
    if isinstance(value, Path):
        for part in value.parts:
            if (size := len(part.encode())) > _LONGEST_NAME:
                raise UserError(
                    f"{name}: {part[:20]}… has {size} bytes; a name may have {_LONGEST_NAME}"
                )
