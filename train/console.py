"""Where commands say what they do."""

import os
import sys
from typing import Any

import rich.console


def counted(count: int, noun: str) -> str:
    """A count with its noun, in the plural unless it is 1."""
    return f"{count} {noun}{'s' * (count != 1)}"


class Console(rich.console.Console):
    """A console that shows text as it is: brackets and colons in a path or a name are no markup.
    Once nobody reads any more, as after ``| head``, the command goes on in silence.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def on_broken_pipe(self) -> None:
        """Write to nowhere."""
        self.quiet = True
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
