"""Command line ``rendezvous``: selects the command, parses its flags and handles its errors.

Each command is a module with a frozen dataclass ``Config`` (a ``Flags``) and a function
``run(config)`` that returns the exit status. Only the module of the command is imported.
"""

import argparse
import ast
import dataclasses
import inspect
import io
import os
import sys
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module, metadata
from itertools import chain, pairwise
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from . import interrupts
from .checks import UserError, flag, format_argument

COMMANDS = {
    "compare": (
        "compare.compare",
        "compare policies from the same initial conditions: table, files, figures",
    ),
    "train": ("learn.command", "train a policy with PPO under a safety filter; resumable"),
    "leaderboard": ("leaderboard.command", "compare learning algorithms over scenarios and seeds"),
    "list": ("listing", "list scenarios and policies, one line each"),
    "report": ("report.build", "HTML report of a comparison, with an interactive replay"),
    "export": ("export", "export a policy: one Python file, or its network as ONNX"),
    "bench": ("bench.bench", "measure the speed of the environments on this machine"),
    "render": ("figures.render", "render one episode as a video (gif, mp4) or a figure (png, pdf)"),
    "play": ("figures.play", "play an episode in a window: drag robots, drive one by keys"),
    "reproduce": ("figures.reproduce", "figures 3 and 4 of the paper; tanks, bounds and pixels"),
    "warmup": ("bench.warmup", "compile kernels in advance"),
    "sensor": ("sensors.command", "fit a sensor model to a robot log; replay logged bearings"),
    "verify": ("verify.verify", "check the theorems on random environments; status 1 on failure"),
}
"""Commands: module in ``train`` and one-line help."""
_COMPLETION = "--completion"
_WIDTH = 96
_LONGEST_LINE = 1000
"""Maximum length of a message, characters; longer ones are abbreviated in the middle."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command given as the arguments after ``rendezvous``.

    Returns:
        Exit status: 0; 1 for a failed check; 2 for invalid input or exhausted disk or memory; 130
        after Ctrl-C; 143 after SIGTERM.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before anything loads torch
    # results must not depend on the number of cores; small networks need no further threads
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # its encoding may lack ε
    words = list(sys.argv[1:] if argv is None else argv)
    parser = _parser()
    own = parser.parse_args(words[: 2 if words[:1] == [_COMPLETION] else 1])
    if own.completion:
        return _complete(own.completion)
    if (command := own.command) is None:
        parser.error("the following arguments are required: COMMAND")
    try:
        with interrupts.raised(command):
            return _run(command, words[1:])
    except UserError as error:
        return _say(command, str(error))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _say(command, f"{where}{error.strerror or error}")
    except MemoryError as error:
        return _say(command, f"not enough memory ({error or 'request too large'}); request less")
    except KeyboardInterrupt as error:
        print(interrupts.line_of(command, error), file=sys.stderr)
        return interrupts.status_of(error)
    finally:
        if argv is None:
            interrupts.leave_to_system()


def _run(command: str, flags: Sequence[str]) -> int:
    import tyro

    from .checks import check_text
    from .console import Console

    for number, word in enumerate(flags, start=1):
        check_text(f"word {number} after {command}", word)
    module = import_module(f"{__package__}.{COMMANDS[command][0]}")
    if {"-h", "--help"} & set(flags):
        Console(highlight=False).print(help_of(command, module), soft_wrap=True)
        return 0
    words = current_flags(flags, getattr(module, "FORMER_FLAGS", {}))
    with printed_renamings():
        config = tyro.cli(module.Config, prog=f"rendezvous {command}", args=words)
    return int(module.run(config) or 0)


@contextmanager
def printed_renamings() -> Iterator[None]:
    """Print warnings of deprecated policies, which Python hides from users by default."""
    with warnings.catch_warnings(record=True) as raised:
        warnings.filterwarnings("always", "policy .* is called", DeprecationWarning)
        yield
    for warning in raised:
        print(f"warning: {warning.message}", file=sys.stderr)


def current_flags(words: Sequence[str], former: Mapping[str, str]) -> list[str]:
    """Words of a command line without deprecated flags; each replacement prints a warning."""
    current = []
    for word in words:
        name, equals, value = word.partition("=")
        if new := former.get(name.replace("_", "-")):
            print(f"warning: {name} is called {new} now", file=sys.stderr)
            word = new + equals + value
        current.append(word)
    return current


def _say(command: str, what: str) -> int:
    """Print a one-line error message; returns the exit status."""
    line = " ".join(map(str.strip, what.splitlines()))
    if len(line) > _LONGEST_LINE:
        line = f"{line[: _LONGEST_LINE // 2]} … {line[-_LONGEST_LINE // 2 :]}"
    print(f"rendezvous {command}: {line}", file=sys.stderr)
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rendezvous",
        description="Bearing-only multi-robot rendezvous.",
        epilog="rendezvous COMMAND --help lists the flags of a command.",
    )
    version = "rendezvous, not installed"
    with suppress(metadata.PackageNotFoundError):
        version = f"rendezvous {metadata.version('rendezvous-env')}"
    parser.add_argument(
        "--version", action="version", version=version, help="show the version and exit"
    )
    parser.add_argument(
        _COMPLETION,
        choices=("bash", "zsh", "tcsh"),
        help='print a shell completion script: eval "$(rendezvous --completion bash)"',
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, (_, line) in COMMANDS.items():
        commands.add_parser(name, help=line, add_help=False)
    return parser


def _complete(shell: str) -> int:
    """Print the shell completion script of the commands and their flags."""
    import tyro

    configs = [
        Annotated[
            import_module(f"{__package__}.{module}").Config,
            tyro.conf.subcommand(name, prefix_name=False, description=line),
        ]
        for name, (module, line) in COMMANDS.items()
    ]
    every: Any = Union[tuple(configs)]  # noqa: UP007 - made of a list
    with suppress(SystemExit):
        tyro.cli(every, prog="rendezvous", args=["--tyro-print-completion", shell])
    return 0


def help_of(command: str, module: Any) -> str:
    """Text of ``--help``: Config docstring, EXAMPLES, and flags grouped by FLAG_GROUPS."""
    config = module.Config
    hints, told = get_type_hints(config, include_extras=True), documents(config)
    home = sys.modules[config.__module__]
    groups = getattr(home, "FLAG_GROUPS", {})
    own = {field.name: field for field in dataclasses.fields(config)}
    words = ["[FLAGS]", *(f"[{n.upper()}]" for n, field in own.items() if _is_positional(field))]
    lines = [
        f"usage: rendezvous {command} {' '.join(words)}",
        "",
        *str(inspect.getdoc(config)).split("\n"),
    ]
    if examples := getattr(home, "EXAMPLES", ()):
        lines += ["", "Examples:", *(f"  rendezvous {command} {words}" for words in examples)]
    ungrouped = [name for name in own if not any(name in names for names in groups.values())]
    for title, names in {"Flags": ungrouped, **groups}.items():
        lines += ["", f"{title}:"] if names else []
        for name in names:
            default = own[name].default
            lines.append(f"  {_flag_of(own[name], hints[name])}")
            said = told[name]
            if not isinstance(default, bool) and default not in (None, (), dataclasses.MISSING):
                said += f" Default: {format_argument(default)}."
            indent = " " * 6
            lines += textwrap.wrap(said, _WIDTH, initial_indent=indent, subsequent_indent=indent)
    return "\n".join(lines)


def documents(config: type) -> dict[str, str]:
    """Docstrings of the fields of a dataclass, inherited ones included."""
    found: dict[str, str] = {}
    for kind in reversed(config.__mro__):
        if dataclasses.is_dataclass(kind):
            (parsed,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
            for before, after in pairwise(parsed.body):  # type: ignore[attr-defined]
                if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
                    text = ast.literal_eval(after.value)
                    found[ast.unparse(before.target)] = " ".join(text.split())
    return found


def _is_positional(field: dataclasses.Field[Any]) -> bool:
    return "Positional" in str(field.type)


def flags_of(field: dataclasses.Field[Any], hint: Any) -> list[str]:
    """Names of a field on the command line: flag, aliases and negation, or a positional name."""
    if _is_positional(field):
        return [field.name.upper()]
    name = flag(field.name, hint)
    others = (getattr(one, "aliases", None) or () for one in getattr(hint, "__metadata__", ()))
    off = [f"--no-{name[2:]}"] if field.default is True else []
    return [name, *chain.from_iterable(others), *off]


def _flag_of(field: dataclasses.Field[Any], hint: Any) -> str:
    """Flag of a field with a placeholder for its value."""
    kind = hint.__origin__ if get_origin(hint) is Annotated else hint
    is_told = get_origin(kind) is Literal or not (kind is bool or _is_positional(field))
    return " ".join([", ".join(flags_of(field, hint)), *([_value_of(kind)] if is_told else [])])


def _value_of(kind: Any) -> str:
    """Placeholder for the value of a type."""
    inner = [one for one in get_args(kind) if one is not type(None)]
    if get_origin(kind) is Literal:
        return "{" + ",".join(map(str, inner)) + "}"
    if get_origin(kind) is tuple:
        if inner[-1] is Ellipsis:
            return f"{_value_of(inner[0])} [{_value_of(inner[0])} ...]"
        return " ".join(map(_value_of, inner))
    if inner:  # one of several, as X | None
        return " or ".join(dict.fromkeys(map(_value_of, inner)))
    return {int: "INTEGER", float: "NUMBER", str: "TEXT"}.get(kind, "PATH")


if __name__ == "__main__":
    sys.exit(main())
