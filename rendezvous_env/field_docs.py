"""Fields of dataclasses in ``help``: meaning, unit, type, default and bounds of each.

Docstrings of fields exist only in the source, which ``help`` does not read. ``lists_fields`` adds
them to the docstring of the class on first access.
"""

import ast
import dataclasses
import functools
import inspect
import textwrap
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from .limits import LARGEST, SMALLEST

_Class = TypeVar("_Class", bound=type)
_WIDTH = 84
_LONGEST_LIST = 12  # maximum number of choices listed in full


def lists_fields(cls: _Class) -> _Class:
    """Append a list of fields to the docstring of a dataclass."""
    cls.__doc__ = _ListedDoc(cls.__doc__ or "")  # type: ignore[assignment]
    return cls


class _ListedDoc:
    """Docstring of a class with the list of fields, created on first access."""

    def __init__(self, own: str) -> None:
        self.own, self._made = own, dict[type, str]()

    def __get__(self, instance: Any, owner: type) -> str:
        if owner not in self._made:
            self._made[owner] = "\n\n".join([inspect.cleandoc(self.own), *_section(owner)])
        return self._made[owner]


def _section(cls: type) -> list[str]:
    if not dataclasses.is_dataclass(cls):
        return []
    entries = [_entry(*one) for one in described_fields(cls)]
    return ["\n".join(["Fields:", *entries])] if entries else []


def _entry(name: str, default: str, meaning: str, bounds: str) -> str:
    text = " ".join(filter(None, [meaning, f"It must be {bounds}." if bounds else ""]))
    body = textwrap.fill(text, _WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return f"    {name}{f' = {default}' if default else ''}\n{body}".rstrip()


def described_fields(cls: type) -> list[tuple[str, str, str, str]]:
    """Name, default, meaning and bounds of every field of a dataclass, as text.

    The default is empty for required fields, and bounds are empty if unknown.
    """
    meanings, hints = field_docstrings(cls), get_type_hints(cls, include_extras=True)
    return [
        (field.name, _default(field), meanings.get(field.name, ""), bounds_of(hints[field.name]))
        for field in dataclasses.fields(cls)
    ]


def field_docstrings(cls: type) -> dict[str, str]:
    """Docstrings of the fields of a dataclass and its bases, on one line each.

    Empty if the source is unavailable.
    """
    found: dict[str, str] = {}
    for kind in reversed(cls.__mro__):
        if not dataclasses.is_dataclass(kind):
            continue
        try:
            source = textwrap.dedent(inspect.getsource(kind))
        except (OSError, TypeError):
            continue
        (parsed,) = ast.parse(source).body
        for before, after in pairwise(parsed.body):  # type: ignore[attr-defined]
            if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
                found[ast.unparse(before.target)] = " ".join(ast.literal_eval(after.value).split())
    return found


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is not dataclasses.MISSING:
        return repr(field.default)
    if field.default_factory is dataclasses.MISSING:
        return ""
    name = getattr(field.default_factory, "__name__", "")
    return f"{name}()" if name.isidentifier() else repr(field.default_factory())


def bounds_of(hint: Any) -> str:
    """Requirement of an annotated field in words; empty if unknown."""
    checks = [_words_of(check) for check in _checks_in(hint)]
    words = " or ".join(filter(None, checks))
    return f"None, or {words}" if words and _may_be_none(hint) else words


def _checks_in(hint: Any) -> Iterable[Any]:
    """Checks and literals of an annotation, for each of its alternatives."""
    if get_origin(hint) is Annotated:
        yield from hint.__metadata__
    elif get_origin(hint) is Literal:
        yield hint
    else:
        for part in get_args(hint) if _is_union(hint) else ():
            yield from _checks_in(part)


def _is_union(hint: Any) -> bool:
    return "Union" in str(get_origin(hint))


def _may_be_none(hint: Any) -> bool:
    return _is_union(hint) and type(None) in get_args(hint)


def _words_of(check: Any) -> str:
    if get_origin(check) is Literal:
        return f"one of {', '.join(map(repr, get_args(check)))}"
    given = dict(getattr(check, "keywords", {}))
    name = getattr(check.func if isinstance(check, functools.partial) else check, "__name__", "")
    describe = _DESCRIBED.get(name)
    return "" if describe is None else describe(**given)


def _number(least: float = -LARGEST, most: float = LARGEST, unit: str = "") -> str:
    return f"a number from {least:.6g} to {most:.6g} {unit}".rstrip()


def _positive(unit: str = "") -> str:
    return _number(SMALLEST, LARGEST, unit)


def _whole(least: int, most: int) -> str:
    return f"an integer from {least} to {most}"


def _choice(choices: Iterable[str]) -> str:
    words = list(choices)
    return (
        f"one of {', '.join(map(repr, words))}" if len(words) <= _LONGEST_LIST else "a known name"
    )


def _one_or_each(check: Callable[..., Any], unit: str = "", keeps_lists: bool = False) -> str:
    return f"{_words_of(check)}, or a list of one for each robot"


def _number_range(least: float = SMALLEST, unit: str = "") -> str:
    return f"a number, or a pair (low, high), {least:.6g} or more {unit}".rstrip()


_DESCRIBED: dict[str, Callable[..., str]] = {
    "number": _number,
    "positive": _positive,
    "check_int": _whole,
    "choice": _choice,
    "flag": lambda: "True or False",
    "number_range": _number_range,
    "edge_lengths": lambda: f"{_positive('m')}, or one for each dimension",
    "one_or_each": _one_or_each,
}
"""Descriptions of the checks in ``checks``, by name."""
