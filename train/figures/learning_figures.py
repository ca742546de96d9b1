"""Figures of learning and of energy tanks: how training went, how a robot spends what its tank
holds, and what margin and budget of a tank buy (``reproduce tank``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import baselines
from rendezvous_env.safety.theorems.certificate import certificate
from rendezvous_env.scenario import scenarios
from rendezvous_env.trajectory import rollout

from .. import results
from .figures import BLACK, BLUE, GREY, ROBOT_COLOURS, VERMILLION
from .style import COLUMN, PAGE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = (VERMILLION, BLUE, BLACK)
_FIRST_UPDATES = 8
"""Not drawn: all teams begin together, so that quick episodes end first and the others at once."""


@styled
def learning_figure(runs: Mapping[str, Path], scenario: str) -> Figure:
    """Clean success over decisions: held-out starts with 95 % intervals, and training itself.

    Dots are what the likeliest choices reach, thin lines what training itself saw while it
    explored, on other starts.

    Args:
        runs: folder with metrics.csv and evaluation.csv, by the name that is shown.
        scenario: name of the one whose held-out starts are drawn.

    Raises:
        OSError: if a file cannot be read.
    """
    figure = new_figure(COLUMN, 2.6)
    axes = figure.add_subplot()
    for colour, (name, folder) in zip(_COLOURS * len(runs), runs.items(), strict=False):
        metrics = results.read_csv(folder / "metrics.csv")
        steps, share = _columns(metrics[_FIRST_UPDATES:], "clean_success")
        axes.plot(steps, 100 * share, color=colour, linewidth=0.6, alpha=0.5)
        evaluated = results.read_csv(folder / "evaluation.csv")
        _draw_held_out(
            axes, [row for row in evaluated if row["scenario"] == scenario], colour, name
        )
    axes.set(xlabel="decisions / million", ylabel="met without a contact / %", ylim=(None, 100.5))
    axes.grid()
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _columns(
    rows: Sequence[Mapping[str, str]], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (
        np.array([float(row["step"]) for row in rows]) / 1e6,
        np.array([float(row[name]) for row in rows]),
    )


def _draw_held_out(axes: Axes, rows: Sequence[Mapping[str, str]], colour: str, name: str) -> None:
    steps, share = _columns(rows, "clean_success")
    low, high = (_columns(rows, end)[1] for end in ("clean_low", "clean_high"))
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
    """V of a team, and the level of each robot's tank, over time.

    Args:
        times: (T,), s.
        lyapunov: V, (T,), m²/s.
        levels: A, (T, n), m²/s.
        active: (T, n), which robots are there.
    """
    figure = new_figure(COLUMN, 3.6)
    above, below = figure.subplots(2, 1, sharex=True)
    total = lyapunov + np.where(active, levels, 0.0).sum(axis=1)
    above.plot(times, total, color=GREY, label="V + ΣA, which does not rise")
    above.plot(times, lyapunov, color=BLUE, label="V")
    above.set(ylabel="V / (m²/s)", ylim=(0, None))
    for robot in range(levels.shape[1]):
        shown = np.where(active[:, robot], levels[:, robot], np.nan)
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        below.plot(times, shown, color=colour, label=f"robot {robot}")
    below.set(xlabel="time / s", ylabel="level A of a tank / (m²/s)", ylim=(0, None))
    for axes in (above, below):
        axes.grid()
        axes.legend()
    return figure


def watch_tanks(scenario: Any, policy: Any, seed: int) -> dict[str, NDArray[Any]]:
    """One episode of a policy with tanks: the arguments of ``tank_figure``, and contacts (T,).

    Args:
        scenario: the experiment.
        policy: with ``levels``, (..., n).
        seed: of the start.
    """
    from rendezvous_env.simulator import Simulator
    from rendezvous_env.trajectory import run

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


TANK_SCENARIO, TANK_POLICY = "clutter-24", "tank-joined"
MARGINS = (0.05, 0.1, 0.2, 0.4, 0.8)
BUDGETS = (0.0, 20.0)
"""m²/s."""
TANK_COLUMNS = (
    "budget",
    "min_alignment",
    "episodes",
    "clean_success",
    "success",
    "contact",
    "bound",
)
_TANK_COLOURS = (BLUE, VERMILLION)


def measure_tanks(episodes: int, seed: int) -> Iterator[dict[str, Any]]:
    """One row for each budget and margin, all from the same starts.

    Args:
        episodes: starts for each.
        seed: of the first start.
    """
    scenario = scenarios.get(TANK_SCENARIO)
    for budget in BUDGETS:
        for margin in MARGINS:
            options = {"budget": budget, "min_alignment": margin}
            policy = baselines.make(TANK_POLICY, scenario, **options)
            found = rollout(scenario, policy, seed=seed, num_envs=episodes, record=())
            touched = found.contacts.any(axis=(0, 2))
            yield {
                **options,
                "episodes": episodes,
                "clean_success": float((found.success & ~touched).mean()),
                "success": float(found.success.mean()),
                "contact": float(touched.mean()),
                "bound": tank_bound(margin, budget),
            }


def tank_bound(margin: float, budget: float) -> float:
    """Theorem D's time bound for the same team with nothing in its way, s."""
    free = scenarios.get(TANK_SCENARIO).replace(obstacles=())
    return certificate(free, margin, by="tank", budget=budget).time_bound


@styled
def tank_tradeoff_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Clean success and the bound against ε, one line for each budget.

    Args:
        rows: as ``measure_tanks`` gives them.
    """
    figure = new_figure(PAGE, 2.6)
    left, right = figure.subplots(1, 2)
    for budget, colour in zip(BUDGETS, _TANK_COLOURS, strict=True):
        line = [row for row in rows if row["budget"] == budget]
        margins = [row["min_alignment"] for row in line]
        label = f"B = {budget:g} m²/s"
        left.plot(
            margins, [100 * row["clean_success"] for row in line], "o-", color=colour, label=label
        )
        right.plot(margins, [row["bound"] for row in line], "o-", color=colour, label=label)
    starts = rows[0]["episodes"]
    left.set(ylim=(0, 103), ylabel="met without a contact / %")
    left.set(title=f"What is reached: {TANK_SCENARIO}, {starts} starts")
    right.set(yscale="log", ylabel="time bound / s")
    right.set(title="What theorem D promises with nothing in the way")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="alignment margin ε")
        axes.set_xticks(MARGINS, [f"{margin:g}" for margin in MARGINS])
        axes.minorticks_off()
        axes.grid()
    left.legend(loc="lower left")
    return figure
