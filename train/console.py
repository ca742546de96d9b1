"""Console output of commands."""

import os
import sys
from typing import Any

import rich.console


class Console(rich.console.Console):
    """Console without markup, so that brackets and colons in names are printed unchanged.

    After a broken pipe, for example with ``| head``, the command continues silently.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def on_broken_pipe(self) -> None:
        """Discard all further output."""
        self.quiet = True
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
