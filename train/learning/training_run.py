"""A training run from its beginning, or from where it was stopped, to its end."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from rendezvous_env.engine.threads import available_cores

from .. import results
from ..errors import UserError
from ..learned import checkpoints
from ..learned.checkpoints import CheckpointError
from .ppo import Config, resumed, same_run
from .training import STATE_FILES, Training

_CONFIG = "config.json"
"""In the folder of a run: its settings."""


def run(config: Config) -> int:
    """Begin or resume a run and train to its end; see ``ppo.run``."""
    console = Console(soft_wrap=True)
    threads = torch.get_num_threads()
    try:
        config, place = _prepare(config, console)
        torch.set_num_threads(config.num_threads or available_cores())
        training = Training(config)
        step = training.restore(place) if place else training.begin()
        with _stops(console) as stop:
            return _loop(training, step, stop, console)
    except CheckpointError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(_write_failure(config, error)) from error
    finally:
        torch.set_num_threads(threads)


# ---- where to begin -----------------------------------------------------------------------------


def _prepare(config: Config, console: Console) -> tuple[Config, Path | None]:
    """The settings that hold, and the checkpoint to begin with; None begins at step 0.

    Raises:
        UserError: if the folder holds a run already, holds none to resume, or cannot be written.
    """
    if config.resume is not None:
        results.prepare_folder(config.resume)
        return _stored(config, config.resume, console)
    results.prepare_folder(config.out)
    if checkpoints.candidates(config.out):
        raise UserError(f"--out {config.out} holds a run; --resume it, or choose another folder")
    results.write_json(config.out / _CONFIG, config.to_plain())
    return config, None


def _stored(config: Config, folder: Path, console: Console) -> tuple[Config, Path | None]:
    """The settings of the run to resume, and its newest checkpoint that can be read.

    Raises:
        UserError: if there is no run, or a flag contradicts it.
        CheckpointError: if none of its checkpoints is good.
    """
    try:
        plain = json.loads((folder / _CONFIG).read_text(encoding="utf-8"))
        config = resumed(config, Config.from_plain(plain))
    except (OSError, ValueError) as error:
        raise UserError(f"--resume {folder}: it holds no run that can go on: {error}") from error
    results.write_json(folder / _CONFIG, config.to_plain())
    place = _newest_good(folder, console)
    if place is None:
        console.print(f"{folder} has no checkpoint yet: begins at step 0")
        return config, None
    about = checkpoints.describe(place)
    if not same_run(config, Config.from_plain(about["config"])):
        raise UserError(f"--resume {folder}: {place} is of another run than {_CONFIG} tells of")
    console.print(f"resumes {place} at step {about['step']:,}, written {about['written']}")
    return config, place


def _newest_good(folder: Path, console: Console) -> Path | None:
    """The newest checkpoint that can be read, with a word about those that cannot."""
    wrong = None
    for place in checkpoints.candidates(folder):
        try:
            checkpoints.read(place, STATE_FILES)
        except CheckpointError as error:
            wrong = wrong or error
            console.print(f"{error}; left out")
        else:
            return place
    if wrong is not None:
        raise wrong
    return None


def _write_failure(config: Config, error: OSError) -> str:
    said = f"cannot write {error.filename or config.out}: {error.strerror or error}"
    try:
        place = checkpoints.find(config.out)
    except CheckpointError:
        return f"{said}; there is no checkpoint yet"
    return f"{said}; the last good checkpoint is {place}: make room, then --resume {config.out}"


# ---- the loop -----------------------------------------------------------------------------------


class _Stop:
    """Which signal asked the run to stop, if one did."""

    signal: int | None = None


@contextmanager
def _stops(console: Console) -> Iterator[_Stop]:
    """SIGINT and SIGTERM ask for an end after the update; a second one ends at once."""
    stop = _Stop()

    def ask(number: int, frame: Any) -> None:
        if stop.signal is not None:
            raise KeyboardInterrupt
        stop.signal = number
        console.print("stops after this update and its checkpoint; once more leaves at once")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _loop(training: Training, step: int, stop: _Stop, console: Console) -> int:
    config = training.config
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=config.total_steps, completed=step)
        while step < config.total_steps and stop.signal is None:
            before, step = step, training.update()
            row = training.report()
            progress.update(bar, completed=step, description=_line(row))
            last = step >= config.total_steps
            if config.eval_every and (last or _crosses(config.eval_every, before, step)):
                for result in training.evaluate():
                    console.print(_evaluation_line(result))
            if last or stop.signal or _crosses(config.checkpoint_every, before, step):
                place = training.save()
                console.print(f"{_line(row)} · {place.name}")
    training.close()
    if stop.signal and step < config.total_steps:
        console.print(f"stopped at step {step:,}; rendezvous train --resume {config.out} goes on")
        return 128 + stop.signal
    console.print(f"done: {step:,} steps; {training.speed()}")
    return 0


def _crosses(every: int, before: int, step: int) -> bool:
    return step // every > before // every


def _line(row: Mapping[str, Any]) -> str:
    if not row["episodes"]:
        return f"step {row['step'] / 1e6:.2f} M · no episode has ended in this update"
    return (
        f"step {row['step'] / 1e6:.2f} M · met {100 * row['success']:.0f} % · cleanly "
        f"{100 * row['clean_success']:.0f} % · {row['median_time']:.1f} s · alignment "
        f"{row['alignment']:.2f} · {row['steps_per_s']:.0f} steps/s"
    )


def _evaluation_line(row: Mapping[str, Any]) -> str:
    return (
        f"[bold]{row['scenario']}[/bold] met {100 * row['success']:.1f} % · cleanly "
        f"{100 * row['clean_success']:.1f} [{100 * row['clean_low']:.1f}, "
        f"{100 * row['clean_high']:.1f}] % · median {row['median_time']:.2f} s · alignment ≥ "
        f"{row['min_alignment']:.3f} · {row['episodes']} held-out starts"
    )
