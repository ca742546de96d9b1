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
    """Dict whose keys are also found by their former names, with a warning.

    This holds for subscripts, ``in``, ``get``, ``pop``, ``setdefault`` and ``del``, and in copies
    and unions. Iteration, length and equality ignore former names. An assignment stores a key as
    given.
    """

    def __init__(self, items: Mapping[str, Any], former: Mapping[str, str]) -> None:
        super().__init__(items)
        self._former = dict(former)

    def _current(self, key: str) -> str:
        """Key of the dict for a key or a former name; other keys are returned as given."""
        if super().__contains__(key) or key not in self._former:
            return key
        new = self._former[key]
        if not super().__contains__(new):
            return key
        warn_renamed(repr(key), repr(new), stacklevel=4)
        return new

    def __missing__(self, key: str) -> Any:
        if (new := self._current(key)) == key:
            raise KeyError(key)
        return self[new]

    def __contains__(self, key: Any) -> bool:
        return super().__contains__(self._current(key))

    def __delitem__(self, key: str) -> None:
        super().__delitem__(self._current(key))

    def get(self, key: str, default: Any = None) -> Any:
        """Value of a key or a former name."""
        return super().get(self._current(key), default)

    def pop(self, key: str, *default: Any) -> Any:
        """Remove a key, given by itself or a former name, and return its value."""
        return super().pop(self._current(key), *default)

    def setdefault(self, key: str, default: Any = None) -> Any:
        """Value of a key or a former name; an absent key is stored as given."""
        return super().setdefault(self._current(key), default)

    def copy(self) -> "RenamedKeys":
        """Shallow copy with the same former names."""
        return RenamedKeys(self, self._former)

    def __or__(self, other: Any) -> Any:
        merged = super().__or__(other)
        return merged if merged is NotImplemented else RenamedKeys(merged, self._former)

    def __ror__(self, other: Any) -> Any:
        merged = super().__ror__(other)
        return merged if merged is NotImplemented else RenamedKeys(merged, self._former)


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
