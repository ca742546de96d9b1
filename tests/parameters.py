"""Test parameters with markers, by name."""

from collections.abc import Collection, Iterable

import pytest


def marked(
    names: Iterable[str], *, slow: Collection[str] = (), kernels: Collection[str] = ()
) -> list[object]:
    """Names as parameters; those listed get the marker ``slow`` or ``kernels``."""
    names, marks = list(names), {"slow": slow, "kernels": kernels}
    assert {*slow, *kernels} <= {*names}, "a marked parameter is not among the parameters"
    return [
        pytest.param(name, marks=[getattr(pytest.mark, m) for m in marks if name in marks[m]])
        for name in names
    ]


def first_fast(values: Iterable[object], count: int = 1) -> list[object]:
    """Values, or tuples of values, as parameters; all but the first get the marker ``slow``."""
    values = list(values)
    later = (value if isinstance(value, tuple) else (value,) for value in values[count:])
    return [*values[:count], *(slow(*value) for value in later)]


def slow(*values: object) -> object:
    """One set of parameters with the marker ``slow``."""
    return pytest.param(*values, marks=pytest.mark.slow)
