"""``rendezvous reproduce bounds``: certified time bounds over simulated rendezvous times."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env import baselines

from .. import results
from ..checks import UserError
from ..verify.falsification import guarded

Array = NDArray[np.float64]


ROWS = (
    *[("law", team) for team in ("ring-12", "complete-10", "path-10")],
    *[("gains", team) for team in ("complete-10", "cycle-10")],
    *[("heading", team) for team in ("complete-10", "path-10", "cycle-10")],
    *[("tank", team) for team in ("complete-10", "cycle-10")],
    *[("links", team) for team in ("complete-10", "cycle-10")],
)
"""Guarantees and scenarios of the rows."""
COLUMNS = {
    "by": "law or filter", "graph": "graph", "median": "median (s)", "longest": "longest (s)",
    "bound": "bound (s)", "own_bound": "own bound (s)", "ratio": "own bound / median",
}  # fmt: skip
"""Columns of bounds.csv and their headings on the page. The bounds are that of any initial
condition in the spawn area, and the median over the simulated ones, which the ratios use."""
_MARGIN = 0.1
"""Minimum alignment ε of headings and tanks."""
_MOST_STEPS = 100_000
_NAMES = {
    "law": "law (1)",
    "gains": "gains",
    "heading": f"headings, ε = {_MARGIN:g}",
    "tank": f"tank, ε = {_MARGIN:g}",
    "links": "links",
}


def measure(rows: Sequence[tuple[str, str]], teams: int, seed: int) -> Iterator[dict[str, Any]]:
    """Rows with COLUMNS: rendezvous times under random actions, and time bounds.

    ``seed`` is the seed of the first environment and of the random actions.
    """
    for by, graph in rows:
        scenario = scenario_of(graph)
        given = {"min_alignment": _MARGIN} if by in ("heading", "tank") else {}
        starts, times = times_to_meet(scenario, by, given, teams, seed)
        any_start, *own = (
            rv.certificate(one, by=by, **given).time_bound
            for one in (scenario, *(scenario.replace(start_positions=start) for start in starts))
        )
        middle, bound = float(np.median(times)), float(np.median(own))
        values = by, graph, middle, float(times.max()), any_start, bound, bound / middle
        yield dict(zip(COLUMNS, values, strict=True))


def scenario_of(graph: str) -> rv.Scenario:
    """Named scenario, or a scenario of a graph type and number of robots with defaults."""
    if graph in rv.scenarios.names():
        return rv.scenarios.get(graph)
    kind, _, count = graph.partition("-")
    return rv.Scenario(n_robots=int(count), graph=kind)


def times_to_meet(
    scenario: rv.Scenario, by: str, arguments: Mapping[str, float], teams: int, seed: int
) -> tuple[Array, Array]:
    """Initial positions (B, n, d), m, and rendezvous times (B,), s, under random actions.

    Times are inf after a time-out.
    """
    env = rv.make_vec(scenario, teams, autoreset_mode="Disabled", max_cycles=_MOST_STEPS)
    wrapped, random = guarded(env, by, arguments), np.random.default_rng([seed, 1])
    law, simulator = baselines.make("bearing-only", scenario), env.simulator
    observations, _ = wrapped.reset(seed=seed)
    starts, met = simulator.positions, np.full(teams, np.inf)
    while not simulator.ended.all():
        if by == "law":
            chosen = law(observations, simulator.time)
        else:
            low = 0.0 if by == "gains" else -1.0
            chosen = random.uniform(low, 1.0, wrapped.action_space.shape).astype(np.float32)
        observations, *_ = wrapped.step(chosen)
        now = (simulator.active.sum(axis=-1) == 1) & np.isinf(met)
        met[now] = simulator.time[now]
    return starts, met


def table_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of a Markdown table."""

    def cell(value: float) -> str:
        return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"

    _, _, *times = COLUMNS
    lines = [(_NAMES[row["by"]], row["graph"], *(cell(row[n]) for n in times)) for row in rows]
    head, *body = (f"| {' | '.join(cells)} |" for cells in (COLUMNS.values(), *lines))
    return [head, "|---|---" + "|--:" * len(times) + "|", *body]


def write_into(page: Path, table: Sequence[str]) -> None:
    """Replace the table with the same header in a Markdown page."""
    lines = page.read_text(encoding="utf-8").split("\n")
    if table[0] not in lines:
        raise UserError(f"--page is {page}, which has no table that begins with {table[0]}")
    first = last = lines.index(table[0])
    while last < len(lines) and lines[last].startswith("|"):
        last += 1
    lines[first:last] = table
    results.write_text(page, "\n".join(lines))
