"""Settings that cannot be, refused before any work: by flag, value and what would be right."""

import importlib.util
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

_Settings = TypeVar("_Settings", bound=Any)
_LONGEST_NAME = 255  # bytes of one part of a path, on every common file system


class UserError(Exception):
    """The user's mistake: ends a command with one line, which says what would be right."""


@contextmanager
def user_error(beginning: str, *kinds: type[Exception]) -> Iterator[None]:
    """Errors of these kinds in the body are the user's mistake, told after a beginning; an OSError
    is told without the path, which that names.
    """
    try:
        yield
    except kinds as error:
        raise UserError(f"{beginning}{getattr(error, 'strerror', None) or error}") from error


def installed(module: str) -> bool:
    """Whether a library of that name can be imported; a mere folder of that name is none."""
    found = importlib.util.find_spec(module)
    return found is not None and found.origin is not None


def check_installed(what: str, extra: str, *packages: str) -> None:
    """Refuse what needs packages that are missing, naming the extra that installs them."""
    for package in packages:
        if not installed(package):
            raise UserError(f"{what} needs {package}; pip install 'rendezvous-env[{extra}]'")


def typed(config: _Settings) -> _Settings:
    """Settings that were made in Python, with tuples and paths where lists and text stand for them;
    a UserError names a field of another type.
    """
    from rendezvous_env.baselines.learned.plain_data import check_field_types  # not for --help

    given, hints = vars(config), get_type_hints(type(config))
    paths = [name for name, hint in hints.items() if Path in (hint, *get_args(hint))]
    changed: dict[str, Any] = {k: tuple(v) for k, v in given.items() if isinstance(v, list)}
    changed |= {name: Path(given[name]) for name in paths if isinstance(given[name], str)}
    config = replace(config, **changed)
    with user_error("", ValueError):
        check_field_types(config)
    return config


def check_fields(config: Any) -> None:
    """Refuse what no field of any settings may be: NaN, ±∞, text that is no name of a file."""
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


def check_bounds(config: Any, **bounds: tuple[float, float]) -> None:
    """Refuse numbers in fields of a dataclass below the least or above the most; None passes."""
    for name, (least, most) in bounds.items():
        for one in _each(config, name):
            if one is not None and not least <= one <= most:
                bound = f"{most} or less" if one > most else f"{least} or more"
                raise UserError(f"{flag(name)} is {one}; it must be {bound}")


def _each(config: Any, name: str) -> tuple[Any, ...]:
    value = getattr(config, name)
    return value if isinstance(value, tuple) else (value,)


def meant(word: str, known: Sequence[str]) -> str:
    """The question whether a known word was meant that is nearly this one; empty without one."""
    from rendezvous_env import checks  # not for --help

    return checks.meant(word, known, after=" ")


def check_text(name: str, text: str) -> None:
    """Refuse text that no file can be called, and no terminal shows."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(f"{name} is {text!r}; it must be text in UTF-8") from None
    if "\0" in text:
        raise UserError(f"{name} is {text!r}; it must not hold the character NUL")


_FLAGS = {
    "on": "backend", "fresh": "overwrite", "keep": "keep-trajectories", "ceiling": "oracle-runs",
}  # fmt: skip
"""Flags that are not called as their fields."""


def flag(name: str) -> str:
    """What the command line calls a field."""
    return "--" + _FLAGS.get(name, name.replace("_", "-"))
