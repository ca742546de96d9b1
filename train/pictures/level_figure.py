"""Clean success and median time against one thing that a sensor gets wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rendezvous_env.experiment.scenario import Scenario

from .figures import LEGEND_COLUMNS, LINE, columns_of, policy_line
from .style import COLUMN, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS = {
    "range": "m",
    "field_of_view": "rad",
    "noise": "rad",
    "bias": "rad",
    "error": "rad",
    "delay": "steps",
}


@styled
def level_figure(
    base: Scenario, field: str, labels: Sequence[str], rows: Sequence[dict[str, Any]]
) -> Figure:
    """One line for each policy in two panels, with 95 % intervals.

    Levels stand at equal distances, since the exact sensor need not be a number. Where more than
    half of the starts time out there is no median time, and no mark.

    Args:
        base: the scenario.
        field: of its sensor.
        labels: its levels.
        rows: of levels.csv.
    """
    lines = math.ceil(len({row["policy"] for row in rows}) / LEGEND_COLUMNS)
    figure = new_figure(COLUMN, 4.2 + LINE * lines)
    above, below = figure.subplots(2, 1, sharex=True)
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    limit = base.max_steps * base.tau
    counts = not np.isnan([row["clean_success"] for row in rows]).any()
    names = ("clean_success", "clean") if counts else ("success", "success")
    for policy in policies:
        own = [row for row in rows if row["policy"] == policy]
        x = np.arange(len(own))
        policy_line(above, policy, x, 100.0 * columns_of(own, *names))
        times = columns_of(own, "median_time", "time")
        met = times[0] < limit
        policy_line(below, policy, x[met], times[:, met])
    above.set(ylim=(-2, 102), ylabel=f"met {'without contact ' if counts else ''}/ % of starts")
    below.set(ylabel="median time / s")
    below.set_ylim(bottom=0.0)
    below.set_xticks(range(len(labels)), labels)
    unit = f" / {_UNITS[field]}" if field in _UNITS else ""
    below.set_xlabel(f"{field.replace('_', ' ')}{unit}")
    for axes in (above, below):
        axes.grid()
    starts = rows[0]["episodes"]
    above.set_title(f"{base.name}, {starts} starts, 95 % intervals")
    handles, names = above.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=LEGEND_COLUMNS)
    return figure
