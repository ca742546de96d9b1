"""Figures of single episodes: paths among obstacles, in the plane and in space, and V(t)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.drawing.palette import OBSTACLE_EDGE, code
from rendezvous_env.experiment.outlines import balls, outlines
from rendezvous_env.experiment.scenario import Scenario

from ..recording import Recording
from .figures import BLACK, BLUE, ORANGE, ROBOT_COLOURS, VERMILLION, new_figure, policy_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_NAMES = 8
"""Robots up to which each has its name beside its start."""
_LATE = 0.7
"""Share of an episode after which merges are so close together that they are shown enlarged."""


def trajectories_figure(scenario: Scenario, recordings: Mapping[str, Recording]) -> Figure:
    """What every policy does on the same start, one panel for each.

    Args:
        scenario: two-dimensional.
        recordings: by policy.
    """
    columns = min(3, len(recordings))
    rows = math.ceil(len(recordings) / columns)
    figure = new_figure(3.4 * columns, 0.5 + 3.4 * rows)
    for number, (name, recording) in enumerate(recordings.items()):
        axes = figure.add_subplot(rows, columns, number + 1)
        draw_paths(axes, recording["positions"], recording["active"], recording["obstacles"])
        met = recording["active"][-1].sum() == 1
        end = f"met after {recording['times'][-1]:.1f} s" if met else "time out"
        contacts = int(recording["contacts"][-1].sum())
        touched = f", {contacts} contacts" if contacts else ""
        axes.set_title(f"{name}\n{end}{touched}", fontsize=8, color=policy_colour(name))
        axes.tick_params(labelsize=7)
    figure.suptitle(f"{scenario.name}: the same start under each policy (x and y in m)", fontsize=9)
    return figure


# ---- one team -----------------------------------------------------------------------------------


def draw_paths(
    axes: Any,
    positions: NDArray[np.float64],
    active: NDArray[np.bool_],
    obstacles: NDArray[np.float64],
) -> None:
    """Paths of the robots of one team among orange obstacles, in axes of equal scale.

    Filled circles are starts, crosses are merges; a robot's path ends where it merged.

    Args:
        axes: to draw in; of three dimensions for robots in space.
        positions: (T, n, d), m.
        active: (T, n), whether the robot still exists on its own.
        obstacles: (M, width), a table of ``experiment.packing``.
    """
    flat = positions.shape[2] == 2
    (_draw_obstacles if flat else _draw_spheres)(axes, obstacles)
    for robot in range(positions.shape[1]):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        last = int(active[:, robot].sum()) + 1  # one frame more: to where it merged
        path = positions[:last, robot]
        axes.plot(*path.T, color=colour, linewidth=1.4, zorder=3)
        axes.plot(*path[:1].T, "o", color=colour, markersize=6, zorder=4)
    for frame, robot in np.argwhere(active[:-1] & ~active[1:]):
        axes.plot(*positions[frame + 1, robot][:, None], "x", color=BLACK, markersize=6, zorder=5)
    axes.set_aspect("equal", adjustable="box" if flat else "datalim")


def _draw_obstacles(axes: Axes, obstacles: NDArray[np.float64]) -> None:
    from matplotlib.patches import Circle, Polygon

    for (x, y), radius, vertices in outlines(obstacles):
        shape = Polygon(vertices) if len(vertices) else Circle((x, y), radius)
        shape.set(facecolor=ORANGE, edgecolor=code(OBSTACLE_EDGE), linewidth=0.8, zorder=1)
        axes.add_patch(shape)


def _draw_spheres(axes: Any, obstacles: NDArray[np.float64]) -> None:
    around, down = np.mgrid[0 : 2 * math.pi : 25j, 0 : math.pi : 13j]
    ball = np.stack([np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)])
    for centre, radius in balls(obstacles):
        surface = centre[:, None, None] + radius * ball
        axes.plot_surface(*surface, color=ORANGE, alpha=0.55, linewidth=0)


def team_figure(scenario: Scenario, recording: Mapping[str, NDArray[Any]], policy: str) -> Figure:
    """One episode as in figures 3 and 4 of the paper: (a) paths, (b) V(t) with its jumps at merges.

    Args:
        scenario: in the plane or in space.
        recording: one team with every step kept: times, positions, active, obstacles, lyapunov,
            and lyapunov_before_merge and lyapunov_after_merge of the step to each frame.
        policy: for the title.
    """
    figure = new_figure(10.0, 4.6)
    space = scenario.dim == 3
    paths = figure.add_subplot(1, 2, 1, projection="3d" if space else None)
    value = figure.add_subplot(1, 2, 2)
    if space:
        paths.locator_params(nbins=5)  # before the scales are made equal, which it undoes
    draw_paths(paths, recording["positions"], recording["active"], recording["obstacles"])
    paths.set(xlabel="x / m", ylabel="y / m", title="(a) paths: dots are starts, crosses merges")
    if space:
        paths.set(zlabel="z / m")
    elif scenario.n_robots <= _MOST_NAMES:
        _name_robots(paths, recording["positions"][0])
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
    if merges.size and times[merges[0]] > _LATE * times[-1]:
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
