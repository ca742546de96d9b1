"""Filters with injected faults, which tests of guarantees must detect."""

from collections.abc import Callable
from functools import wraps

import pytest


def mistaken(monkeypatch: pytest.MonkeyPatch, made: type, changes: Callable) -> None:
    """Replace the constants of a class of filters, based on the correct ones."""
    begin = made.__init__

    @wraps(begin)  # whose arguments the wrappers read
    def wrong(self, *given, **asked):
        begin(self, *given, **asked)
        name = "_constants" if hasattr(self, "_constants") else "_robot"
        known = getattr(self, name)
        setattr(self, name, known._replace(**changes(known)))

    monkeypatch.setattr(made, "__init__", wrong)
