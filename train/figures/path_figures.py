"""Figures of single episodes: paths among obstacles, in the plane and in 3-D, and V(t)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.obstacles.obstacle_set import outlines
from rendezvous_env.render.palette import OBSTACLE_EDGE, code
from rendezvous_env.render.scene import ended, facing, in_contact, ways
from rendezvous_env.safety.theorems.theorem import at_most
from rendezvous_env.scenario.scenario import Scenario

from ..recording import Recording
from .figures import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    ROBOT_COLOURS,
    VERMILLION,
    shown_name,
)
from .style import COLUMN, PAGE, SMALL, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rendezvous_env import Certificate, Trajectory

_MOST_NAMES = 8
"""Maximum number of robots with a number beside the initial position."""
_PATHS, _VALUE = 3.1, 2.2
"""Heights of both parts of an episode figure, inch."""
_ARROWS = 4
"""Number of headings drawn along each path."""
_LEAST_SHARE = 0.2
"""Minimum length of the shorter side of a path panel relative to the longer side."""
_NARROW = 0.6
"""Panels with a smaller aspect ratio have fewer ticks on the short side."""
_FAR = 3.0
"""Ratio of time bound and episode length from which the time axis is logarithmic."""
_DECADES = 300.0
"""Ratio of the end of an episode and the left end of a logarithmic axis."""
_JUMPS = ("lyapunov_before_merge", "lyapunov_after_merge")
_MOST_COLUMNS = 5
"""Maximum number of panels in a row."""
_LATE = 0.7
"""Fraction of an episode after which merges are close together and shown enlarged."""


@styled
def trajectories_figure(scenario: Scenario, recordings: Mapping[str, Recording]) -> Figure:
    """Paths of every policy from one initial condition of a planar scenario, one panel each."""
    columns = panel_columns(len(recordings))
    rows = math.ceil(len(recordings) / columns)
    width = COLUMN if columns < 3 else PAGE
    figure = new_figure(width, 0.5 + rows * (0.87 * width / columns + 0.3))
    grid = figure.add_gridspec(rows, 2 * columns)
    panels: list[Axes] = []
    for number, (name, recording) in enumerate(recordings.items()):
        row, column = divmod(number, columns)
        lacking = max(0, (row + 1) * columns - len(recordings))  # of the last row, in the middle
        left = 2 * column + lacking
        first = panels[0] if panels else None
        axes = figure.add_subplot(grid[row, left : left + 2], sharex=first, sharey=first)
        panels.append(axes)
        draw_paths(axes, recording, scenario)
        met = recording["active"][-1].sum() == 1
        end = f"met after {recording['times'][-1]:.1f} s" if met else "time out"
        contacts = int(recording["contacts"][-1].sum())
        touched = f"\n{in_contact(contacts)}" if contacts else ""
        axes.set_title(f"{shown_name(name)}\n{end}{touched}", fontsize=SMALL)
        axes.tick_params(length=2, labelleft=column == 0)
        axes.tick_params(labelbottom=number + columns >= len(recordings))
    wide, high = (np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim()))
    axes.locator_params(axis="x", nbins=4 if wide > _NARROW * high else 2)
    axes.locator_params(axis="y", nbins=4 if high > _NARROW * wide else 2)
    figure.supxlabel("x (m)", fontsize=8)
    figure.supylabel("y (m)", fontsize=8)
    figure.suptitle(f"{scenario.name}: paths from initial positions (dots) to merges (crosses)")
    return figure


def panel_columns(count: int) -> int:
    """Number of panels in a row: four, or three or five if that leaves fewer places free."""
    if count <= _MOST_COLUMNS:
        return count
    return min((4, 3, 5), key=lambda columns: -count % columns)


def draw_paths(axes: Any, recording: Mapping[str, NDArray[Any]], scenario: Scenario) -> None:
    """Draw the paths of the robots of one environment among orange obstacles, at equal scale.

    The axes are three-dimensional for 3-D robots. Filled circles are initial positions, crosses are
    merges; a robot's path ends where it merged. Arrows are the headings of robots that have one.
    """
    positions, active = recording["positions"], recording["active"]
    flat = scenario.dim == 2
    size = 0.1 * np.ptp(positions, axis=(0, 1)).max()
    (_draw_obstacles if flat else _draw_spheres)(axes, recording["obstacles"])
    for robot, path in enumerate(ways(positions, active)):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        axes.plot(*path.T, color=colour, zorder=3)
        axes.plot(*path[:1].T, "o", color=colour, markersize=4, zorder=4)
        if scenario.model.n_angles:
            along = size * facing(recording["headings"][: len(path), robot], scenario.dim)
            _draw_headings(axes, path, along)
    for frame, robot in ended(active):
        axes.plot(*positions[frame, robot][:, None], "x", color=BLACK, markersize=4, zorder=5)
    if flat:
        low, high = positions.min(axis=(0, 1)), positions.max(axis=(0, 1))
        lacking = np.maximum(0.0, _LEAST_SHARE * ((high - low).max() or 1.0) - (high - low)) / 2
        axes.update_datalim([low - lacking, high + lacking])
        axes.autoscale_view()
    axes.set_aspect("equal", adjustable="box" if flat else "datalim")


def _draw_headings(axes: Any, path: NDArray[np.float64], arrows: NDArray[np.float64]) -> None:
    """Arrows at the start of a path and at equal times after it, lengths in m."""
    frames = np.unique(np.linspace(0, len(path) - 1, _ARROWS + 1).astype(int)[:-1])
    where, along = path[frames], arrows[frames]
    if path.shape[1] == 3:
        axes.quiver(*where.T, *along.T, color=BLACK, linewidth=0.8, arrow_length_ratio=0.4)
        return
    for place, arrow in zip(where, along, strict=True):
        style = {"arrowstyle": "-|>", "color": BLACK, "lw": 0.7, "mutation_scale": 5}
        ends = {"shrinkA": 0, "shrinkB": 0, "zorder": 6}
        axes.annotate("", place + arrow, place, arrowprops=style | ends)


def _draw_obstacles(axes: Axes, obstacles: NDArray[np.float64]) -> None:
    from matplotlib.patches import Circle, Polygon

    for (x, y), radius, vertices in outlines(obstacles, 2):
        shape = Polygon(vertices) if len(vertices) else Circle((x, y), radius)
        shape.set(facecolor=ORANGE, edgecolor=code(OBSTACLE_EDGE), linewidth=0.8, zorder=1)
        axes.add_patch(shape)


def _draw_spheres(axes: Any, obstacles: NDArray[np.float64]) -> None:
    around, down = np.mgrid[0 : 2 * math.pi : 25j, 0 : math.pi : 13j]
    ball = np.stack([np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)])
    for centre, radius, _ in outlines(obstacles, 3):
        surface = centre[:, None, None] + radius * ball
        axes.plot_surface(*surface, color=ORANGE, alpha=0.55, linewidth=0)


@styled
def team_figure(scenario: Scenario, recording: Mapping[str, NDArray[Any]], policy: str) -> Figure:
    """Figure of one episode with all steps, as figures 3 and 4 of the paper.

    Part (a) shows the paths, part (b) V(t) and its jumps at merges.
    """
    figure = new_figure(COLUMN, _PATHS + _VALUE)
    space = scenario.dim == 3
    grid = figure.add_gridspec(2, 1, height_ratios=(_PATHS, _VALUE))
    paths: Any = figure.add_subplot(grid[0], projection="3d" if space else None)
    value = figure.add_subplot(grid[1])
    if space:
        paths.locator_params(nbins=5)  # before the scales are equalised, which it would undo
    draw_paths(paths, recording, scenario)
    arrows = ", arrows: headings" if scenario.model.n_angles else ""
    paths.set(
        xlabel="x (m)",
        ylabel="y (m)",
        title=f"(a) dots: t = 0, crosses: merges{arrows}",
    )
    if space:
        paths.set(zlabel="z (m)")
        paths.tick_params(pad=0)
        paths.set_box_aspect(None, zoom=0.85)  # its labels are outside the reserved area
    elif scenario.n_robots <= _MOST_NAMES:
        _name_robots(paths, recording)
    draw_lyapunov(value, recording)
    value.set(title="(b) the Lyapunov function")
    figure.suptitle(f"{scenario.n_robots} robots under {policy} ({scenario.name})")
    return figure


def trajectory_figure(trajectory: Trajectory, env: int = 0) -> Figure:
    """Paths and V(t) of one environment of a rollout, as ``team_figure``."""
    return team_figure(trajectory.scenario, recording_of(trajectory, env), trajectory.policy)


def recording_of(trajectory: Trajectory, env: int = 0) -> Recording:
    """Recording of one environment of a rollout, with all steps up to its end."""
    steps = int(trajectory.running[:, env].sum())
    merged = (trajectory.active[:-1, env] != trajectory.active[1:, env]).any(axis=-1)[:steps]
    kept = ("positions", "headings", "active", "lyapunov", *trajectory.recorded)
    jumps = {
        name: np.append(np.nan, np.where(merged, getattr(trajectory, name)[:steps, env], np.nan))
        for name in _JUMPS
    }
    contacts = trajectory.contacts[:steps, env]
    return {
        "times": trajectory.times[: steps + 1],
        **{name: getattr(trajectory, name)[: steps + 1, env] for name in kept if name != "actions"},
        **jumps,
        "contacts": np.cumsum(np.insert(contacts, 0, 0, axis=0), axis=0),
        "obstacles": trajectory.obstacles[env],
    }


@styled
def lyapunov_figure(trajectory: Trajectory, certificate: Certificate | None = None) -> Figure:
    """V(t) of every environment of a rollout, with the bounds of a certificate if given.

    Lines end with their episodes; a circle marks a rendezvous.
    """
    figure = new_figure(COLUMN, 2.6)
    axes = figure.subplots()
    count = trajectory.num_envs
    style: Any = {"color": BLUE, "alpha": max(0.15, count**-0.5), "linewidth": 1.0}
    for env in range(count):
        steps = int(trajectory.running[:, env].sum()) + 1
        axes.plot(trajectory.times[:steps], trajectory.lyapunov[:steps, env], **style)
    axes.lines[0].set_label("V" if count == 1 else f"V, {count} environments")
    met = np.flatnonzero(trajectory.success)
    if met.size:
        at = trajectory.rendezvous_time[met]
        mark: Any = {"color": GREEN, "clip_on": False, "zorder": 4}
        axes.plot(at, np.zeros(met.size), "o", label="rendezvous", **mark)
    axes.set(xlabel="time (s)", ylabel="V (m²/s)", xlim=(0, None))
    if certificate is not None:
        _draw_bounds(axes, certificate, float(trajectory.times[-1]))
    axes.set_ylim(0, None)
    axes.grid()
    axes.set_title(_certified(certificate) if certificate is not None else "the Lyapunov function")
    figure.legend(loc="outside lower center", ncols=2)
    figure.suptitle(f"{trajectory.scenario.name} under {trajectory.policy or 'a policy'}")
    return figure


def _draw_bounds(axes: Axes, certificate: Certificate, end: float) -> None:
    """Draw bounds on V and on the time; for a large time bound the time axis is logarithmic."""
    style: Any = {"color": VERMILLION, "linewidth": 1.2}
    if math.isfinite(bound := certificate.lyapunov_bound):
        label = f"bound on V: {at_most(bound)} m²/s"
        axes.axhline(bound, linestyle="--", label=label, **style)
    if math.isfinite(bound := certificate.time_bound):
        label = f"bound on the time: {at_most(bound)} s"
        axes.axvline(bound, linestyle=":", label=label, **style)
        if bound > _FAR * end > 0.0:
            axes.set_xscale("log")
            axes.set_xlim(end / _DECADES, 1.3 * bound)


def _certified(certificate: Certificate) -> str:
    """Short description of a certificate's guarantee."""
    return "rendezvous is certified" if certificate.guaranteed else "no rendezvous is certified"


def _name_robots(axes: Axes, recording: Mapping[str, NDArray[Any]]) -> None:
    """Write the number of each robot beside its initial position, on the side with most room."""
    positions = recording["positions"]
    away = 0.06 * np.ptp(positions, axis=(0, 1)).max()
    angles = np.arange(16) * np.pi / 8
    around = away * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    taken = positions.reshape(-1, 2)
    if recording["headings"].shape[-1]:  # the arrow at each initial position
        heads = positions[0] + away * facing(recording["headings"][0], 2)
        taken = np.concatenate([taken, heads, 2 * heads - positions[0]])
    for robot, start in enumerate(positions[0]):
        free = np.linalg.norm((start + around)[:, None] - taken, axis=-1).min(axis=1)
        place = start + around[free.argmax()]
        x, y = place.tolist()
        axes.text(x, y, str(robot), ha="center", va="center", fontsize=SMALL)
        taken = np.concatenate([taken, place[None]])
    axes.margins(x=0.18, y=0.12)


def draw_lyapunov(axes: Axes, recording: Mapping[str, NDArray[Any]]) -> None:
    """Plot V(t) of one environment, with the merges enlarged."""
    times, before = recording["times"], recording["lyapunov_before_merge"]
    merges = np.flatnonzero(~np.isnan(before))
    _plot_lyapunov(axes, recording, merges)
    axes.set(xlabel="time (s)", ylabel="V (m²/s)", ylim=(0, None), xlim=(0, times[-1] * 1.03))
    late = bool(merges.size) and times[merges[0]] > _LATE * times[-1]
    if merges.size:
        axes.legend(loc="lower left" if late else "upper right")
    if late:
        inset = axes.inset_axes((0.62, 0.56, 0.37, 0.32))
        _plot_lyapunov(inset, recording, merges)
        span = times[-1] - times[merges[0]] + 0.06 * times[-1]
        inset.set(xlim=(times[-1] - span, times[-1] + 0.1 * span))
        inset.set(ylim=(0, 1.4 * before[merges].max()))
        inset.set_title("the box, enlarged", fontsize=SMALL, pad=3)
        inset.tick_params(labelsize=SMALL - 1, length=2)
        inset.locator_params(nbins=4)
        box = axes.indicate_inset_zoom(inset, edgecolor="0.3", linewidth=0.8)
        for connector in box.connectors or ():
            connector.set_visible(False)  # it would cross V


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
            axes.plot(times[first : last + 1], stretch, color=BLUE)
    style: Any = {"linestyles": (0, (2, 1)), "linewidth": 1.4, "label": "jump at a merge"}
    axes.vlines(times[merges], after[merges], before[merges], VERMILLION, **style)
    axes.grid()
