"""Filters with injected faults, which tests of guarantees must detect."""

from collections.abc import Callable
from functools import wraps

import pytest


def mistaken(monkeypatch: pytest.MonkeyPatch, made: type, changes: Callable) -> None:
    """Let filters of a class be made with other constants, which follow from the right ones."""
    begin = made.__init__

    @wraps(begin)  # whose arguments the wrappers read
    def wrong(self, *given, **asked):
        begin(self, *given, **asked)
        name = "_constants" if hasattr(self, "_constants") else "_robot"
        known = getattr(self, name)
        setattr(self, name, known._replace(**changes(known)))

    monkeypatch.setattr(made, "__init__", wrong)
