"""Settings that cannot be, refused before any work: by flag, value and what would be right."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from operator import ge, le
from pathlib import Path
from typing import Any

_LONGEST_NAME = 255  # bytes of one part of a path, on every common file system


class UserError(Exception):
    """Ends a command with one line instead of a traceback: the user asked for what cannot be.

    The message says what would be right.
    """


def installed(module: str) -> bool:
    """Whether a library of that name can be imported; a mere folder of that name is none."""
    found = importlib.util.find_spec(module)
    return found is not None and found.origin is not None


def check_installed(what: str, extra: str, *packages: str) -> None:
    """Refuse what needs packages that are missing.

    Raises:
        UserError: naming the package, and the extra that installs it.
    """
    for package in packages:
        if not installed(package):
            raise UserError(f"{what} needs {package}; pip install 'rendezvous-env[{extra}]'")


def check_fields(config: Any) -> None:
    """Refuse what no setting of any command may be: NaN, ±∞, text that no file can be called.

    Args:
        config: a dataclass.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    for field in fields(config):
        name = field.name if "Positional" in str(field.type) else flag(field.name)
        for value in _each(config, field.name):
            if isinstance(value, float) and not math.isfinite(value):
                raise UserError(f"{name} is {value}; it must be a finite number")
            if isinstance(value, str | Path):
                check_text(name, str(value))
            for part in value.parts if isinstance(value, Path) else ():
                if (size := len(part.encode())) > _LONGEST_NAME:
                    raise UserError(
                        f"{name}: {part[:20]}… has {size} bytes; a name may have {_LONGEST_NAME}"
                    )


def check_least(config: Any, **least: float) -> None:
    """Refuse numbers below a bound; None is no number and passes.

    Args:
        config: a dataclass.
        **least: by the name of the field.

    Raises:
        UserError: naming the flag, its value and what would be right.
    """
    _check_bounds(config, least, ge, "more")


def check_most(config: Any, **most: float) -> None:
    """Refuse numbers above a bound; as ``check_least``."""
    _check_bounds(config, most, le, "less")


def _check_bounds(
    config: Any, bounds: Mapping[str, float], right: Callable[[Any, Any], bool], which: str
) -> None:
    for name, bound in bounds.items():
        for one in _each(config, name):
            if one is not None and not right(one, bound):
                raise UserError(f"{flag(name)} is {one}; it must be {bound} or {which}")


def _each(config: Any, name: str) -> tuple[Any, ...]:
    value = getattr(config, name)
    return value if isinstance(value, tuple) else (value,)


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
