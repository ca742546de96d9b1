"""The command line ``rendezvous``: finds the command, reads its flags, and ends it cleanly.

Each command is a module with a frozen dataclass ``Config``, whose fields are the flags, and a
function ``run(config)`` that returns the exit status. Only the module of the command is imported.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module

COMMANDS = {
    "compare": ("comparing.compare", "compare policies on the same starts: table, files, figures"),
    "train": ("learning.ppo", "PPO learns headings that keep the guarantee; stop it, resume it"),
    "report": ("report.build", "an HTML page of what compare found, with an interactive replay"),
    "bench": ("benchmark.bench", "how fast the environments are on this machine"),
    "render": ("pictures.render", "one episode as a film (gif, mp4) or a figure (png, pdf)"),
    "reproduce": ("pictures.reproduce", "draw figure 3 or 4 of the paper for our start positions"),
    "verify": ("verification.verify", "check the theorems on random teams; status 1 if one fails"),
}
"""Module in ``train`` and one line of help for each command."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: what follows ``rendezvous``; None takes it from the system.

    Returns:
        Exit status: 0, 1 for a failed check, 2 for the user's mistake, 130 when interrupted.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before anything loads torch
    words = list(sys.argv[1:] if argv is None else argv)
    command = _parser().parse_args(words[:1]).command
    from .errors import UserError

    try:
        return _run(command, words[1:])
    except UserError as error:
        print(f"rendezvous {command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"rendezvous {command}: interrupted; no file is half written", file=sys.stderr)
        return 130


def _run(command: str, flags: Sequence[str]) -> int:
    import tyro

    module = import_module(f"train.{COMMANDS[command][0]}")
    config = tyro.cli(module.Config, prog=f"rendezvous {command}", args=flags)
    return int(module.run(config) or 0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rendezvous",
        description="Bearing-only multi-robot rendezvous.",
        epilog="rendezvous COMMAND --help lists the flags of a command.",
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (_, line) in COMMANDS.items():
        commands.add_parser(name, help=line, add_help=False)
    return parser


if __name__ == "__main__":
    sys.exit(main())
