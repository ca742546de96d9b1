"""Diagrams of the documentation: ``python docs/building/figures.py [NAME ...]``.

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

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.obstacles.obstacle_set import outlines
from rendezvous_env.render.palette import OBSTACLE_EDGE, code
from train.figures.figures import BLACK, BLUE, GREEN, GREY, ORANGE, ROBOT_COLOURS, VERMILLION
from train.figures.style import COLUMN, PAGE, new_figure, save, styled

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
EDGE = code(OBSTACLE_EDGE)
TEXT = 9
THUMBNAIL = 1.5
"""Width and height of a scenario's thumbnail, inch."""
MAX_LINKS = 70
"""Thumbnails of denser graphs have no links, which would hide the robots."""


def main() -> None:
    """Write the figures that the command line names, or all of them."""
    for name in sys.argv[1:] or [*FIGURES, "gallery"]:
        if name == "gallery":
            gallery()
        else:
            save(FIGURES[name](), IMAGES / f"{name}.png")


def _arrow(axes: Any, start: Any, end: Any, colour: str, width: float = 1.2, **more: Any) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "mutation_scale": 9}
    ends = {"shrinkA": 0, "shrinkB": 0, "zorder": 6} | more
    axes.annotate("", end, start, arrowprops=style | ends)


def _plain(axes: Any) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()


@styled
def task() -> Any:
    """Robots, bearings to neighbours, edges of an obstacle and the merge radius."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    figure = new_figure(PAGE, 2.9)
    axes = figure.subplots()
    robots = np.array([[0.0, 0.0], [5.2, 2.0], [3.6, -1.9], [-2.9, -1.5]])
    disc, radius = np.array([2.5, 0.55]), 0.5
    for a in range(4):
        for b in range(a):
            axes.plot(*robots[[a, b]].T, color=GREY, linewidth=0.8, linestyle=":", zorder=1)
    axes.add_patch(Circle(disc, radius, facecolor=ORANGE, edgecolor=EDGE, alpha=0.8, zorder=2))
    for k, place in enumerate(robots):
        axes.plot(*place, "o", color=ROBOT_COLOURS[k], markersize=9, zorder=5)
        above = [0.0, 0.9 if k == 0 else 0.42]
        axes.text(*(place + above), f"robot {k}", ha="center", fontsize=TEXT)
    for place in robots[1:]:
        ahead = place / np.linalg.norm(place)
        _arrow(axes, (0, 0), 1.25 * ahead, BLUE)
    f = sum(place / np.linalg.norm(place) for place in robots[1:])
    _arrow(axes, (0, 0), 1.25 * f, VERMILLION, 2.0)
    axes.text(*(1.25 * f + [0.12, -0.1]), "f", color=VERMILLION, fontsize=TEXT + 1)
    towards, far = np.arctan2(*disc[::-1]), np.linalg.norm(disc)
    half = np.arcsin(radius / far)
    for side in (half, -half):
        angle = towards + side
        end = far * np.cos(half) * np.array([np.cos(angle), np.sin(angle)])
        axes.plot(*np.stack([[0, 0], end]).T, color=EDGE, linewidth=0.8, linestyle="--", zorder=3)
    axes.add_patch(Circle((0, 0), 0.75, fill=False, edgecolor=BLACK, linewidth=0.9))
    axes.text(-0.6, 0.55, "r", ha="right", fontsize=TEXT)
    handles = [
        Line2D([], [], color=BLUE, marker=">", label="measured bearing g"),
        Line2D([], [], color=VERMILLION, marker=">", linewidth=2, label="net bearing f = Σ a g"),
        Line2D([], [], color=EDGE, linestyle="--", label="bearings to obstacle edges"),
        Line2D([], [], color=GREY, linestyle=":", label="link of the graph"),
        Line2D([], [], color=BLACK, linewidth=0.9, label="merge radius r"),
    ]
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TEXT)
    axes.set(xlim=(-4.3, 6.2), ylim=(-2.3, 2.9))
    _plain(axes)
    return figure


@styled
def filter_loop() -> Any:
    """Block diagram: policy, safety filter, robots; bearings are fed back."""
    from matplotlib.patches import FancyBboxPatch

    figure = new_figure(PAGE, 2.1)
    axes = figure.subplots()
    blocks = {
        "policy": (0.0, "law, network,\nadversary"),
        "safety filter": (3.6, "heading, tank,\ngains, links"),
        "robot": (7.2, "motion, contact,\nmerging"),
    }
    for name, (x, inside) in blocks.items():
        colour = VERMILLION if name == "safety filter" else BLUE
        shape = FancyBboxPatch(
            (x, 0), 2.0, 1.2, boxstyle="round,pad=0.05", facecolor="white", edgecolor=colour, lw=1.6
        )
        axes.add_patch(shape)
        axes.text(x + 1, 0.88, name, ha="center", fontsize=TEXT + 1, color=colour, weight="bold")
        axes.text(x + 1, 0.34, inside, ha="center", va="center", fontsize=TEXT)
    for x, words in ((2.1, "choice"), (5.7, "certified\ninput")):
        _arrow(axes, (x, 0.6), (x + 1.42, 0.6), BLACK)
        axes.text(x + 0.7, 0.72, words, ha="center", va="bottom", fontsize=TEXT)
    axes.plot([8.2, 8.2, 1.0], [-0.08, -0.8, -0.8], color=BLACK, lw=1.2)
    _arrow(axes, (1.0, -0.8), (1.0, -0.08), BLACK)
    _arrow(axes, (4.6, -0.8), (4.6, -0.08), BLACK)
    axes.text(6.4, -0.72, "measured bearings", ha="center", va="bottom", fontsize=TEXT)
    axes.set(xlim=(-0.2, 9.4), ylim=(-1.05, 1.4))
    _plain(axes)
    return figure


@styled
def api() -> Any:
    """Map of the public API, from a scenario to interfaces and results."""
    from matplotlib.patches import FancyBboxPatch

    figure = new_figure(PAGE, 2.4)
    axes = figure.subplots()
    blocks = {
        "Scenario": (0.0, 1.5, BLUE, "name, object or\nTOML file"),
        "Simulator": (3.0, 1.5, BLUE, "all environments,\nall threads"),
        "interfaces": (6.0, 2.7, BLUE, "parallel_env, make_vec,\ngymnasium.make"),
        "training_env": (9.0, 2.7, BLUE, "SB3, TorchRL, RLlib,\nBenchMARL, PufferLib"),
        "rollout": (6.0, 1.5, GREEN, "Trajectory:\narrays, pandas"),
        "compare, report": (9.0, 1.5, GREEN, "statistics, replay"),
        "certificate": (3.0, 0.3, VERMILLION, "assumptions, bounds"),
        "policies": (6.0, 0.3, VERMILLION, "laws, rules, learned,\nTrainedPolicy"),
        "RobotPolicy, export": (9.0, 0.3, VERMILLION, "hardware"),
    }
    width, height = 2.3, 0.85
    for name, (x, y, colour, inside) in blocks.items():
        box = FancyBboxPatch(
            (x, y), width, height, boxstyle="round,pad=0.04", fc="white", ec=colour, lw=1.4
        )
        axes.add_patch(box)
        where = {"ha": "center", "va": "center"}
        axes.text(x + width / 2, y + 0.67, name, color=colour, weight="bold", fontsize=8.5, **where)
        axes.text(x + width / 2, y + 0.27, inside, fontsize=8, **where)
    ends = [
        ((2.35, 1.92), (2.95, 1.92)),
        ((5.35, 2.1), (5.95, 3.0)),
        ((5.35, 1.92), (5.95, 1.92)),
        ((8.35, 3.12), (8.95, 3.12)),
        ((8.35, 1.92), (8.95, 1.92)),
        ((2.35, 1.7), (2.95, 0.8)),
        ((7.15, 1.2), (7.15, 1.45)),
        ((8.35, 0.72), (8.95, 0.72)),
    ]
    for start, end in ends:
        _arrow(axes, start, end, BLACK, 1.0)
    axes.set(xlim=(-0.1, 11.5), ylim=(0.15, 3.7))
    _plain(axes)
    return figure


@styled
def robots() -> Any:
    """The four robot models with their inputs."""
    from matplotlib.patches import Arc, Circle, Polygon

    figure = new_figure(PAGE, 2.0)
    panels = figure.subplots(1, 4)
    titles = ("single_integrator", "double_integrator", "unicycle", "nonholonomic_3d")
    holds = (
        "input: velocity",
        "input: acceleration",
        "inputs: v, turn rate ω",
        "inputs: v, yaw and pitch rate",
    )
    for axes, title, held in zip(panels, titles, holds, strict=True):
        axes.set_title(title, fontsize=TEXT)
        axes.text(0, -1.35, held, ha="center", fontsize=TEXT)
        axes.set(xlim=(-1.6, 1.6), ylim=(-1.55, 1.4))
        _plain(axes)
    for axes in panels[:2]:
        axes.add_patch(Circle((0, 0), 0.28, color=BLUE))
    for angle in np.radians([150, 270]):
        _arrow(panels[0], (0, 0), 1.0 * np.array([np.cos(angle), np.sin(angle)]), GREY)
    _arrow(panels[0], (0, 0), (0.98, 0.69), VERMILLION, 1.8)
    panels[0].text(0.7, 0.85, "velocity", color=VERMILLION, fontsize=TEXT - 1, ha="center")
    _arrow(panels[1], (0, 0), (1.2, 0.0), GREEN, 1.8)
    _arrow(panels[1], (0, 0), (0.5, 0.95), VERMILLION, 1.8)
    panels[1].text(0.75, -0.38, "velocity", color=GREEN, fontsize=TEXT - 1)
    panels[1].text(0.62, 0.8, "acceleration", color=VERMILLION, fontsize=TEXT - 1, ha="left")
    for axes in panels[2:]:
        axes.add_patch(Polygon([[-0.35, -0.3], [-0.35, 0.3], [0.45, 0.0]], color=BLUE))
        _arrow(axes, (0.45, 0), (1.35, 0), VERMILLION, 1.8)
        axes.text(1.0, 0.12, "v", color=VERMILLION, fontsize=TEXT)
        axes.add_patch(Arc((0, 0), 1.7, 1.7, theta1=40, theta2=120, color=GREEN, lw=1.6))
        axes.plot([-0.425], [0.736], marker=(3, 0, 120), color=GREEN, markersize=7)
    panels[2].text(0.0, 0.98, "ω", color=GREEN, fontsize=TEXT, ha="center")
    panels[3].text(0.0, 0.98, "yaw", color=GREEN, fontsize=TEXT, ha="center")
    panels[3].add_patch(
        Arc((0, 0), 0.8, 1.9, theta1=250, theta2=330, color=ROBOT_COLOURS[3], lw=1.6)
    )
    panels[3].plot([0.35], [-0.42], marker=(3, 0, -15), color=ROBOT_COLOURS[3], markersize=7)
    panels[3].text(0.5, -0.85, "pitch", color=ROBOT_COLOURS[3], fontsize=TEXT)
    return figure


@styled
def graphs() -> Any:
    """Graph types on six robots, each in one panel."""
    figure = new_figure(PAGE, 2.9)
    panels = figure.subplots(2, 4)
    ring = [(i, (i + 1) % 6) for i in range(6)]
    angles = np.pi / 2 - 2 * np.pi * np.arange(6) / 6
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    star = np.concatenate([[[0.0, 0.0]], circle[:5] * 1.0])
    spread = np.array([[-1, 0.8], [-0.4, 0.2], [0.3, 0.6], [0.9, 0.0], [-0.8, -0.7], [0.5, -0.9]])
    near = [
        (i, j) for i in range(6) for j in range(i) if np.linalg.norm(spread[i] - spread[j]) < 1.3
    ]
    shown: list[tuple[str, np.ndarray, list[tuple[int, int]], bool]] = [
        ("complete", circle, [(i, j) for i in range(6) for j in range(i)], False),
        ("path", circle, ring[:-1], False),
        ("cycle", circle, ring, False),
        ("star", star, [(0, i) for i in range(1, 6)], False),
        ("random_tree", circle, [(0, 1), (0, 2), (2, 3), (2, 4), (4, 5)], False),
        ("directed_cycle", circle, ring, True),
        ("proximity", spread, near, False),
    ]
    for axes, (title, places, edges, directed) in zip(panels.flat, shown, strict=False):
        _graph(axes, places, edges, directed)
        axes.set_title(title, fontsize=TEXT)
    last = panels.flat[-1]
    last.set_title("switching", fontsize=TEXT)
    for k, edges in enumerate((ring[:-1], [(0, i) for i in range(1, 6)], ring)):
        offset = np.array([2.6 * k, 0.0])
        _graph(last, circle + offset, edges, False, 3.5)
        if k < 2:
            _arrow(last, (2.6 * k + 1.15, 0.0), (2.6 * k + 1.5, 0.0), BLACK, 0.8)
    last.set(xlim=(-1.3, 6.5), ylim=(-1.3, 1.3))
    return figure


def _graph(
    axes: Any,
    places: np.ndarray,
    edges: list[tuple[int, int]],
    directed: bool,
    size: float = 6,
) -> None:
    for i, j in edges:
        if directed:
            _arrow(axes, places[i], places[j], GREY, 1.2, shrinkA=4, shrinkB=4)
        else:
            axes.plot(*places[[i, j]].T, color=GREY, linewidth=1.2, zorder=1)
    axes.plot(*places.T, "o", color=BLUE, markersize=size, zorder=5)
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    _plain(axes)


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


@styled
def guarantee_price() -> Any:
    """Success and time of the PPO learners against rises of V, from docs/leaderboard.md."""
    from matplotlib.lines import Line2D

    text = (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    number, interval = r"([\d.]+)", r"([\d.]+) \(([\d.]+) to ([\d.]+)\)"
    row = r"^\| ppo-(\w+) \| [^|]+ \| (\w+) \| [^|]+ "
    row += rf"\| {interval} \| {interval} \| {number} \| {number} "
    marks = {"none": "o", "heading": "s", "tank": "D"}
    figure = new_figure(PAGE, 3.0)
    panels = figure.subplots(1, 2)
    for found in re.finditer(row, text, flags=re.MULTILINE):
        name, guarantee = found[1], found[2]
        values = [float(value) for value in found.groups()[2:]]
        colour = {"none": BLACK, "heading": BLUE, "tank": VERMILLION}[guarantee]
        for axes, (value, low, high) in zip(panels, (values[:3], values[3:6]), strict=True):
            bars = [[value - low], [high - value]]
            look = {"fmt": marks[guarantee], "color": colour, "capsize": 2, "markersize": 5}
            axes.errorbar(values[7] / 10, value, bars, **look)
            place = {"cbf": (6, -11), "lagrangian": (-60, 6), "tank": (-26, 4)}.get(name, (6, 4))
            axes.annotate(name, (values[7] / 10, value), place, textcoords="offset points")
    panels[0].set(ylabel="collision-free success (%)", ylim=(-3, 105))
    panels[1].set(ylabel="time (s)", ylim=(0, 65))
    for axes in panels:
        axes.set(xlabel="steps in which V rose (%)", xlim=(-1, 44))
        axes.grid(True)
    shapes = (("none", "no guarantee"), ("heading", "certified headings"), ("tank", "energy tank"))
    colours = (BLACK, BLUE, VERMILLION)
    handles = [
        Line2D([], [], linestyle="", marker=marks[key], color=colour, markersize=5, label=label)
        for (key, label), colour in zip(shapes, colours, strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=8)
    return figure


FIGURES: dict[str, Callable[[], Any]] = {
    "task": task,
    "filter": filter_loop,
    "api": api,
    "robots": robots,
    "graphs": graphs,
    "bound": bound,
    "tightness": tightness,
    "guarantee-price": guarantee_price,
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
