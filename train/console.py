"""Where commands say what they do."""

from typing import Any

import rich.console


class Console(rich.console.Console):
    """A console that shows text as it is: brackets and colons in a path or a name are no markup."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)
