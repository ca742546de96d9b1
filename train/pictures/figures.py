"""Figures of ``compare``: success, times, and clean success against clutter and team size.

The drawing library is imported when a figure is made.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rendezvous_env.drawing.palette import OBSTACLE, ROBOTS, code
from rendezvous_env.experiment.scenario import Scenario

from ..results import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROBOT_COLOURS = tuple(code(colour) for colour in ROBOTS)
ORANGE = code(OBSTACLE)
"""Of obstacles, as in the paper."""
BLUE, VERMILLION, GREEN, PURPLE, SKY, DARK_RED, BLACK = ROBOT_COLOURS
GREY = "#B8B8B8"
_POLICY_COLOURS = {
    "bearing-only": BLUE,
    "unicycle": BLUE,
    "nonholonomic-3d": BLUE,
    "unicycle-cosine": SKY,
    "privileged-planner": SKY,
    "tangent": DARK_RED,
    "tangent-blocking": PURPLE,
    "tangent-joined": GREEN,
    "learned": VERMILLION,
}
"""The paper's laws (1), (7) and (12) never meet in one scenario and share a colour."""
_VARIANTS = {"-certified": "s", "-tuned": "^", "-tank": "D", "-tank-noise": "P"}
"""Variants of a policy have its colour and another marker."""
_DPI = 150


def policy_colour(name: str) -> str:
    """The colour of a policy in every figure; black for learned ones that are not shipped."""
    base = _base(name)
    return BLACK if base.startswith("learned:") else _POLICY_COLOURS.get(base, GREY)


def policy_marker(name: str) -> str:
    """The marker of a policy, which tells its variants apart."""
    return next((mark for end, mark in _VARIANTS.items() if name.endswith(end)), "o")


def _base(name: str) -> str:
    """A policy's name without its variant."""
    for ending in _VARIANTS:
        name = name.removesuffix(ending)
    return name


def save(figure: Figure, path: Path, run: str = "") -> None:
    """Write a figure as PNG or PDF, by the name's ending, whole or not at all.

    Args:
        figure: to write.
        path: of the file.
        run: id of the run that it shows; it goes into the file as its subject.
    """
    ending = path.suffix.lower().removeprefix(".")
    about = {"Subject": f"rendezvous compare, run {run}"} if run else None
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format=ending, metadata=about)


def new_figure(width: float, height: float) -> Figure:
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
        _intervals(axes, panel, "success", "success", -0.16, filled=False)
        _intervals(axes, panel, "clean_success", "clean", 0.16)
        axes.set_xlim(-0.04, 1.04)

    figure = _panels(rows, draw, "fraction of starts, with 95 % interval")
    axes = figure.axes[0]
    handles = [
        axes.plot([], [], "o", color=GREY, fillstyle="none", label="success")[0],
        axes.plot([], [], "o", color=GREY, label="success without contact")[0],
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    return figure


def time_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Median rendezvous times of the policies that meet, one panel for each scenario.

    Args:
        rows: of results.csv.
    """

    def draw(axes: Axes, panel: Sequence[Mapping[str, Any]]) -> None:
        met = [row for row in panel if row["success"] > 0.5]
        _intervals(axes, met, "median_time", "time", 0.0)
        for row in panel:
            if row not in met:
                note = axes.text(
                    0.02,
                    row["place"],
                    "more than half time out",
                    transform=axes.get_yaxis_transform(),
                    va="center",
                    fontsize=7,
                    color="0.4",
                )
                note.set_in_layout(False)  # in a panel of time-outs alone it would take all room
        latest = [np.fmax(row["time_high"], row["median_time"]) for row in met]
        axes.set_xlim(0, 1.15 * max(latest, default=1.0))

    return _panels(rows, draw, "median rendezvous time / s, with 95 % interval")


def _panels(rows: Sequence[Mapping[str, Any]], draw: Any, label: str) -> Figure:
    """A grid with one panel for each scenario and one line for each of its policies."""
    names = list(dict.fromkeys(row["scenario"] for row in rows))
    columns = min(4, len(names))
    grid_rows = math.ceil(len(names) / columns)
    figure = new_figure(max(4.5, 3.4 * columns), 0.7 + 2.3 * grid_rows)
    for number, name in enumerate(names):
        axes = figure.add_subplot(grid_rows, columns, number + 1)
        panel = [dict(row) for row in rows if row["scenario"] == name]
        for place, row in enumerate(panel):
            row["place"] = place
        draw(axes, panel)
        axes.set_title(f"{name}, one start" if _is_single(panel[0]) else name, fontsize=9)
        axes.set_yticks(range(len(panel)), [row["policy"] for row in panel], fontsize=7)
        axes.set_ylim(len(panel) - 0.5, -0.5)
        axes.tick_params(axis="x", labelsize=7)
        axes.grid(axis="x", color="0.9")
    figure.supxlabel(label, fontsize=9)
    return figure


def _is_single(row: Mapping[str, Any]) -> bool:
    return row.get("episodes") == 1


def _intervals(
    axes: Axes,
    rows: Sequence[Mapping[str, Any]],
    value: str,
    interval: str,
    shift: float,
    *,
    filled: bool = True,
) -> None:
    """A marker with a horizontal interval for each row, ``shift`` below its line; nothing where the
    value does not apply, and no interval where there is none.
    """
    for row in rows:
        centre, low, high = (float(row[key]) for key in (value, *_ends(interval)))
        if math.isnan(centre):
            continue
        axes.errorbar(
            [centre],
            [row["place"] + shift],
            xerr=np.fmax(0.0, [[centre - low], [high - centre]]),
            fmt=policy_marker(row["policy"]),
            color=policy_colour(row["policy"]),
            markerfacecolor=None if filled else "white",
            markersize=4,
            linewidth=1.2,
            clip_on=False,
        )


def _ends(interval: str) -> tuple[str, str]:
    return f"{interval}_low", f"{interval}_high"


# ---- against one quantity -----------------------------------------------------------------------


def sweeps(scenarios: Sequence[Scenario], quantity: str) -> list[list[Scenario]]:
    """Groups of scenarios, two or more in each, that differ in one quantity only, in its order.

    Args:
        scenarios: any.
        quantity: "obstacles", how many are drawn at random, or "robots".
    """
    groups: dict[str, dict[int, Scenario]] = {}
    for scenario in scenarios:
        plain = scenario.to_plain()
        for derived in ("name", "obstacle_slots", "neighbour_slots"):
            plain.pop(derived, None)
        number = _number(scenario, quantity)
        if number is None:
            continue
        if quantity == "obstacles":
            del plain["obstacles"]["count"]
        else:
            del plain["n_robots"]
        groups.setdefault(json.dumps(plain, sort_keys=True), {})[number] = scenario
    return [[group[k] for k in sorted(group)] for group in groups.values() if len(group) > 1]


def _number(scenario: Scenario, quantity: str) -> int | None:
    """How many obstacles or robots a scenario has; None where they are not drawn by number."""
    if quantity == "robots":
        return scenario.n_robots
    count = getattr(scenario.obstacles, "count", None)
    return count if isinstance(count, int) and not isinstance(scenario.obstacles, tuple) else None


def sweep_figure(
    rows: Sequence[Mapping[str, Any]], group: Sequence[Scenario], quantity: str
) -> Figure:
    """Clean success of every policy against the number of obstacles or of robots.

    Args:
        rows: of results.csv.
        group: scenarios, as ``sweeps`` gives them.
        quantity: "obstacles" or "robots".
    """
    numbers = {scenario.name: _number(scenario, quantity) or 0 for scenario in group}
    inside = [row for row in rows if row["scenario"] in numbers]
    policies = list(dict.fromkeys(row["policy"] for row in inside))
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot()
    apart = 0.008 * (max(numbers.values()) - min(numbers.values()))
    for place, policy in enumerate(policies):
        own = [row for row in inside if row["policy"] == policy]
        own.sort(key=lambda row: numbers[row["scenario"]])
        shift = apart * (place - (len(policies) - 1) / 2)
        _line(axes, policy, [numbers[row["scenario"]] + shift for row in own], own)
    axes.set_xticks(sorted(numbers.values()))
    axes.set(xlabel=f"number of {quantity}", ylim=(-2, 102))
    axes.set_ylabel("met without contact / % of starts")
    axes.grid(color="0.92")
    example = group[0]
    count = _number(example, "obstacles")
    clutter = f"{count} obstacles" if count else "the same obstacles"
    fixed = f"{example.n_robots} robots" if quantity == "obstacles" else clutter
    axes.set_title(f"{fixed}; bars: 95 % intervals", fontsize=9)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure


def _line(axes: Axes, policy: str, x: Sequence[float], rows: Sequence[Mapping[str, Any]]) -> None:
    """One policy, with its intervals."""
    centre, low, high = (
        100 * np.array([row[key] for row in rows], dtype=float)
        for key in ("clean_success", "clean_low", "clean_high")
    )
    axes.errorbar(
        x,
        centre,
        yerr=np.fmax(0.0, [centre - low, high - centre]),
        fmt=policy_marker(policy),
        linestyle="-" if policy == _base(policy) else "--",
        color=policy_colour(policy),
        markersize=4.5,
        linewidth=1.3,
        elinewidth=0.9,
        label=policy,
    )
