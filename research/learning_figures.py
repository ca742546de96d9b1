"""Figures of docs/results.md: learning curves, and the use of stored energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rendezvous_env.simulator import Simulator
from rendezvous_env.trajectory import run
from train import results
from train.figures.figures import BLACK, BLUE, GREY, ROBOT_COLOURS, VERMILLION
from train.figures.style import COLUMN, new_figure, styled

_COLOURS = (VERMILLION, BLUE, BLACK)
_FIRST_UPDATES = 8
"""Number of omitted updates: all environments start together, so short episodes end first."""


@styled
def learning_figure(runs: Mapping[str, Path], scenario: str) -> Figure:
    """Collision-free success over decisions: held-out initial conditions, and training itself.

    Dots are greedy choices on held-out initial conditions with 95 % intervals. Thin lines are
    training episodes with exploration, on other initial conditions.

    Args:
        runs: folder with metrics.csv and evaluation.csv, by label.
        scenario: name of the scenario of the held-out initial conditions.

    Raises:
        OSError: if a file cannot be read.
    """
    figure = new_figure(COLUMN, 2.6)
    axes = figure.add_subplot()
    for colour, (name, folder) in zip(_COLOURS * len(runs), runs.items(), strict=False):
        metrics = results.read_csv(folder / "metrics.csv")
        steps, share = _columns(metrics[_FIRST_UPDATES:], "collision_free_success")
        axes.plot(steps, 100 * share, color=colour, linewidth=0.6, alpha=0.5)
        evaluated = results.read_csv(folder / "evaluation.csv")
        _draw_held_out(
            axes, [row for row in evaluated if row["scenario"] == scenario], colour, name
        )
    axes.plot([], [], color=GREY, linewidth=0.6, label="training episodes")
    axes.set(xlabel="decisions (million)", ylabel="collision-free success (%)", ylim=(None, 100.5))
    axes.grid()
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _columns(
    rows: Sequence[Mapping[str, str]], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (
        np.array([float(row["step"]) for row in rows]) / 1e6,
        np.array([float(row[name] or "nan") for row in rows]),
    )


def _draw_held_out(axes: Axes, rows: Sequence[Mapping[str, str]], colour: str, name: str) -> None:
    steps, share = _columns(rows, "collision_free_success")
    low, high = (_columns(rows, end)[1] for end in ("collision_free_low", "collision_free_high"))
    spread = 100 * np.stack([share - low, high - share])
    axes.errorbar(
        steps, 100 * share, spread, color=colour, fmt="o-", markersize=3, elinewidth=0.8, label=name
    )


@styled
def tank_figure(
    times: NDArray[np.float64],
    lyapunov: NDArray[np.float64],
    levels: NDArray[np.float64],
    active: NDArray[np.bool_],
) -> Figure:
    """V of a team, and the stored energy of each robot's tank, over time.

    Args:
        times: (T,), s.
        lyapunov: V, (T,), m²/s.
        levels: A, (T, n), m²/s.
        active: (T, n), whether robots are active.
    """
    figure = new_figure(COLUMN, 3.6)
    above, below = figure.subplots(2, 1, sharex=True)
    total = lyapunov + np.where(active, levels, 0.0).sum(axis=1)
    above.plot(times, total, color=GREY, label="V + ΣA, which does not rise")
    above.plot(times, lyapunov, color=BLUE, label="V")
    above.set(ylabel="V (m²/s)", ylim=(0, None))
    for robot in range(levels.shape[1]):
        shown = np.where(active[:, robot], levels[:, robot], np.nan)
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        below.plot(times, shown, color=colour, label=f"robot {robot}")
    below.set(xlabel="time (s)", ylabel="stored energy A (m²/s)", ylim=(0, None))
    for axes in (above, below):
        axes.grid()
        axes.legend()
    return figure


def watch_tanks(scenario: Any, policy: Any, seed: int) -> dict[str, NDArray[Any]]:
    """Run one episode of a policy with tanks; returns arguments of ``tank_figure``, contacts (T,).

    Args:
        scenario: the experiment.
        policy: a policy with ``levels``, (..., n).
        seed: seed of the initial condition.
    """
    simulator = Simulator(scenario, 1)
    observations = simulator.reset(seed)
    rows: list[tuple[Any, ...]] = []
    for _ in run(simulator, policy, observations):
        contacts = int(simulator.contacts[0].sum())
        now = simulator.time[0], simulator.lyapunov()[0], policy.levels[0], simulator.active[0]
        rows.append((*map(np.copy, now), contacts))
    names = ("times", "lyapunov", "levels", "active", "contacts")
    return {
        name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)
    }
