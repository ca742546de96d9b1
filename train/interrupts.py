"""Handling of Ctrl-C and SIGTERM: a command ends promptly with a one-line message."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
GRACE = 4.0
"""Time for clean-up before the process is ended, s."""


class Interrupted(KeyboardInterrupt):
    """Termination requested by a signal."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def status_of(error: KeyboardInterrupt) -> int:
    """Exit status of an interrupted command: 128 + signal number."""
    return 128 + getattr(error, "number", signal.SIGINT)


def line_of(command: str, error: KeyboardInterrupt) -> str:
    """Last line of an interrupted command, with the notes on resuming attached to the error."""
    notes = getattr(error, "__notes__", ["no file is half written"])
    return f"rendezvous {command}: interrupted; {'; '.join(notes)}"


@contextmanager
def raised(command: str) -> Iterator[None]:
    """Raise ``Interrupted`` in the body on a signal.

    An exception can be swallowed, and compiled code does not check for it. A thread that reads the
    signal from a pipe therefore ends the process if the body still runs after GRACE.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals reach the main thread only
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    over = threading.Event()
    handlers = {number: signal.signal(number, _interrupt) for number in SIGNALS}
    descriptor = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end_late, args=(reader, over, command), daemon=True).start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(descriptor)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(writer)


def leave_to_system() -> None:
    """Restore the default handling of Ctrl-C at the end of the program."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _interrupt(number: int, frame: Any) -> None:
    raise Interrupted(number)


def _end_late(reader: int, over: threading.Event, command: str) -> None:
    """End the process GRACE after the first signal in the pipe, unless the body has finished."""
    while content := os.read(reader, 1):  # empty after closing
        if content[0] in SIGNALS and not over.wait(GRACE):
            error = Interrupted(content[0])
            error.add_note("it did not stop in time; unfinished output was discarded")
            print(line_of(command, error), file=sys.stderr, flush=True)
            os._exit(status_of(error))
    os.close(reader)
