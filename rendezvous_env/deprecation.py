"""Deprecated names, which work for one release with a warning."""

import functools
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that a name is deprecated; by default in the code that called the caller."""
    warnings.warn(f"{old} is called {new} now", DeprecationWarning, stacklevel=stacklevel)


def renamed_attribute(old: str, new: str, label: str = "") -> Any:
    """Read-only property for the former name of an attribute; ``label`` names the class."""

    def read(owner: Any) -> Any:
        warn_renamed(f"{label or type(owner).__name__}.{old}", new)
        return getattr(owner, new)

    return property(read, doc=f"Deprecated: ``{new}``.")


class RenamedKeys(dict[str, Any]):
    """Dict that also has the former names of its keys, by subscript and ``get``."""

    def __init__(self, items: Mapping[str, Any], former: Mapping[str, str]) -> None:
        super().__init__(items)
        self._former = dict(former)

    def __missing__(self, key: str) -> Any:
        if key in self._former:
            warn_renamed(repr(key), repr(self._former[key]))
            return self[self._former[key]]
        raise KeyError(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Value of a key, a former name of it included."""
        if key not in self and self._former.get(key) in self:
            warn_renamed(repr(key), repr(self._former[key]))
        return super().get(self._former.get(key, key) if key not in self else key, default)


def renamed_arguments(**names: str) -> Callable[[_Function], _Function]:
    """Decorator that accepts former names of keyword arguments, ``old="new"``.

    Raises:
        TypeError: in a call with both names of an argument.
    """

    def decorate(function: _Function) -> _Function:
        @functools.wraps(function)
        def call(*args: Any, **arguments: Any) -> Any:
            for old in names.keys() & arguments.keys():
                if names[old] in arguments:
                    raise TypeError(f"{old} is the former name of {names[old]}; give one of them")
                warn_renamed(old, names[old])
                arguments[names[old]] = arguments.pop(old)
            return function(*args, **arguments)

        return call  # type: ignore[return-value]

    return decorate
