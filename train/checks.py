"""Validation of command settings; errors name the flag, its value and the remedy."""

import importlib.util
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, Self, get_args, get_origin, get_type_hints

_POLICIES = frozenset(("policy", "policies", "against", "algorithms"))
"""Settings that name policies."""
_LONGEST_NAME = 255  # bytes of one part of a path, on all common file systems


class UserError(Exception):
    """Invalid user input: ends a command with a one-line message that names the remedy."""


@contextmanager
def user_error(beginning: str, *kinds: type[Exception]) -> Iterator[None]:
    """Convert errors of the given types in the body to a UserError with a prefix.

    The message of an OSError omits the path, which the prefix names.
    """
    try:
        yield
    except kinds as error:
        raise UserError(f"{beginning}{getattr(error, 'strerror', None) or error}") from error


def installed(module: str) -> bool:
    """True if a library can be imported; a plain folder of the same name does not count."""
    found = importlib.util.find_spec(module)
    return found is not None and found.origin is not None


def check_installed(what: str, extra: str, *packages: str) -> None:
    """Raise a UserError if packages are missing; it names the extra that installs them."""
    for package in packages:
        if not installed(package):
            raise UserError(f"{what} needs {package}; pip install 'rendezvous-env[{extra}]'")


class Bounds(NamedTuple):
    """Interval of a number or of each entry of a tuple; a round bracket excludes the end."""

    least: float
    most: float = math.inf
    ends: str = "[]"

    def check(self, name: str, value: float) -> None:
        """Raise a UserError if a number lies outside; it names the flag."""
        above, below = self.ends[0] == "(", self.ends[1] == ")"
        if value < self.least or (value == self.least and above):
            right = f"more than {self.least}" if above else f"{self.least} or more"
        elif value > self.most or (value == self.most and below):
            right = f"less than {self.most}" if below else f"{self.most} or less"
        else:
            return
        raise UserError(f"{name} is {value}; it must be {right}")


class GivenScenario(str):
    """Name of a Scenario that was passed to a command in Python, with the Scenario."""

    scenario: Any

    def __new__(cls, scenario: Any) -> Self:
        """Name of a scenario."""
        made = super().__new__(cls, scenario.name)
        made.scenario = scenario
        return made

    def __getnewargs__(self) -> tuple[Any]:
        return (self.scenario,)


@dataclass(frozen=True)
class Flags:
    """Base class of command settings, with one field per flag, validated on creation.

    A UserError reports a wrong type, a value outside its ``Bounds``, a number that is not finite,
    or text that is no file name. In Python, lists and text may replace tuples and paths, and a
    Scenario its name.
    """

    def __post_init__(self) -> None:
        """Convert and validate all fields."""
        from rendezvous_env.baselines.learned.plain_data import check_types  # not for --help

        kinds, marked = get_type_hints(type(self)), get_type_hints(type(self), include_extras=True)
        for name, value in list(vars(self).items()):
            several = get_origin(kinds[name]) is tuple
            if isinstance(value, list | tuple) or (several and _is_one(value)):
                listed = (value,) if _is_one(value) else value
                object.__setattr__(self, name, tuple(map(_named, listed)))
            elif _named(value) is not value:
                object.__setattr__(self, name, _named(value))
            elif isinstance(value, str) and Path in (kinds[name], *get_args(kinds[name])):
                object.__setattr__(self, name, Path(value))
        with user_error("", ValueError):
            check_types(vars(self), kinds)
        for name in _POLICIES & vars(self).keys():
            object.__setattr__(self, name, _of_current_policies(getattr(self, name)))
        for field in fields(self):
            hint, value = marked[field.name], getattr(self, field.name)
            name = field.name if "Positional" in str(field.type) else flag(field.name, hint)
            for one in value if isinstance(value, tuple) else (value,):
                _check_value(name, one)
                for mark in getattr(hint, "__metadata__", ()):
                    if isinstance(mark, Bounds) and one is not None:
                        mark.check(name, one)


def _of_current_policies(value: Any) -> Any:
    """Replace deprecated names of policies, with a warning; other values are unchanged."""
    if isinstance(value, tuple):
        return tuple(map(_of_current_policies, value))
    if isinstance(value, str) and (current := current_policy(value)) != value:
        old, new = (word.rpartition("=")[2] for word in (value, current))
        warnings.warn(f"policy {old!r} is called {new!r} now", DeprecationWarning, 4)
        return current
    return value


def current_policy(word: str) -> str:
    """Replace the deprecated name of a policy, also in LABEL=NAME; other words are unchanged."""
    from rendezvous_env.baselines.policy import current_name  # not for --help

    label, equals, name = word.rpartition("=")
    return f"{label}{equals}{current_name(name)}"


def _is_one(value: Any) -> bool:
    """True if a value is a single name, a text or a Scenario, for a field of several."""
    return isinstance(value, str) or _named(value) is not value


def _named(value: Any) -> Any:
    """Replace a Scenario by a name that carries it; other values are unchanged."""
    from rendezvous_env.scenario.scenario import Scenario  # not for --help

    return GivenScenario(value) if isinstance(value, Scenario) else value


def check_unused(flags: Flags, reasons: Mapping[str, str]) -> None:
    """Raise a UserError for flags without effect, with the given reasons, unless at default."""
    for name, why in reasons.items():
        if (value := getattr(flags, name)) != getattr(type(flags), name):
            raise UserError(f"{flag(name)} is {format_argument(value)}; {why}")


def _check_value(name: str, value: Any) -> None:
    """Raise a UserError for NaN, ±∞ and text that is not a valid file name."""
    if isinstance(value, float) and not math.isfinite(value):
        raise UserError(f"{name} is {value}; it must be a finite number")
    if isinstance(value, str | Path):
        check_text(name, str(value))
    for part in value.parts if isinstance(value, Path) else ():
        if (size := len(part.encode())) > _LONGEST_NAME:
            raise UserError(
                f"{name}: {part[:20]}… has {size} bytes; a name may have {_LONGEST_NAME}"
            )


def unknown_name(what: str, word: str, known: Iterable[str]) -> UserError:
    """Error for an unknown name, with the known names and the closest match."""
    from rendezvous_env.suggestions import closest_match  # not for --help

    listed = list(known)
    near = closest_match(word, listed, after=" ")
    return UserError(f"{what} {word!r} is unknown; {near}known are {', '.join(listed)}")


def check_text(name: str, text: str) -> None:
    """Raise a UserError for text that is not a valid file name or not printable."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise UserError(f"{name} is {text!r}; it must be text in UTF-8") from None
    if "\0" in text:
        raise UserError(f"{name} is {text!r}; it must not hold the character NUL")


def format_argument(value: Any) -> str:
    """Value as written on the command line."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def flag(name: str, hint: Any = None) -> str:
    """Flag name of a field, honouring ``tyro.conf.arg`` in its annotation."""
    names = (getattr(mark, "name", None) for mark in getattr(hint, "__metadata__", ()))
    return "--" + next(filter(None, names), name.replace("_", "-"))
