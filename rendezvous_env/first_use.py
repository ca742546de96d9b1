"""A word about compilation: it happens on first use, silently, and may take half a minute."""

from __future__ import annotations

import sys
import time
from typing import Any

from numba.core import event

_PATIENCE = 2.0
"""s; compilation that is over sooner is not worth a word."""
_OURS = ("rendezvous_env.", "baselines.", "train.")


class Notice(event.Listener):
    """Says once, on stderr, that kernels are being compiled, when that takes more than 2 s."""

    def __init__(self) -> None:
        self._depth = 0
        self._began = 0.0
        self._said = False

    def on_start(self, event: Any) -> None:
        """A function begins to be compiled, maybe for another one."""
        if self._depth == 0:
            self._began = time.monotonic()
        self._depth += 1
        self._look(event)

    def on_end(self, event: Any) -> None:
        """It has been compiled."""
        self._depth = max(0, self._depth - 1)
        self._look(event)

    def _look(self, event: Any) -> None:
        if self._said or time.monotonic() - self._began <= _PATIENCE:
            return
        if _is_ours(event):
            self._said = True
            print(
                "rendezvous_env: compiling for this kind of team, which is done once and kept on "
                "disk; `rendezvous warmup` does it beforehand",
                file=sys.stderr,
            )


def _is_ours(event: Any) -> bool:
    dispatcher = (event.data or {}).get("dispatcher")
    module = getattr(getattr(dispatcher, "py_func", None), "__module__", None) or ""
    return module.startswith(_OURS)


def announce() -> None:
    """Say a word about compilation in this process, should there be any."""
    event.register("numba:compile", Notice())
