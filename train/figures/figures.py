"""Figures of ``compare``: success, times, and sweeps over obstacles, robots and sensor levels.

Matplotlib is imported when a figure is made.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.policy import current_name

from rendezvous_env.checks import counted
from rendezvous_env.render.palette import OBSTACLE, ROBOTS, code
from rendezvous_env.scenario.scenario import Scenario

from ..results import grouped
from .style import COLUMN, PAGE, SMALL, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROBOT_COLOURS = tuple(code(colour) for colour in ROBOTS)
ORANGE = code(OBSTACLE)
"""Colour of obstacles, as in the paper."""
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
    "tangent-merged": GREEN,
    "tank-merged": GREEN,
    "learned": VERMILLION,
    "link-keeping": "#44AA99",
    "pursuit": "#999933",
    "windshield": "#8C510A",
    "unit-mean": "#7570B3",
    "smallest-sector": "#999933",
    "quantised": "#8C510A",
    "cyclic-pursuit": "#E7298A",
    "nearest-pursuit": "#666666",
    "random": GREY,
    "zero": GREY,
}
"""Laws (1), (7) and (12) of the paper never share a scenario and have the same colour."""
LINE = 0.155
"""Height of a row in a panel or legend, inch."""
LEGEND_COLUMNS = 2
_CROWDED = 0.07
"""Minimum distance of two tick labels, as a fraction of the axis."""
_VARIANTS = {"-certified": "s", "-tuned": "^", "-tank": "D", "-tank-noise": "P"}
"""Variants of a policy: same colour, another marker."""


_OWN_COLOURS = (BLACK, "#A6761D", "#7B3FE4", "#C51B7D", "#00788A", "#6B6B00", "#FF5FA2")
"""Colours of policies without a fixed colour, in the order of a comparison."""
_OWN_MARKERS = ("o", "v", "<", ">", "p", "h", "*")
"""Markers of the same policies; a repeated colour has another marker."""
Names = Sequence[str]
_LONG, _END = 32, 20
"""Length from which a name is shortened in figures, and length of its kept end, characters."""


def own_names(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Policies in rows of results.csv without a fixed colour, in order."""
    names = dict.fromkeys(str(row["policy"]) for row in rows)
    return [name for name in names if _plain(name) not in _POLICY_COLOURS and not _is_shipped(name)]


def shown_name(name: str) -> str:
    """Name of a policy in a figure: the end of a long path."""
    return name if len(name) <= _LONG else f"{name.partition(':')[0]}:…{name[-_END:]}"


def _plain(name: str) -> str:
    """Current name of a policy without the ending of a variant."""
    for ending in _VARIANTS:
        name = name.removesuffix(ending)
    return current_name(name)


def _is_shipped(name: str) -> bool:
    return name.startswith("privileged-")


def policy_colour(name: str, own: Names = ()) -> str:
    """Colour of a policy in all figures; those of ``own`` have theirs in order."""
    if name in own:
        return _OWN_COLOURS[list(own).index(name) % len(_OWN_COLOURS)]
    colour = _POLICY_COLOURS.get(_plain(name))
    return colour or (BLACK if ":" in name else GREY)


def policy_marker(name: str, own: Names = ()) -> str:
    """Marker of a policy, which distinguishes its variants, or those of ``own`` with one colour."""
    if name in own:
        rounds, place = divmod(list(own).index(name), len(_OWN_COLOURS))
        return _OWN_MARKERS[(place + rounds) % len(_OWN_MARKERS)]
    if name.startswith("tank-"):
        return _VARIANTS["-tank"]
    return next((mark for end, mark in _VARIANTS.items() if name.endswith(end)), "o")


@styled
def success_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Success and collision-free success of the policies in results.csv, one panel per scenario."""
    own = own_names(rows)

    def draw(axes: Axes, panel: Sequence[Mapping[str, Any]]) -> None:
        hollow: Any = {"shift": -0.17, "markerfacecolor": "white"}
        _intervals(axes, panel, ("success", "success"), 100.0, own, **hollow)
        _intervals(
            axes, panel, ("collision_free_success", "collision_free"), 100.0, own, shift=0.17
        )
        axes.set_xlim(-4, 104)
        axes.set_xticks(range(0, 101, 25))

    figure = _panels(rows, draw, "share of initial conditions (%)")
    axes = figure.axes[0]
    handles = [
        axes.plot([], [], "o", color=GREY, fillstyle="none", label="all robots met")[0],
        axes.plot([], [], "o", color=GREY, label="collision-free")[0],
        axes.plot([], [], "-", color=GREY, label="95 % interval")[0],
    ]
    across = 1 if figure.get_figwidth() == COLUMN else len(handles)
    figure.set_figheight(figure.get_figheight() + LINE * (len(handles) // across - 1))
    figure.legend(handles=handles, loc="outside upper center", ncols=across)
    return figure


@styled
def time_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Median rendezvous times of the policies, one panel per scenario."""
    own = own_names(rows)

    def draw(axes: Axes, panel: Sequence[Mapping[str, Any]]) -> None:
        met = [row for row in panel if row["success"] > 0.5]
        _intervals(axes, met, ("median_time", "time"), 1.0, own)
        for row in panel:
            if row not in met:
                style: Any = {"va": "center", "fontsize": SMALL - 1, "color": "0.4"}
                # in the layout it would fill a panel of time-outs
                style |= {"transform": axes.get_yaxis_transform(), "in_layout": False}
                axes.text(0.02, row["place"], "at most half met", **style)
        latest = (np.fmax(row["time_high"], row["median_time"]) for row in met)
        axes.set_xlim(0, 1.15 * max(latest, default=1.0))

    figure = _panels(rows, draw, "median rendezvous time (s)")
    handle = figure.axes[0].plot([], [], "o-", color=GREY, label="median, 95 % interval")[0]
    figure.legend(handles=[handle], loc="outside upper center")
    return figure


def _panels(rows: Sequence[Mapping[str, Any]], draw: Any, label: str) -> Figure:
    """Figure with one panel per scenario and one row per policy."""
    found = grouped(map(dict, rows), "scenario")
    panels, columns = list(found.values()), min(3, len(found))
    tallest = [max(map(len, panels[k : k + columns])) for k in range(0, len(found), columns)]
    heights = [0.35 + LINE * lines for lines in tallest]
    width = COLUMN if columns == 1 else PAGE
    figure = new_figure(width, 0.6 + sum(heights))
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    for number, (name, panel) in enumerate(found.items()):
        axes = figure.add_subplot(grid[number // columns, number % columns])
        for place, row in enumerate(panel):
            row["place"] = place
        draw(axes, panel)
        axes.set_title(f"{name}, one episode" if panel[0].get("episodes") == 1 else name)
        axes.set_yticks(range(len(panel)), [shown_name(row["policy"]) for row in panel])
        axes.set_ylim(tallest[number // columns] - 0.5, -0.5)
        axes.tick_params(length=2)
        axes.grid(axis="x")
    figure.supxlabel(label, fontsize=8)
    return figure


def _intervals(
    axes: Axes,
    rows: Sequence[Mapping[str, Any]],
    names: tuple[str, str],
    factor: float = 1.0,
    own: Names = (),
    shift: float = 0.0,
    **style: Any,
) -> None:
    """Draw a marker with a horizontal interval for each row, from the columns of ``columns_of``.

    Missing values and intervals are left out.
    """
    style = {"markersize": 3, "linewidth": 1.0, "markeredgewidth": 0.8, "clip_on": False} | style
    for row in rows:
        centre, low, high = factor * columns_of([row], *names)
        if not np.isnan(centre):
            name = row["policy"]
            style |= {"fmt": policy_marker(name, own), "color": policy_colour(name, own)}
            around = np.fmax(0.0, [centre - low, high - centre])
            axes.errorbar(centre, [row["place"] + shift], xerr=around, **style)


def sweeps(scenarios: Sequence[Scenario], quantity: str) -> list[list[Scenario]]:
    """Groups of scenarios that differ only in the number of "robots" or random "obstacles".

    Each group has at least two scenarios, sorted by that number.
    """
    groups: dict[str, dict[int, Scenario]] = {}
    for scenario in scenarios:
        if (number := _number(scenario, quantity)) is None:
            continue
        plain = scenario.to_plain()
        for derived in ("name", "obstacle_slots", "neighbour_slots"):
            plain.pop(derived, None)
        if quantity == "obstacles":
            del plain["obstacles"]["count"]
        else:
            del plain["n_robots"]
        groups.setdefault(json.dumps(plain, sort_keys=True), {})[number] = scenario
    return [[group[k] for k in sorted(group)] for group in groups.values() if len(group) > 1]


def _number(scenario: Scenario, quantity: str) -> int | None:
    """Number of obstacles or robots of a scenario; None if obstacles are not random."""
    if quantity == "robots":
        return scenario.n_robots
    count = getattr(scenario.obstacles, "count", None)  # of a tuple it is a method
    return count if isinstance(count, int) else None


@styled
def sweep_figure(
    rows: Sequence[Mapping[str, Any]], group: Sequence[Scenario], quantity: str
) -> Figure:
    """Collision-free success from results.csv against the number of obstacles or robots."""
    numbers, own_of_all = {one.name: _number(one, quantity) or 0 for one in group}, own_names(rows)
    found = grouped((row for row in rows if row["scenario"] in numbers), "policy")
    figure = new_figure(COLUMN, 2.75 + LINE * math.ceil(len(found) / LEGEND_COLUMNS))
    axes = figure.add_subplot()
    for policy, own in found.items():
        own.sort(key=lambda row: numbers[row["scenario"]])
        x = [numbers[row["scenario"]] for row in own]
        shares = 100.0 * columns_of(own, "collision_free_success", "collision_free")
        draw_policy(axes, policy, x, shares, own_of_all)
    places = sorted(numbers.values())
    if min(np.diff(places)) < _CROWDED * (places[-1] - places[0]):
        axes.set_xscale("log")
    axes.set_xticks(places, [str(place) for place in places])
    axes.minorticks_off()
    axes.set(xlabel=f"number of {quantity}", ylim=(-3, 103))
    axes.set_ylabel("collision-free success (%)")
    axes.grid()
    count = _number(group[0], "obstacles")
    clutter = counted(count, "obstacle") if count else "the same obstacles"
    fixed = f"{group[0].n_robots} robots" if quantity == "obstacles" else clutter
    axes.set_title(f"Collision-free: {fixed}, 95 % intervals")
    figure.legend(loc="outside lower center", ncols=LEGEND_COLUMNS)
    return figure


def draw_policy(
    axes: Axes,
    policy: str,
    x: Sequence[float] | NDArray[Any],
    numbers: NDArray[Any],
    own: Names = (),
) -> None:
    """Draw one policy with its intervals.

    ``numbers``, (3, N), are values and interval ends. Lines are solid, dashed for a variant, dotted
    under an energy tank.
    """
    (centre, low, high), marker = numbers, policy_marker(policy, own)
    broken = {"o": "-", _VARIANTS["-tank"]: ":"}.get(marker, "--")
    axes.errorbar(
        x,
        centre,
        yerr=np.fmax(0.0, [centre - low, high - centre]),
        fmt=marker,
        linestyle="-" if policy in own else broken,
        color=policy_colour(policy, own),
        elinewidth=0.6,
        label=shown_name(policy),
    )


def columns_of(rows: Sequence[Mapping[str, Any]], value: str, interval: str) -> NDArray[Any]:
    """Values and interval ends, (3, N), from rows of results.csv."""
    names = (value, f"{interval}_low", f"{interval}_high")
    return np.array([[row[name] for row in rows] for name in names], dtype=float)


_UNITS = {
    "range": "m", "field_of_view": "rad", "noise": "rad", "bias": "rad", "error": "rad",
    "delay": "steps", "min_range": "m", "sample_period": "s", "delay_time": "s",
    "observer_bias": "rad", "noise_correlation": "s", "view_falloff": "rad", "persistence": "s",
}  # fmt: skip


@styled
def level_figure(sweep: Any, rows: Sequence[dict[str, Any]]) -> Figure:
    """Success and time at the levels of a ``compare.sweep.Sweep``, from rows of levels.csv.

    Levels are equally spaced, since the exact sensor need not be a number. Where more than half of
    the episodes time out, the median is undefined and not drawn.
    """
    found, own_of_all = grouped(rows, "policy"), own_names(rows)
    figure = new_figure(COLUMN, 4.2 + LINE * math.ceil(len(found) / LEGEND_COLUMNS))
    above, below = figure.subplots(2, 1, sharex=True)
    limit = sweep.base.max_steps * sweep.base.tau
    counts = not np.isnan([row["collision_free_success"] for row in rows]).any()
    names = ("collision_free_success", "collision_free") if counts else ("success", "success")
    for policy, own in found.items():
        x = np.arange(len(own))
        draw_policy(above, policy, x, 100.0 * columns_of(own, *names), own_of_all)
        times = columns_of(own, "median_time", "time")
        met = times[0] < limit
        draw_policy(below, policy, x[met], times[:, met], own_of_all)
    above.set(ylim=(-2, 102), ylabel=f"{'collision-free ' if counts else ''}success (%)")
    unit = f" ({_UNITS[sweep.field]})" if sweep.field in _UNITS else ""
    below.set(ylabel="median time (s)", xlabel=f"{sweep.field.replace('_', ' ')}{unit}")
    below.set_ylim(bottom=0.0)
    below.set_xticks(range(len(sweep.labels)), sweep.labels)
    for axes in (above, below):
        axes.grid()
    episodes = counted(rows[0]["episodes"], "episode")
    above.set_title(f"{sweep.base.name}, {episodes}, 95 % intervals")
    handles, names = above.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=LEGEND_COLUMNS)
    return figure
