"""A training run from its beginning, or from where it was stopped, to its end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from baselines.learned import checkpoints, plain_data
from baselines.learned.checkpoints import CheckpointError
from baselines.learned.plain_data import check_types
from rendezvous_env.engine.pool.threads import available_cores

from .. import folders, interrupts
from ..errors import UserError
from .run_result import OnUpdate, Result, Row, read_evaluations
from .settings import Config
from .settings_checks import check, resumed, same_run
from .training import CONFIG, STATE_FILES, Training

_DESCRIPTION = {"step": int, "stage": int, "updates": int, "wall_s": float, "written": str}
"""Of a checkpoint: what a run needs to go on."""


def run(config: Config, on_update: OnUpdate | None = None) -> Result:
    """Begin or resume a run and train to its end; see ``ppo.run``."""
    console = Console(soft_wrap=True)
    threads = torch.get_num_threads()
    folder = config.resume or config.out
    try:
        with interrupts.raised("train"), _own(config, folder):
            config, place = _prepare(config, console)
            _check_device(config.device)
            torch.set_num_threads(config.num_threads or available_cores())
            training = Training(config)
            step = training.restore(place) if place else training.begin()
            return _loop(training, step, console, on_update or _goes_on)
    except CheckpointError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(_write_failure(folder, error)) from error
    finally:
        torch.set_num_threads(threads)


# ---- where to begin -----------------------------------------------------------------------------


@contextmanager
def _own(config: Config, folder: Path) -> Iterator[None]:
    """The folder of a run, for this process alone.

    Raises:
        UserError: if there is no run to resume, another process has it, or it cannot be written.
    """
    if config.resume is not None:
        _read_config(folder)  # so that nothing is made where no run is
    elif checkpoints.candidates(folder):
        raise UserError(f"--out {folder} holds a run; --resume it, or choose another folder")
    with folders.made(folder), folders.held(folder / ".lock", str(folder)):
        yield


def _read_config(folder: Path) -> Config:
    try:
        return Config.from_plain(plain_data.read_json(folder / CONFIG))
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        what = f"{folder / CONFIG}: {said}"
        raise UserError(f"--resume {folder}: it holds no run that can go on: {what}") from error


def _prepare(config: Config, console: Console) -> tuple[Config, Path | None]:
    """The settings that hold, and the checkpoint to begin with; None begins at step 0.

    Raises:
        UserError: if a flag contradicts the run to resume.
        CheckpointError: if none of its checkpoints is good.
    """
    if config.resume is None:
        return config, None
    folder = config.resume
    config = resumed(config, _read_config(folder))
    check(config)
    place = _newest_good(folder, console)
    if place is None:
        console.print(f"{folder} has no checkpoint yet: begins at step 0")
        return config, None
    about = checkpoints.describe(place)
    if not same_run(config, _config_of(place, about)):
        raise UserError(f"--resume {folder}: {place} is of another run than {CONFIG} tells of")
    console.print(f"resumes {place} at step {about['step']:,}, written {about['written']}")
    return config, place


def _config_of(place: Path, about: Mapping[str, Any]) -> Config:
    try:
        check_types(about, _DESCRIPTION)
        return Config.from_plain(about["config"])
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{place}: is no checkpoint of a run: {error}") from error


def _check_device(device: str) -> None:
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        said = str(error).partition("\n")[0]
        raise UserError(f"--device is {device!r}: {said}; cpu is always there") from error


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


def _write_failure(folder: Path, error: OSError) -> str:
    said = f"cannot write {error.filename or folder}: {error.strerror or error}"
    try:
        place = checkpoints.find(folder)
    except CheckpointError:
        return f"{said}; there is no checkpoint yet"
    return f"{said}; the last good checkpoint is {place}: make room, then --resume {folder}"


# ---- the loop -----------------------------------------------------------------------------------


def _goes_on(update: int, metrics: Row) -> bool:
    return False


def _loop(training: Training, step: int, console: Console, on_update: OnUpdate) -> Result:
    """Train to the end, until a signal, or until ``on_update`` ends it; what is kept then is the
    state after the last update.
    """
    config, kept = training.config, training.snapshot()
    metrics: dict[str, Any] = {}
    status, stopped, saved = 0, False, True
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    try:
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task("", total=config.total_steps, completed=step)
            while step < config.total_steps and not stopped:
                before, step = step, training.update()
                row = training.report()
                progress.update(bar, completed=step, description=_line(row))
                last, evaluation = step >= config.total_steps, []
                if config.eval_every and (last or _crosses(config.eval_every, before, step)):
                    evaluation = training.evaluate()
                    for result in evaluation:
                        console.print(_evaluation_line(result))
                kept, metrics, saved = training.snapshot(), row, False
                if last or _crosses(config.checkpoint_every, before, step):
                    place, saved = training.save(kept), True
                    console.print(f"{_line(row)} · {place.name}")
                stopped = on_update(row["update"], row | {"evaluation": evaluation}) is True
    except KeyboardInterrupt as error:
        training.save(kept)  # rows of later steps are cut off when the run goes on
        step = kept[0]["step"]
        console.print(f"stopped at step {step:,}; rendezvous train --resume {config.out} goes on")
        status = interrupts.status_of(error)
    else:
        if not saved:
            training.save(kept)
        said = "stopped by on_update" if stopped else "done"
        console.print(f"{said}: {step:,} steps; {training.speed()}")
    finally:
        training.close()
    evaluations = read_evaluations(config.out / "evaluation.csv", step)
    return Result(config.out, status, stopped, step, metrics, evaluations)


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
