"""Test parameters with markers, by name.

A slow parameter beside others that are not is nightly; see ``repetitions`` in ``conftest.py``.
"""

from collections.abc import Collection, Iterable

import pytest


def marked(
    names: Iterable[str],
    *,
    slow: Collection[str] = (),
    own_path: Collection[str] = (),
    nightly: Collection[str] = (),
    kernels: Collection[str] = (),
) -> list[object]:
    """Names as parameters; those listed get the marker ``slow``, ``nightly`` or ``kernels``.

    Those of ``own_path`` are slow, and stay so beside fast ones.
    """
    names = list(names)
    marks = [
        (pytest.mark.slow(own_path=True), own_path),
        (pytest.mark.slow, {*slow} - {*own_path}),
        (pytest.mark.nightly, nightly),
        (pytest.mark.kernels, kernels),
    ]
    for _, marked in marks:
        assert {*marked} <= {*names}, "a marked parameter is not among the parameters"
    return [
        pytest.param(name, marks=[mark for mark, marked in marks if name in marked])
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


def needed(*values: object) -> object:
    """One slow set of parameters with a code path of its own, so never nightly."""
    return pytest.param(*values, marks=pytest.mark.slow(own_path=True))


def nightly(*values: object) -> object:
    """One set of parameters with the marker ``nightly``."""
    return pytest.param(*values, marks=pytest.mark.nightly)
