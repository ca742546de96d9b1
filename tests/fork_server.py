"""Runs commands in forked children, so that dozens of them pay for loading and compiling once.

A child is a process of its own that can be killed at any moment. The server reads one command a
line, as JSON, and answers with the child's number and, once it has ended, its exit status.
"""

import json
import os
import subprocess
import sys
from pathlib import Path


def serve() -> None:
    """Answer until the input ends."""
    import torch

    from train import cli

    torch.set_num_threads(1)  # a forked child has none of the threads of its parent
    for line in sys.stdin:
        words, kept = json.loads(line)
        if kept:  # load and compile here what the children will need
            print(os.getpid(), flush=True)
            print(cli.main(words), flush=True)
            continue
        if (child := os.fork()) == 0:
            os._exit(cli.main(words))
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


class ForkServer:
    """The server's other end.

    Args:
        log: file for what the commands say.
    """

    def __init__(self, log: Path) -> None:
        self._log = log.open("w")
        self._server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )

    def start(self, words, *, kept=False) -> int:
        """Begin a command; its process."""
        self._server.stdin.write(json.dumps([words, kept]) + "\n")
        self._server.stdin.flush()
        return self._number()

    def status(self) -> int:
        """Wait for its end."""
        return self._number()

    def _number(self) -> int:
        return int(self._server.stdout.readline())

    def close(self) -> None:
        """End the server."""
        self._server.stdin.close()
        self._server.wait(60)
        self._server.stdout.close()
        self._log.close()


if __name__ == "__main__":
    answers = os.dup(1)
    os.dup2(2, 1)  # what commands print goes to the log
    sys.stdout = os.fdopen(answers, "w")
    import rich.console

    rich.console.Console = lambda *given, real=rich.console.Console, **options: real(
        *given, **options | {"file": sys.stderr}
    )
    serve()
