"""``repr`` of dataclasses with many fields: those that differ from their defaults."""

from dataclasses import MISSING, Field, fields
from math import isfinite
from typing import Any


def repr_of_changes(made: Any) -> str:
    """Call that creates an equal instance, without the fields that have their default."""
    given = {field.name: getattr(made, field.name) for field in fields(made)}
    shown = [
        f"{field.name}={_repr(given[field.name])}"
        for field in fields(made)
        if not _is_default(field, given[field.name])
    ]
    return f"{type(made).__qualname__}({', '.join(shown)})"


def _is_default(field: Field[Any], value: Any) -> bool:
    if field.default_factory is not MISSING:
        return bool(value == field.default_factory())
    return field.default is not MISSING and bool(value == field.default)


def _repr(value: Any) -> str:
    """Expression of a value; "inf" and "nan" are no names."""
    infinite = isinstance(value, float) and not isfinite(value)
    return f"float({str(value)!r})" if infinite else repr(value)
