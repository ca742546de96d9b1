"""Checkpoints of a run: its state as named arrays, written atomically.

``baselines.learned.checkpoints`` reads them.
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rendezvous_env.baselines.learned import checkpoints
from rendezvous_env.baselines.learned.checkpoints import CheckpointError
from rendezvous_env.baselines.learned.plain_data import check_types, digest_of_rest, entry

from rendezvous_env.engine.state_checks import check_entries
from rendezvous_env.scenario.scenario import Scenario

from .. import results
from ..checks import UserError
from ..console import Console
from .settings import CONFIG, Config, check, read_config, resumed, same_run

STATE_FILES = ("network", "optimizer", "state")
"""Files of a checkpoint from which training can resume."""
_DESCRIPTION = {"step": int, "stage": int, "updates": int, "wall_s": float, "written": str}
KEPT = 2
"""Number of checkpoints kept on disk."""

Tables = Mapping[str, Mapping[str, NDArray[Any]]]


def write(run: Path, step: int, description: Mapping[str, Any], tables: Tables) -> Path:
    """Write a checkpoint ``step-…`` in the folder of a run and remove outdated ones.

    It consists of a description as plain data and of named arrays per file (name without suffix).
    """
    folder = run / checkpoints.FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / f"step-{step:012d}"
    write_folder(place, description, tables)
    results.write_json(folder / checkpoints.POINTER, {"checkpoint": place.name})
    _sync(folder)
    for old in sorted(folder.glob("step-*"))[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return place


def write_folder(place: Path, description: Mapping[str, Any], tables: Tables) -> None:
    """Write one checkpoint atomically, replacing an older one of the same name."""
    from safetensors.numpy import save

    for left in place.parent.glob(".*.part"):
        shutil.rmtree(left, ignore_errors=True)
    contents = {
        f"{name}.safetensors": save({k: np.ascontiguousarray(v) for k, v in arrays.items()})
        for name, arrays in tables.items()
    }
    files = {name: entry(content) for name, content in contents.items()}
    about = {"format_version": checkpoints.FORMAT_VERSION, **description, "files": files}
    about["sha256"] = digest_of_rest(about)
    contents[checkpoints.DESCRIPTION] = (json.dumps(about, indent=2) + "\n").encode()
    with results.atomic(place) as temporary:
        temporary.mkdir()
        for name, content in contents.items():
            with (temporary / name).open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        _sync(temporary)


def _sync(folder: Path) -> None:
    """Flush the directory entries of a folder to disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flatten(state: Mapping[Any, Any], prefix: str = "") -> dict[str, NDArray[Any]]:
    """Nested arrays and tensors under names with slashes."""
    flat: dict[str, NDArray[Any]] = {}
    for key, value in state.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}/")
        else:
            is_tensor = isinstance(value, torch.Tensor)
            flat[f"{prefix}{key}"] = value.cpu().numpy() if is_tensor else np.asarray(value)
    return flat


def unflatten(flat: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The inverse of ``flatten``, with arrays."""
    state: dict[str, Any] = {}
    for name, value in flat.items():
        *path, last = name.split("/")
        place = state
        for key in path:
            place = place.setdefault(key, {})
        place[last] = value
    return state


def tensors(arrays: Mapping[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    """Arrays as tensors that share their memory."""
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def check_fits(state: Mapping[str, Any], robots: Any, policy: Any) -> None:
    """Validate a checkpoint before it is used.

    Raises:
        ValueError: for a wrong shape of the last step or the optimizer state, or a weight that is
            not finite.
    """
    slots = robots.num_envs
    seen = np.empty((slots, *robots.observation_space.shape), np.float32)
    check_entries({"last_observations": seen, "last_episode_starts": np.empty(slots, bool)}, state)
    for weights in policy.parameters():
        if not torch.isfinite(weights).all():
            raise ValueError("a weight of the network is not finite")
        moments = policy.optimizer.state.get(weights, {})
        for name in ("exp_avg", "exp_avg_sq"):
            if name in moments and moments[name].shape != weights.shape:
                raise ValueError(f"{name} of the optimizer has shape {moments[name].shape}")


def random_state() -> dict[str, NDArray[Any]]:
    """State of NumPy's global generator, which shuffles samples, and torch's, which explores."""
    _, keys, position, has_gauss, gauss = np.random.get_state()
    return {
        "numpy_keys": np.asarray(keys),
        "numpy_position": np.array([position, has_gauss]),
        "numpy_gauss": np.array([gauss]),
        "torch": torch.get_rng_state().numpy(),
    }


def restore_random(state: Mapping[str, NDArray[Any]]) -> None:
    """Restore a state of ``random_state``."""
    position, has_gauss = (int(value) for value in state["numpy_position"])
    gauss = float(state["numpy_gauss"][0])
    np.random.set_state(("MT19937", state["numpy_keys"], position, has_gauss, gauss))
    torch.set_rng_state(torch.from_numpy(state["torch"]))


def where_to_begin(config: Config, console: Console) -> tuple[Config, Path | None]:
    """Settings in force and the checkpoint to start from; None starts at step 0."""
    if (folder := config.resume) is None:
        return config, None
    config = resumed(config, read_config(folder))
    check(config)
    place = _newest_good(folder, console)
    if place is None:
        console.print(f"{folder} has no checkpoint yet: begins at step 0")
        return config, None
    about = checkpoints.describe(place)
    try:
        check_types(about, _DESCRIPTION)
        own = Config.from_plain(about["config"])
        trained = Scenario.from_plain(about["scenario"])
    except (KeyError, TypeError, ValueError, UserError) as error:
        raise CheckpointError(f"{place}: is not a checkpoint of a run: {error}") from error
    if not same_run(config, own):
        raise UserError(f"--resume {folder}: {place} belongs to another run than {CONFIG}")
    now, names = config.base_scenario(), [field.name for field in fields(Scenario)]
    if other := [name for name in names if getattr(now, name) != getattr(trained, name)]:
        raise UserError(
            f"--resume {folder}: scenario {config.scenario} has changed since {place}: "
            f"other {', '.join(other)}; restore it, or begin a new run"
        )
    console.print(f"resumes {place} at step {about['step']:,}, written {about['written']}")
    return config, place


def _newest_good(folder: Path, console: Console) -> Path | None:
    """Newest readable checkpoint, with a message about unreadable ones; None if there is none."""
    wrong = None
    for place in checkpoints.candidates(folder):
        try:
            checkpoints.read(place, STATE_FILES)
        except CheckpointError as error:
            wrong = wrong or error
            console.print(f"{error}; skipped")
        else:
            return place
    if wrong is not None:
        raise wrong
    return None


def write_failure(folder: Path, error: OSError) -> str:
    """Message about a failed write that names the last valid checkpoint."""
    file = error.filename2 or error.filename or folder  # the first name of a renaming is temporary
    said = f"cannot write {file}: {error.strerror or error}"
    try:
        place = checkpoints.find(folder)
    except CheckpointError:
        return f"{said}; there is no checkpoint yet"
    remedy = f"fix the error, then --resume {folder}"
    return f"{said}; the last valid checkpoint is {place}: {remedy}"
