"""Schematic diagrams of the documentation, see figures.py."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from rendezvous_env.render.palette import OBSTACLE_EDGE, code
from train.figures.figures import BLACK, BLUE, GREEN, GREY, ORANGE, ROBOT_COLOURS, VERMILLION
from train.figures.style import PAGE, new_figure, styled

EDGE = code(OBSTACLE_EDGE)
TEXT = 9


def _arrow(axes: Any, start: Any, end: Any, colour: str, width: float = 1.2, **more: Any) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "mutation_scale": 9}
    ends = {"shrinkA": 0, "shrinkB": 0, "zorder": 6} | more
    axes.annotate("", end, start, arrowprops=style | ends)


def _plain(axes: Any) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()


def _block(
    axes: Any,
    corner: tuple[float, float],
    size: tuple[float, float],
    colour: str,
    name: str,
    inside: str,
    text: float,
) -> None:
    """Draw a rounded box with its name above a description."""
    from matplotlib.patches import FancyBboxPatch

    (x, y), (width, height) = corner, size
    style: Any = {"boxstyle": "round,pad=0.05", "facecolor": "white", "edgecolor": colour}
    axes.add_patch(FancyBboxPatch(corner, width, height, linewidth=1.5, **style))
    where: Any = {"ha": "center", "va": "center"}
    middle = x + width / 2
    name_style = {"color": colour, "weight": "bold", "fontsize": text + 0.5}
    axes.text(middle, y + 0.79 * height, name, **name_style, **where)
    axes.text(middle, y + 0.32 * height, inside, fontsize=text, **where)


@styled
def task() -> Any:
    """Robots, bearings to neighbours, edges of an obstacle and the merge radius."""
    from matplotlib.patches import Circle

    figure = new_figure(PAGE, 2.9)
    axes = figure.subplots()
    robots = np.array([[0.0, 0.0], [5.2, 2.0], [3.6, -1.9], [-2.9, -1.5]])
    for a in range(4):
        for b in range(a):
            axes.plot(*robots[[a, b]].T, color=GREY, linewidth=0.8, linestyle=":", zorder=1)
    _obstacle_with_edges(axes, np.array([2.5, 0.55]), 0.5)
    offsets = ((0.0, 0.9), (0.0, 0.42), (1.0, -0.12), (0.0, 0.42))
    for k, (place, offset) in enumerate(zip(robots, offsets, strict=True)):
        axes.plot(*place, "o", color=ROBOT_COLOURS[k], markersize=9, zorder=5)
        axes.text(*(place + offset), f"robot {k}", ha="center", fontsize=TEXT)
    bearings = robots[1:] / np.linalg.norm(robots[1:], axis=1, keepdims=True)
    for bearing in bearings:
        _arrow(axes, (0, 0), 1.25 * bearing, BLUE)
    f = bearings.sum(axis=0)
    _arrow(axes, (0, 0), 1.25 * f, VERMILLION, 2.0)
    axes.text(*(1.25 * f + [0.12, -0.1]), "f", color=VERMILLION, fontsize=TEXT + 1)
    axes.add_patch(Circle((0, 0), 0.75, fill=False, edgecolor=BLACK, linewidth=0.9))
    axes.text(-0.6, 0.55, "r", ha="right", fontsize=TEXT)
    axes.legend(
        handles=_task_handles(), loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=TEXT
    )
    axes.set(xlim=(-4.3, 6.2), ylim=(-2.3, 2.9))
    _plain(axes)
    return figure


def _obstacle_with_edges(axes: Any, centre: np.ndarray, radius: float) -> None:
    """Draw a disc and the bearings to its edges from the origin."""
    from matplotlib.patches import Circle

    axes.add_patch(Circle(centre, radius, facecolor=ORANGE, edgecolor=EDGE, alpha=0.8, zorder=2))
    towards, far = np.arctan2(*centre[::-1]), np.linalg.norm(centre)
    half = np.arcsin(radius / far)
    for angle in (towards + half, towards - half):
        end = far * np.cos(half) * np.array([np.cos(angle), np.sin(angle)])
        axes.plot(*np.stack([[0, 0], end]).T, color=EDGE, linewidth=0.8, linestyle="--", zorder=3)


def _task_handles() -> list[Any]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=BLUE, marker=">", label="measured bearing g"),
        Line2D([], [], color=VERMILLION, marker=">", linewidth=2, label="net bearing f = Σ a g"),
        Line2D([], [], color=EDGE, linestyle="--", label="bearings to obstacle edges"),
        Line2D([], [], color=GREY, linestyle=":", label="link of the graph"),
        Line2D([], [], color=BLACK, linewidth=0.9, label="merge radius r"),
    ]


@styled
def filter_loop() -> Any:
    """Block diagram: policy, safety filter, robots; bearings are fed back."""
    figure = new_figure(PAGE, 2.1)
    axes = figure.subplots()
    blocks = {
        "policy": (0.0, "law, network,\nadversary"),
        "safety filter": (3.6, "heading, tank,\ngains, links"),
        "robot": (7.2, "motion, contact,\nmerging"),
    }
    for name, (x, inside) in blocks.items():
        colour = VERMILLION if name == "safety filter" else BLUE
        _block(axes, (x, 0.0), (2.0, 1.2), colour, name, inside, TEXT)
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
    for name, (x, y, colour, inside) in blocks.items():
        _block(axes, (x, y), (2.3, 0.85), colour, name, inside, 8.0)
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
    figure = new_figure(PAGE, 2.0)
    panels = figure.subplots(1, 4)
    models = {
        "single_integrator": (_single_integrator, "input: velocity"),
        "double_integrator": (_double_integrator, "input: acceleration"),
        "unicycle": (partial(_body, turn="ω"), "inputs: v, turn rate ω"),
        "nonholonomic_3d": (_body_3d, "inputs: v, yaw and pitch rate"),
    }
    for axes, (title, (draw, held)) in zip(panels, models.items(), strict=True):
        axes.set_title(title, fontsize=TEXT)
        axes.text(0, -1.35, held, ha="center", fontsize=TEXT)
        axes.set(xlim=(-1.6, 1.6), ylim=(-1.55, 1.4))
        _plain(axes)
        draw(axes)
    return figure


def _single_integrator(axes: Any) -> None:
    _disc(axes)
    for angle in np.radians([150, 270]):
        _arrow(axes, (0, 0), 1.0 * np.array([np.cos(angle), np.sin(angle)]), GREY)
    _arrow(axes, (0, 0), (0.98, 0.69), VERMILLION, 1.8)
    axes.text(0.7, 0.85, "velocity", color=VERMILLION, fontsize=TEXT - 1, ha="center")


def _double_integrator(axes: Any) -> None:
    _disc(axes)
    _arrow(axes, (0, 0), (1.2, 0.0), GREEN, 1.8)
    _arrow(axes, (0, 0), (0.5, 0.95), VERMILLION, 1.8)
    axes.text(0.75, -0.38, "velocity", color=GREEN, fontsize=TEXT - 1)
    axes.text(0.62, 0.8, "acceleration", color=VERMILLION, fontsize=TEXT - 1, ha="left")


def _disc(axes: Any) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0, 0), 0.28, color=BLUE))


def _body(axes: Any, turn: str) -> None:
    """Draw a nonholonomic robot with its speed and the named turn rate."""
    from matplotlib.patches import Arc, Polygon

    axes.add_patch(Polygon([[-0.35, -0.3], [-0.35, 0.3], [0.45, 0.0]], color=BLUE))
    _arrow(axes, (0.45, 0), (1.35, 0), VERMILLION, 1.8)
    axes.text(1.0, 0.12, "v", color=VERMILLION, fontsize=TEXT)
    axes.add_patch(Arc((0, 0), 1.7, 1.7, theta1=40, theta2=120, color=GREEN, lw=1.6))
    axes.plot([-0.425], [0.736], marker=(3, 0, 120), color=GREEN, markersize=7)
    axes.text(0.0, 0.98, turn, color=GREEN, fontsize=TEXT, ha="center")


def _body_3d(axes: Any) -> None:
    from matplotlib.patches import Arc

    _body(axes, "yaw")
    colour = ROBOT_COLOURS[3]
    axes.add_patch(Arc((0, 0), 0.8, 1.9, theta1=250, theta2=330, color=colour, lw=1.6))
    axes.plot([0.35], [-0.42], marker=(3, 0, -15), color=colour, markersize=7)
    axes.text(0.5, -0.85, "pitch", color=colour, fontsize=TEXT)


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


DIAGRAMS: dict[str, Callable[[], Any]] = {
    "task": task,
    "filter": filter_loop,
    "api": api,
    "robots": robots,
    "graphs": graphs,
}
