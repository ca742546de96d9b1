"""What margin and budget of an energy tank buy, and what they promise: ``reproduce tank``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import baselines
from rendezvous_env.experiment import scenarios
from rendezvous_env.guarantee.certificate import certificate
from rendezvous_env.trajectory import rollout

from .figures import BLUE, VERMILLION
from .style import PAGE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENARIO, POLICY = "clutter-24", "tank-joined"
MARGINS = (0.05, 0.1, 0.2, 0.4, 0.8)
BUDGETS = (0.0, 20.0)
"""m²/s."""
COLUMNS = ("budget", "min_alignment", "episodes", "clean_success", "success", "contact", "bound")
_COLOURS = (BLUE, VERMILLION)


def measured(episodes: int, seed: int) -> Iterator[dict[str, Any]]:
    """One row for each budget and margin, all from the same starts.

    Args:
        episodes: starts for each.
        seed: of the first start.
    """
    scenario = scenarios.get(SCENARIO)
    for budget in BUDGETS:
        for margin in MARGINS:
            options = {"budget": budget, "min_alignment": margin}
            policy = baselines.make(POLICY, scenario, **options)
            found = rollout(scenario, policy, seed=seed, num_envs=episodes, record=())
            touched = found.contacts.any(axis=(0, 2))
            yield {
                **options,
                "episodes": episodes,
                "clean_success": float((found.success & ~touched).mean()),
                "success": float(found.success.mean()),
                "contact": float(touched.mean()),
                "bound": bound(margin, budget),
            }


def bound(margin: float, budget: float) -> float:
    """Theorem D's time bound for the same team with nothing in its way, s."""
    free = scenarios.get(SCENARIO).replace(obstacles=())
    return certificate(free, margin, by="tank", budget=budget).time_bound


@styled
def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Clean success and the bound against ε, one line for each budget.

    Args:
        rows: as ``measured`` gives them.
    """
    figure = new_figure(PAGE, 2.6)
    left, right = figure.subplots(1, 2)
    for budget, colour in zip(BUDGETS, _COLOURS, strict=True):
        line = [row for row in rows if row["budget"] == budget]
        margins = [row["min_alignment"] for row in line]
        label = f"B = {budget:g} m²/s"
        left.plot(
            margins, [100 * row["clean_success"] for row in line], "o-", color=colour, label=label
        )
        right.plot(margins, [row["bound"] for row in line], "o-", color=colour, label=label)
    starts = rows[0]["episodes"]
    left.set(ylim=(0, 103), ylabel="met without a contact / %")
    left.set(title=f"What is reached: {SCENARIO}, {starts} starts")
    right.set(yscale="log", ylabel="time bound / s")
    right.set(title="What theorem D promises with nothing in the way")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="alignment margin ε")
        axes.set_xticks(MARGINS, [f"{margin:g}" for margin in MARGINS])
        axes.minorticks_off()
        axes.grid()
    left.legend(loc="lower left")
    return figure
