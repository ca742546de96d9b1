"""Tables of the fields of dataclasses, from their annotations, defaults and docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_type_hints

from train.cli import documents, flags_of


def type_of(hint: Any) -> str:
    """A type without the modules of its names."""
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(?=[A-Za-z])", "", inspect.formatannotation(hint))
    return re.sub(r"Optional\[(.*)\]", r"\1 | None", text)


def default_of(field: dataclasses.Field[Any]) -> str:
    """Default of a field; a dash if it is required."""
    if isinstance(field.default, tuple):
        return " ".join(f"`{entry}`" for entry in field.default) or "none"
    if field.default is not dataclasses.MISSING:
        return f"`{field.default}`"
    if field.default_factory is not dataclasses.MISSING:
        return f"`{field.default_factory.__name__}()`"
    return "–"


def fields_table(
    kind: type[Any],
    head: str = "field",
    names_of: Callable[[dataclasses.Field[Any], Any], list[str]] = lambda field, _: [field.name],
) -> str:
    """Names, type, default and meaning of every field of a dataclass, as Markdown."""
    told, hints = documents(kind), get_type_hints(kind)
    marked = get_type_hints(kind, include_extras=True)
    rows = (
        (
            ", ".join(f"`{name}`" for name in names_of(field, marked[field.name])),
            f"`{type_of(hints[field.name])}`",
            default_of(field),
            told.get(field.name, ""),
        )
        for field in dataclasses.fields(kind)
    )
    return table((head, "type", "default", "meaning"), rows)


def flags_table(config: type[Any]) -> str:
    """Flags, type, default and meaning of every field of a command's settings, as Markdown."""
    return fields_table(config, "flag", flags_of)


def meanings_table(head: str, meanings: Mapping[str, str]) -> str:
    """Names and meanings, as Markdown."""
    return table((head, "meaning"), ((f"`{name}`", text) for name, text in meanings.items()))


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; cells may hold any text."""
    head = tuple(head)
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    """One line, with bars outside of code escaped."""
    parts = " ".join(text.split()).replace("``", "`").split("`")
    return "`".join(p if k % 2 else p.replace("|", r"\|") for k, p in enumerate(parts))
