"""Diagrams and plots of the documentation: ``python docs/building/figures.py [NAME ...]``.

Writes docs/images/NAME.png for every name of FIGURES, or for the given ones, and one thumbnail per
named scenario in docs/images/scenarios for the name ``gallery``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from diagrams import DIAGRAMS, EDGE

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.obstacles.obstacle_set import outlines
from train.figures.figures import BLACK, BLUE, GREY, ORANGE, ROBOT_COLOURS, VERMILLION
from train.figures.style import COLUMN, PAGE, new_figure, save, styled

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
THUMBNAIL = 1.5
"""Width and height of a scenario's thumbnail, inch."""
MAX_LINKS = 70
"""Thumbnails of denser graphs have no links, which would hide the robots."""
MAX_REACH = 3.0
"""Larger obstacles are cut off: half size of a thumbnail relative to the extent of the robots."""


def main() -> None:
    """Write the figures that the command line names, or all of them."""
    for name in sys.argv[1:] or [*FIGURES, "gallery"]:
        if name == "gallery":
            gallery()
        else:
            save(FIGURES[name](), IMAGES / f"{name}.png")


@styled
def bound() -> Any:
    """V of the control quickstart beside its certified bound, on two time scales."""
    scenario = rv.scenarios.get("ring-12")
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    net_bearing = scenario.observation_layout.net_bearing
    policy = baselines.HeadingPolicy(
        scenario, lambda seen: net_bearing(seen) @ turn, min_alignment=0.5
    )
    played = rv.rollout(scenario, policy, seed=0)
    given = scenario.replace(start_positions=played.positions[0, 0])
    found = rv.certificate(given, min_alignment=0.5)
    delay = (scenario.n_robots - 1) * scenario.tau
    figure = new_figure(PAGE, 2.3)
    for axes, end in zip(figure.subplots(1, 2), (played.times[-1], found.time_bound), strict=True):
        t = np.linspace(0.0, end, 500)
        falls = np.maximum(t - delay, 0.0) / (found.time_bound - delay)
        axes.plot(played.times, played.lyapunov[:, 0], color=BLUE, label="V, measured")
        axes.plot(t, found.lyapunov_bound * (1 - falls), "--", color=VERMILLION, label="bound")
        axes.set(xlabel="time (s)", ylabel="V (m²/s)", xlim=(0, end), ylim=(0, None))
        axes.grid(True)
    axes.legend()
    return figure


@styled
def tightness() -> Any:
    """Certified time bounds against measured times, from the table of docs/guarantees.md."""
    text = (ROOT / "docs" / "guarantees.md").read_text(encoding="utf-8")
    row = r"^\| ([\w, =.()ε]+?) \| ([\w-]+)" + 4 * r" \| ([\d.,]+)" + r" \| [\d.,]+ \|$"
    rows = re.findall(row, text, flags=re.MULTILINE)
    kept_by = list(dict.fromkeys(found[0] for found in rows))
    figure = new_figure(COLUMN + 1.2, 2.9)
    axes = figure.subplots()
    for k, name in enumerate(kept_by):
        points = [
            [float(x.replace(",", "")) for x in found[2:]] for found in rows if found[0] == name
        ]
        median, longest, _, own = np.array(points).T
        axes.plot(median, own, "os^Dv"[k], color=ROBOT_COLOURS[k], markersize=5, label=name)
        axes.hlines(own, median, longest, color=ROBOT_COLOURS[k], linewidth=1)
    ends = np.array([1.0, 20.0])
    axes.plot(ends, ends, color=BLACK, linewidth=0.8)
    axes.text(6.0, 2.2, "bound = measured", fontsize=8, ha="center")
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=(1, 1e5))
    axes.set(xlabel="measured time (s): median to longest", ylabel="certified bound (s)")
    axes.set_xticks([1, 2, 5, 10, 20], labels=["1", "2", "5", "10", "20"])
    powers = [10**k for k in range(6)]
    axes.set_yticks(powers, labels=[f"{power:,}" for power in powers])
    axes.grid(True)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


_GUARANTEES = {
    "none": ("o", BLACK, "no guarantee"),
    "heading": ("s", BLUE, "certified headings"),
    "tank": ("D", VERMILLION, "energy tank"),
}
"""Marker, colour and label of the learners by guarantee."""
_LABEL_PLACES = {
    "cbf": (6, -11), "heading": (-2, 8), "lagrangian": (-62, 6), "tank": (-26, 4),
}  # fmt: skip
"""Offsets of labels from their marks, points."""


@styled
def guarantee_price() -> Any:
    """Success and time of the PPO learners against rises of V, from docs/leaderboard.md."""
    from matplotlib.lines import Line2D

    text = (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    number, interval = r"([\d.]+)", r"([\d.]+) \(([\d.]+) to ([\d.]+)\)"
    row = r"^\| ppo-(\w+) \| [^|]+ \| (\w+) \| [^|]+ "
    row += rf"\| {interval} \| {interval} \| {number} \| {number} "
    figure = new_figure(PAGE, 3.0)
    panels = figure.subplots(1, 2)
    for found in re.finditer(row, text, flags=re.MULTILINE):
        name, (marker, colour, _) = found[1], _GUARANTEES[found[2]]
        values = [float(value) for value in found.groups()[2:]]
        for axes, (value, low, high) in zip(panels, (values[:3], values[3:6]), strict=True):
            bars = [[value - low], [high - value]]
            look = {"fmt": marker, "color": colour, "capsize": 2, "markersize": 5}
            axes.errorbar(values[7] / 10, value, bars, **look)
            place = _LABEL_PLACES.get(name, (6, 4))
            axes.annotate(name, (values[7] / 10, value), place, textcoords="offset points")
    panels[0].set(ylabel="collision-free success (%)", ylim=(-3, 105))
    panels[1].set(ylabel="time (s)", ylim=(0, 65))
    for axes in panels:
        axes.set(xlabel="steps in which V rose (%)", xlim=(-1, 44))
        axes.grid(True)
    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, markersize=5, label=label)
        for marker, colour, label in _GUARANTEES.values()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=8)
    return figure


CLOCKS = {
    "synchronous": {},
    "stand still, k = 4": {"hold": "stop"},
    "held commands, k = 4": {"hold": "command"},
}
"""Fields of ``clocks`` by label."""


@styled
def clocks() -> Any:
    """V under law (1), synchronous and not, at the step that held commands need and the default."""
    base = rv.Scenario(n_robots=8, graph="cycle", time_limit=15.0)
    wait = rv.Activation(kind="bounded", max_wait=4)
    figure = new_figure(PAGE, 2.3)
    steps = {"time step of Theorem E3": 0.28 * base.certified_step, "default time step": base.tau}
    for axes, (title, step) in zip(figure.subplots(1, 2, sharey=True), steps.items(), strict=True):
        for (label, fields), colour in zip(CLOCKS.items(), (GREY, BLUE, VERMILLION), strict=True):
            own = {"activation": wait, **fields} if fields else {}
            scenario = base.replace(time_step=step, **own)
            played = rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=1)
            axes.plot(played.times, played.lyapunov[:, 0], color=colour, label=label)
        axes.set(xlabel="time (s)", title=title, xlim=(0, 15), ylim=(0, None))
        axes.grid(True)
    figure.axes[0].set_ylabel("V (m²/s)")
    axes.legend()
    return figure


FAILURES: dict[str, dict[str, Any]] = {
    "law (1)": {},
    "one crash": {"crashes": [[0, 0.3]]},
    "an adversary": {"adversaries": [[0, 0.5]]},
    "w = 1.5 m/s": {"disturbance": 1.5},
}
"""Events of ``failures`` by title."""


@styled
def failures() -> Any:
    """Paths of law (1) with failures and a disturbance; robot 0 is red."""
    base = rv.Scenario(n_robots=6, graph="cycle", time_limit=8.0, max_speed=2.0)
    figure = new_figure(PAGE, 2.3)
    panels = zip(figure.subplots(1, len(FAILURES)), FAILURES.items(), strict=True)
    for axes, (title, events) in panels:
        scenario = base.replace(events=events)
        played = rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=8)
        for robot in range(scenario.n_robots):
            path = played.positions[:, 0, robot]
            colour = VERMILLION if robot == 0 else BLUE
            axes.plot(*path.T, color=colour, linewidth=0.8, zorder=3 if robot == 0 else 2)
            axes.plot(*path[0], "o", color=colour, markersize=3)
            axes.plot(*path[-1], "k.", markersize=3, zorder=4)
        axes.set(title=title, aspect="equal", xlabel="x (m)", xlim=(-6, 6), ylim=(-6, 6))
    figure.axes[0].set_ylabel("y (m)")
    return figure


FIGURES: dict[str, Callable[[], Any]] = {
    **DIAGRAMS,
    "bound": bound,
    "tightness": tightness,
    "guarantee-price": guarantee_price,
    "clocks": clocks,
    "failures": failures,
}


def gallery() -> None:
    """Write a thumbnail of the initial condition of seed 0 of every named scenario."""
    folder = IMAGES / "scenarios"
    folder.mkdir(exist_ok=True)
    for name in rv.scenarios.names():
        save(thumbnail(name), folder / f"{name}.png")


@styled
def thumbnail(name: str) -> Any:
    """Robots, links and obstacles of a scenario at the start of the episode with seed 0."""
    from matplotlib.patches import Circle, Polygon

    scenario = rv.scenarios.get(name)
    simulator = rv.Simulator(scenario)
    simulator.reset(0)
    positions, weights = simulator.positions[0], simulator.weights[0]
    figure = new_figure(THUMBNAIL, THUMBNAIL)
    flat = scenario.dim == 2
    axes = figure.add_subplot() if flat else figure.add_subplot(projection="3d")
    for shape in outlines(simulator.obstacles[0], scenario.dim):
        if not flat:
            _ball(axes, shape.centre, shape.radius)
        elif len(shape.vertices):
            axes.add_patch(Polygon(shape.vertices, facecolor=ORANGE, edgecolor=EDGE, lw=0.4))
        else:
            axes.add_patch(
                Circle(shape.centre, shape.radius, facecolor=ORANGE, edgecolor=EDGE, lw=0.4)
            )
    links = np.argwhere(np.triu((weights > 0) | (weights.T > 0)))
    if len(links) <= MAX_LINKS:
        for pair in links:
            axes.plot(*positions[pair].T, color=GREY, linewidth=0.5)
    for k, place in enumerate(positions):
        axes.plot(*place[:, None], "o", color=ROBOT_COLOURS[k % 7], markersize=3, zorder=5)
    axes.autoscale_view()
    if flat:
        middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
        reach = MAX_REACH * np.ptp(positions, axis=0).max()
        limits = np.stack([axes.get_xlim(), axes.get_ylim()], axis=1)
        if np.abs(limits - middle).max() > reach:
            (left, low), (right, high) = middle - reach, middle + reach
            axes.set(xlim=(left, right), ylim=(low, high))
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure


def _ball(axes: Any, centre: np.ndarray, radius: float) -> None:
    around, up = np.linspace(0, 2 * np.pi, 9), np.linspace(0, np.pi, 6)
    unit = np.stack(
        [np.outer(np.cos(around), np.sin(up)), np.outer(np.sin(around), np.sin(up)),
         np.outer(np.ones(9), np.cos(up))]
    )  # fmt: skip
    axes.plot_surface(
        *(centre[:, None, None] + radius * unit), color=ORANGE, alpha=0.35, linewidth=0
    )


if __name__ == "__main__":
    main()
