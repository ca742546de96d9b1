"""Figures of ``compare`` and ``reproduce``. The drawing library is imported when one is made.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.geometry import ABSENT, CENTRE, COUNT, RADIUS
from rendezvous_env.scenario import Scenario

from .recording import Recording
from .results import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, VERMILLION, GREEN, BLACK = "#0072B2", "#D55E00", "#009E73", "#000000"
ORANGE = "#E69F00"
"""Of obstacles, as in the paper."""
ROBOT_COLOURS = (BLUE, VERMILLION, GREEN, "#CC79A7", "#56B4E9", "#F0E442", BLACK)
_DPI = 150


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png")


def _new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches that no window system has to show."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


# ---- compare ------------------------------------------------------------------------------------


def success_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Success and clean success of every policy, one panel for each scenario.

    Args:
        rows: of results.csv.
    """

    def draw(axes: Axes, panel: Sequence[Mapping[str, Any]]) -> None:
        _intervals(axes, panel, "success", "success", -0.16, BLUE, "o", "success")
        _intervals(axes, panel, "clean_success", "clean", 0.16, VERMILLION, "D", "without contact")
        axes.set_xlim(-0.04, 1.04)

    return _panels(rows, draw, "fraction of starts, with 95 % interval")


def time_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Median rendezvous times of the policies that meet, one panel for each scenario.

    Args:
        rows: of results.csv.
    """

    def draw(axes: Axes, panel: Sequence[Mapping[str, Any]]) -> None:
        met = [row for row in panel if row["success"] > 0.5]
        _intervals(axes, met, "median_time", "time", 0.0, BLUE, "o", "median")
        for row in panel:
            if row not in met:
                axes.text(
                    0.02,
                    row["place"],
                    "more than half time out",
                    transform=axes.get_yaxis_transform(),
                    va="center",
                    fontsize=7,
                    color="0.4",
                )
        axes.set_xlim(0, 1.15 * max([row["time_high"] for row in met], default=1.0))

    return _panels(rows, draw, "median rendezvous time / s, with 95 % interval")


def _panels(rows: Sequence[Mapping[str, Any]], draw: Any, label: str) -> Figure:
    """A grid with one panel for each scenario and one line for each of its policies."""
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    columns = min(4, len(names))
    grid_rows = math.ceil(len(names) / columns)
    figure = _new_figure(max(4.5, 3.4 * columns), 0.7 + 2.3 * grid_rows)
    for number, name in enumerate(names):
        axes = figure.add_subplot(grid_rows, columns, number + 1)
        panel = [dict(row) for row in rows if row["scenario"] == name]
        for place, row in enumerate(panel):
            row["place"] = place
        draw(axes, panel)
        axes.set_title(name, fontsize=9)
        axes.set_yticks(range(len(panel)), [row["policy"] for row in panel], fontsize=7)
        axes.set_ylim(len(panel) - 0.5, -0.5)
        axes.tick_params(axis="x", labelsize=7)
        axes.grid(axis="x", color="0.9")
    figure.supxlabel(label, fontsize=9)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    return figure


def _intervals(
    axes: Axes,
    rows: Sequence[Mapping[str, Any]],
    value: str,
    interval: str,
    shift: float,
    colour: str,
    marker: str,
    label: str,
) -> None:
    """A marker with a horizontal interval for each row, ``shift`` below its line."""
    centre = np.array([row[value] for row in rows], dtype=float)
    low = np.array([row[f"{interval}_low"] for row in rows], dtype=float)
    high = np.array([row[f"{interval}_high"] for row in rows], dtype=float)
    axes.errorbar(
        centre,
        np.array([row["place"] for row in rows], dtype=float) + shift,
        xerr=np.maximum(0.0, [centre - low, high - centre]),
        fmt=marker,
        color=colour,
        markersize=4,
        linewidth=1.2,
        label=label,
        clip_on=False,
    )


def trajectories_figure(scenario: Scenario, recordings: Mapping[str, Recording]) -> Figure:
    """What every policy does on the same start, one panel for each.

    Args:
        scenario: two-dimensional.
        recordings: by policy.
    """
    columns = min(3, len(recordings))
    rows = math.ceil(len(recordings) / columns)
    figure = _new_figure(3.4 * columns, 0.5 + 3.4 * rows)
    for number, (name, recording) in enumerate(recordings.items()):
        axes = figure.add_subplot(rows, columns, number + 1)
        draw_paths(axes, recording["positions"], recording["active"], recording["obstacles"])
        met = recording["active"][-1].sum() == 1
        end = f"met after {recording['times'][-1]:.1f} s" if met else "time out"
        contacts = int(recording["contacts"][-1].sum())
        touched = f", {contacts} contacts" if contacts else ""
        axes.set_title(f"{name}\n{end}{touched}", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.suptitle(f"{scenario.name}: the same start under each policy (x and y in m)", fontsize=9)
    return figure


# ---- one team -----------------------------------------------------------------------------------


def draw_paths(
    axes: Axes,
    positions: NDArray[np.float64],
    active: NDArray[np.bool_],
    obstacles: NDArray[np.float64],
) -> None:
    """Paths of the robots of one team among orange obstacles, in axes of equal scale.

    Filled circles are starts, crosses are merges; a robot's path ends where it merged.

    Args:
        axes: to draw in.
        positions: (T, n, 2), m.
        active: (T, n), whether the robot still exists on its own.
        obstacles: (M, width), packed as obstacles.py says.
    """
    _draw_obstacles(axes, obstacles)
    for robot in range(positions.shape[1]):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        last = int(active[:, robot].sum()) + 1  # one frame more: to where it merged
        path = positions[:last, robot]
        axes.plot(*path.T, color=colour, linewidth=1.4, zorder=3)
        axes.plot(*path[0], "o", color=colour, markersize=6, zorder=4)
    for frame, robot in np.argwhere(active[:-1] & ~active[1:]):
        axes.plot(*positions[frame + 1, robot], "x", color=BLACK, markersize=6, zorder=5)
    axes.set_aspect("equal", adjustable="box")


def _draw_obstacles(axes: Axes, obstacles: NDArray[np.float64]) -> None:
    from matplotlib.patches import Circle, Polygon

    for row in obstacles:
        if row[COUNT] == ABSENT:
            continue
        vertices = row[CENTRE + 2 : CENTRE + 2 + 2 * int(row[COUNT])].reshape(-1, 2)
        centre = (row[CENTRE], row[CENTRE + 1])
        shape = Polygon(vertices) if len(vertices) else Circle(centre, row[RADIUS])
        shape.set(facecolor=ORANGE, edgecolor="#8A5F00", linewidth=0.8, zorder=1)
        axes.add_patch(shape)


def paper_figure(scenario: Scenario, recording: Mapping[str, NDArray[Any]], policy: str) -> Figure:
    """Figures 3 and 4 of the paper: (a) paths, (b) V(t) with its jumps at merges.

    Args:
        scenario: two-dimensional.
        recording: one team with every step kept: times, positions, active, obstacles, lyapunov,
            and lyapunov_before_merge and lyapunov_after_merge of the step to each frame.
        policy: for the title.
    """
    figure = _new_figure(10.0, 4.6)
    paths, value = figure.subplots(1, 2)
    draw_paths(paths, recording["positions"], recording["active"], recording["obstacles"])
    _name_robots(paths, recording["positions"][0])
    paths.set(xlabel="x / m", ylabel="y / m", title="(a) paths: dots are starts, crosses merges")
    draw_lyapunov(value, recording)
    value.set(title="(b) Lyapunov function")
    figure.suptitle(f"{scenario.name}: {policy}")
    return figure


def _name_robots(axes: Axes, starts: NDArray[np.float64]) -> None:
    """A name above or below each start, away from where the robots go."""
    middle = starts[:, 1].mean()
    for robot, start in enumerate(starts):
        offset = (0, 13 if start[1] > middle else -13)
        axes.annotate(
            f"robot {robot}",
            start,
            offset,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
        )
    axes.margins(x=0.12, y=0.12)


def draw_lyapunov(axes: Axes, recording: Mapping[str, NDArray[Any]]) -> None:
    """V(t) of one team, the part with the merges enlarged.

    Args:
        axes: to draw in.
        recording: times, lyapunov, lyapunov_before_merge and lyapunov_after_merge, each (T,).
    """
    times, before = recording["times"], recording["lyapunov_before_merge"]
    merges = np.flatnonzero(~np.isnan(before))
    _plot_lyapunov(axes, recording, merges)
    axes.set(xlabel="time / s", ylabel="V / (m²/s)", ylim=(0, None), xlim=(0, times[-1] * 1.03))
    if merges.size:
        axes.legend(loc="lower left", frameon=False)
        inset = axes.inset_axes((0.56, 0.52, 0.41, 0.43))
        _plot_lyapunov(inset, recording, merges)
        span = times[-1] - times[merges[0]] + 0.06 * times[-1]
        inset.set(xlim=(times[-1] - span, times[-1] + 0.1 * span))
        inset.set(ylim=(0, 1.4 * before[merges].max()))
        inset.set_title("the merges, enlarged", fontsize=8)
        inset.tick_params(labelsize=7)
        axes.indicate_inset_zoom(inset, edgecolor="0.5")


def _plot_lyapunov(
    axes: Axes, recording: Mapping[str, NDArray[Any]], merges: NDArray[np.int64]
) -> None:
    """V(t); every merge is a dashed vertical line from V before it to V after it."""
    times, lyapunov = recording["times"], recording["lyapunov"]
    before, after = recording["lyapunov_before_merge"], recording["lyapunov_after_merge"]
    for first, last in zip([0, *merges], [*merges, len(times) - 1], strict=True):
        stretch = lyapunov[first : last + 1].copy()
        if first in merges:
            stretch[0] = after[first]
        if last in merges:
            stretch[-1] = before[last]
        if last > first:
            axes.plot(times[first : last + 1], stretch, color=BLUE, linewidth=1.6)
    axes.vlines(
        times[merges],
        after[merges],
        before[merges],
        VERMILLION,
        (0, (2, 1)),
        linewidth=1.8,
        label="jump at a merge",
    )
    axes.grid(color="0.92")
