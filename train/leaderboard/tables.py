"""Tables and figures of run records: interquartile means, profiles, the cost of a guarantee."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from rendezvous_env.checks import counted

from ..compare import statistics
from ..figures import style
from ..results import grouped

COLUMNS = (
    "algorithm", "safety", "guarantee", "given", "runs", "collision_free", "collision_free_low",
    "collision_free_high", "time", "time_low", "time_high", "robot_steps", "touches", "risen",
    "rise",
)  # fmt: skip
"""Columns of leaderboard.csv. Runs are seeds times scenarios.

Over runs: interquartile means with intervals of collision-free success and of the mean rendezvous
time, s (the time limit without success). Per thousand robot steps: contacts, and increases of V
between merges without contact, which theorem C excludes. Over episodes: mean sum of increases of V,
in per cent of the initial V."""
IMPROVEMENT = ("algorithm", "against", "probability", "low", "high")
"""Columns of improvement.csv: probability that a run has more collision-free success."""
WIDTH = 175
"""Width of the table, characters."""
_LEVELS = np.linspace(0.0, 1.0, 101)
RunRecord = Mapping[str, Any]


def scores_of(cards: Sequence[RunRecord], name: str) -> NDArray[np.float64]:
    """Mean of "collision_free" or "time" over initial conditions for one algorithm, (S, F).

    Rows are the first S runs of each of F scenarios, with S the number available in all of them.
    """
    fields = grouped(cards, "field").values()
    recorded = {"collision_free": "clean"}.get(name, name)
    means = ([float(np.mean(card["results"][recorded])) for card in own] for own in fields)
    return np.array(list(zip(*means, strict=False)))


def rows_of(cards: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Rows of leaderboard.csv, sorted by collision-free success."""
    rows = []
    for name, own in grouped(cards, "algorithm").items():
        about = {key: own[0][key] for key in ("safety", "guarantee", "given")}
        row = {"algorithm": name, **about}
        for key in ("collision_free", "time"):
            scores = scores_of(own, key)
            row["runs"] = scores.size
            low, high = statistics.stratified_interval((scores,), statistics.interquartile_mean)
            row[key] = statistics.interquartile_mean(scores)
            row |= {f"{key}_low": low, f"{key}_high": high}
        row["robot_steps"] = steps = sum(sum(card["results"]["steps"]) for card in own)
        for key in ("touches", "risen"):
            row[key] = 1000.0 * sum(sum(card["results"][key]) for card in own) / steps
        row["rise"] = 100.0 * float(np.mean([np.mean(card["results"]["rise"]) for card in own]))
        rows.append(row)
    return sorted(rows, key=lambda row: (-row["collision_free"], row["time"]))


def improvements(cards: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Rows of improvement.csv: each pair of algorithms once, on their common scenarios."""
    own, rows, chance = grouped(cards, "algorithm"), [], statistics.probability_of_improvement
    for pair in combinations(own, 2):
        both = set.intersection(*({card["field"] for card in own[name]} for name in pair))
        if both:
            first, second = (
                scores_of([card for card in own[name] if card["field"] in both], "collision_free")
                for name in pair
            )
            ends = statistics.stratified_interval((first, second), chance)
            values = (*pair, chance(first, second), *ends)
            rows.append(dict(zip(IMPROVEMENT, values, strict=True)))
    return rows


def _cells(row: Mapping[str, Any]) -> list[str]:
    def with_interval(key: str, form: str, unit: float = 1.0) -> str:
        value, low, high = (row[k] * unit for k in (key, f"{key}_low", f"{key}_high"))
        ends = "" if np.isnan(low) else f" ({low:{form}} to {high:{form}})"
        return f"{value:{form}}{ends}"

    return [
        *(row[key] for key in ("algorithm", "safety", "guarantee", "given")),
        with_interval("collision_free", ".1f", 100.0),
        with_interval("time", ".1f"),
        f"{row['touches']:.3g}",
        "0" if row["risen"] == 0 else f"{row['risen']:.3g}",
        f"{row['rise']:.2g}",
        f"{row['robot_steps'] / 1e6:.2f}",
    ]


_HEADS = (
    "algorithm", "safety", "guarantee", "reads", "collision-free, %", "time, s",
    "touches, ‰", "V rose, ‰", "rise, % of V₀", "robot steps, 10⁶",
)  # fmt: skip


def text(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Table for a terminal."""
    table = Table(*_HEADS, box=None)
    for row in rows:
        table.add_row(*_cells(row))
    return table


def markdown(rows: Sequence[Mapping[str, Any]], cards: Sequence[RunRecord]) -> str:
    """README of the folder: the table, definitions, and the command that repeats a run."""
    seeds = len({card["seed"] for card in cards})
    fields = ", ".join(sorted({card["field"] for card in cards}))
    most = max(card["decisions"] for card in cards)
    lines = [_HEADS, ["---"] * len(_HEADS), *map(_cells, rows)]
    told = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    minutes = sum(card["learning_s"] + card["playing_s"] for card in cards) / 60.0
    return (
        f"# Leaderboard\n\n{fields}; {counted(seeds, 'seed')}; {most:,} decisions of robots for "
        f"each learner; {counted(cards[0]['episodes'], 'held-out initial condition')} a run; "
        f"{minutes:.0f} minutes in all, run after run.\n\n"
        f"{told}\n\nInterquartile means over runs with 95 % intervals, a bootstrap over seeds "
        "stratified by scenario; methods without learning have one run per scenario. V rose: robot "
        "steps in which V rose between merges without a contact in the team, which theorem C "
        "excludes.\n\n"
        "`cells/` has a record of each run: settings, versions, digest of the scenario and numbers "
        "of every episode. `rendezvous leaderboard --repeat RECORD` repeats it. `replays/` has "
        "two episodes per algorithm and scenario, which the page of `rendezvous report` shows.\n"
    )


@style.styled
def draw(out: Path, cards: Sequence[RunRecord], rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw price.png and profiles.png.

    price.png shows collision-free success and time against the rate of increases of V; profiles.png
    shows the fraction of runs above each level of collision-free success.
    """
    from matplotlib import colormaps

    # lighter from the eleventh on
    colours = [colormaps["tab20"](2 * (k % 10) + (k // 10) % 2) for k in range(len(rows))]
    price, profiles = style.new_figure(style.PAGE, 3.2), style.new_figure(style.PAGE, 3.2)
    marks = {"none": "o", "heading": "s", "tank": "D"}
    panels = (("collision_free", 100.0, "collision-free success, %"), ("time", 1.0, "time, s"))
    for panel, (key, unit, label) in zip(price.subplots(1, 2), panels, strict=True):
        for row, colour in zip(rows, colours, strict=True):
            ends = [abs(unit * (row[f"{key}_{end}"] - row[key])) for end in ("low", "high")]
            bars = None if np.isnan(ends).any() else [[ends[0]], [ends[1]]]
            said = f"{row['algorithm']} ({row['guarantee']})"
            mark = {"fmt": marks[row["guarantee"]], "color": colour, "capsize": 2}
            panel.errorbar(0.1 * row["risen"], unit * row[key], bars, label=said, **mark)
        panel.axvline(0.0, color="0.8", zorder=0)
        panel.set(xlabel="steps in which V rose, %", ylabel=label)
    price.legend(*panel.get_legend_handles_labels(), loc="outside right center")
    panel = profiles.subplots()
    for k, (name, own) in enumerate(grouped(cards, "algorithm").items()):
        profile = statistics.performance_profile(scores_of(own, "collision_free"), _LEVELS)
        look: dict[str, Any] = {"linestyle": ("-", "--", ":")[k % 3], "color": colours[k]}
        panel.step(100.0 * _LEVELS, profile, where="post", label=name, **look)
    panel.set(xlabel="collision-free success, %", ylabel="share of runs that reach it")
    profiles.legend(*panel.get_legend_handles_labels(), loc="outside right center")
    style.save(price, out / "price.png")
    style.save(profiles, out / "profiles.png")
