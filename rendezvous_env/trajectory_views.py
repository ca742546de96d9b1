"""Presentation of trajectories: one line, a table, figures, an HTML page, files."""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, fields
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .checks import check_int, counted, load, raise_invalid
from .scenario.scenario import Scenario

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

_FIGURES = "rendezvous_env.train.figures.path_figures"
_PAGES = "rendezvous_env.train.report.rollout_page"
"""Modules of the package above this one that draw; imported on use."""
_SHOWN = 10
"""Number of printed table rows, if the table has at least two more."""
_FORMAT = 1
"""File format version."""
_KEPT, _START, _TOLD = "recorded/", "start/", "conditions/"
"""Prefixes in a file of recorded quantities, of the state after the reset, and of conditions."""


@dataclass(frozen=True)
class Summary:
    """Table with one row per environment of a rollout, also for notebooks."""

    rows: tuple[dict[str, Any], ...]
    """Columns by name: ``env``; ``outcome``, "met" or "time limit"; ``time`` of rendezvous or of
    the limit, s; ``merges``; ``contacts``, one per robot and step; ``collision_free``;
    ``path_length`` of all robots, m; ``initial_lyapunov`` and ``largest_rise`` of V between
    merges, m²/s; ``return``, the sum of rewards."""

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def to_dataframe(self) -> pandas.DataFrame:
        """Rows as a pandas DataFrame; an ImportError gives the command to install pandas."""
        return load("pandas", "to_dataframe()", "analysis").DataFrame(list(self.rows))

    def __str__(self) -> str:
        head, *rows = self._cells()
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        lines = [
            "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
            for line in (head, *rows)
        ]
        lines.insert(1, "  ".join("-" * width for width in widths))
        return "\n".join([*lines, *self._left_out(), self._in_all()])

    def to_html(self) -> str:
        """Table as HTML, for notebooks."""
        head, *rows = ([f"<td>{escape(cell)}</td>" for cell in line] for line in self._cells())
        body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
        first = "".join(head).replace("td>", "th>")
        below = "".join(f"<p>{escape(line)}</p>" for line in (*self._left_out(), self._in_all()))
        return f"<table><thead><tr>{first}</tr></thead><tbody>{body}</tbody></table>{below}"

    __repr__ = __str__
    _repr_html_ = to_html

    @property
    def _few(self) -> tuple[dict[str, Any], ...]:
        return self.rows if len(self.rows) <= _SHOWN + 2 else self.rows[:_SHOWN]

    def _left_out(self) -> list[str]:
        left = len(self.rows) - len(self._few)
        return [f"… and {left} environments more"] if left else []

    def _cells(self) -> list[list[str]]:
        units = {
            "time": "s",
            "path_length": "m",
            "initial_lyapunov": "m²/s",
            "largest_rise": "m²/s",
        }
        words = {"initial_lyapunov": "V(0)", "largest_rise": "largest rise of V"}
        head = [
            words.get(name, name.replace("_", " ")) + (f" ({units[name]})" if name in units else "")
            for name in self.rows[0]
        ]
        return [head, *([_cell(value) for value in row.values()] for row in self._few)]

    def _in_all(self) -> str:
        count = len(self.rows)
        met = [row["time"] for row in self.rows if row["outcome"] == "met"]
        free = sum(row["collision_free"] and row["outcome"] == "met" for row in self.rows)
        median = f", median time {float(np.median(met)):.3g} s" if met else ""
        return f"{len(met)} of {count} met, {free} of {count} met collision-free{median}"


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "–" if math.isinf(value) else f"{value:.4g}"
    return str(value)


def one_line(trajectory: Any) -> str:
    """Scenario, policy, duration and outcome, on one line."""
    scenario, recorded, policy = trajectory.scenario, trajectory.recorded, trajectory.policy
    count, met = trajectory.num_envs, int(trajectory.success.sum())
    ended = "met" if met else "did not meet"
    if count > 1:
        ended = f"{met} of {count} met"
    free = int(trajectory.collision_free_success.sum())
    if scenario.obstacles:
        ended += f", {free} collision-free" if count > 1 else ", collision-free" * free
    kept = f", recorded: {', '.join(recorded)}" if recorded else ""
    under = f" under {policy}" if policy else ""
    return (
        f"<Trajectory of {scenario.name!r}{under}: "
        f"{counted(count, 'environment')}, {trajectory.positions.shape[2]} robots, "
        f"{counted(len(trajectory.times) - 1, 'step')}, "
        f"{float(trajectory.times[-1]):.4g} s; {ended}{kept}>"
    )


def summary(trajectory: Any) -> Summary:
    """Table of outcome, time, merges, contacts, path length, V and return per environment."""
    success, active = trajectory.success, trajectory.active
    moved = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=-1)
    columns = {
        "env": np.arange(trajectory.num_envs),
        "outcome": np.where(success, "met", "time limit"),
        "time": np.where(success, trajectory.rendezvous_time, trajectory.times[-1]),
        "merges": (active[:-1] & ~active[1:]).sum(axis=(0, 2)),
        "contacts": trajectory.contacts.sum(axis=(0, 2)),
        "collision_free": trajectory.collision_free,
        "path_length": np.where(active[:-1], moved, 0.0).sum(axis=(0, 2)),
        "initial_lyapunov": trajectory.lyapunov[0],
        "largest_rise": trajectory.largest_rise_between_merges,
        "return": np.where(trajectory.running, trajectory.rewards, 0.0).sum(axis=0),
    }
    listed = {name: column.tolist() for name, column in columns.items()}
    rows = zip(*listed.values(), strict=True)
    return Summary(tuple(dict(zip(listed, row, strict=True)) for row in rows))


def plot(trajectory: Any, env: int = 0) -> Figure:
    """Paths and V(t) of one environment, as a matplotlib Figure."""
    which = check_int("env", env, 0, trajectory.num_envs - 1)
    return import_module(_FIGURES).trajectory_figure(trajectory, which)


def plot_lyapunov(trajectory: Any, certificate: Any = None) -> Figure:
    """V(t) of all environments, as a matplotlib Figure.

    A ``Certificate`` adds its bounds on V and on the time, which no environment exceeds.

    Raises:
        ValueError: for the certificate of another scenario.
    """
    name = trajectory.scenario.name
    if certificate is not None and certificate.scenario != name:
        raise_invalid("certificate", certificate.scenario, f"of scenario {name!r}")
    return import_module(_FIGURES).lyapunov_figure(trajectory, certificate)


def to_report(trajectory: Any, path: str | os.PathLike[str] = "replay.html", envs: int = 8) -> Path:
    """Write an HTML page with an interactive replay of the first environments.

    The page needs no network. The rollout is simulated again, with its recorded actions or its
    policy.

    Args:
        trajectory: the rollout.
        path: file to write.
        envs: maximum number of environments.

    Returns:
        The path.

    Raises:
        ValueError: if the rollout is not reproducible, or neither its policy is available, as
            after ``load``, nor its actions: ``rollout(…, record="actions")``.
    """
    return import_module(_PAGES).write(trajectory, Path(path), check_int("envs", envs, 1, 10**6))


def save(trajectory: Any, path: str | os.PathLike[str]) -> Path:
    """Write everything except the policy to a compressed NumPy archive (.npz), atomically.

    Returns the path.
    """
    place = Path(path)
    arrays = {
        field.name: value
        for field in fields(trajectory)
        if isinstance(value := getattr(trajectory, field.name), np.ndarray)
    }
    arrays |= {f"{_KEPT}{name}": array for name, array in trajectory.recorded.items()}
    about = {
        "format": _FORMAT,
        "scenario": trajectory.scenario.to_plain(),
        "policy": trajectory.policy,
    }
    arrays |= {f"{_START}{name}": array for name, array in trajectory.start.items()}
    arrays |= {f"{_TOLD}{name}": array for name, array in trajectory.conditions.items()}
    arrays["about"] = np.array(json.dumps(about))
    part = place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        part.replace(place)
    finally:
        part.unlink(missing_ok=True)
    return place


def read(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fields of a saved trajectory and its arrays, by name; errors as of ``Trajectory.load``."""
    about, arrays = _read(path)
    own: dict[str, Any] = {"recorded": _taken(arrays, _KEPT), "start": _taken(arrays, _START)}
    own["conditions"] = _taken(arrays, _TOLD)
    own |= {"scenario": Scenario.from_plain(about["scenario"]), "policy": about["policy"]}
    return own, arrays


def _read(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read plain data and arrays by name; errors as of ``Trajectory.load``."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        about = json.loads(str(arrays.pop("about")[()]))
        if about["format"] != _FORMAT:
            raise ValueError(f"format {about['format']}; this version reads {_FORMAT}")
    except (ValueError, KeyError, TypeError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        why = f"it has no entry {error}" if isinstance(error, KeyError) else error
        raise ValueError(f"{path} is no trajectory: {why}; Trajectory.save writes one") from error
    return about, arrays


def _taken(arrays: dict[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """Remove arrays with a name prefix from those of a file, and return them."""
    names = [name for name in arrays if name.startswith(prefix)]
    return {name.removeprefix(prefix): arrays.pop(name) for name in names}
