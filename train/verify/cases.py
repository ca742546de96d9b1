"""Cases on which the claims are tried: random teams, graphs, starts, steps and limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario, graphs

from .falsification import Trial
from .random_starts import log_uniform

Array = NDArray[np.float64]

BATCH = 40
"""Teams of one case: they share everything but start, frames, weights and adversaries."""
SIZES = (2, 3, 5, 8)
FAMILIES = ("complete", "path", "cycle", "star", "random_tree", "erdos_renyi")
"""Kinds of graphs."""


def draw_team(
    random: np.random.Generator,
    batch: int,
    least_margin: float,
    *,
    by: str = "heading",
    dims: tuple[int, ...] = (2, 3),
    step_factors: tuple[float, float] = (1.0, 1.0),
    **fields: Any,
) -> Trial:
    """Team size, dimension, graph, weights, start, radius, frames, speed limit and ε.

    Args:
        random: draws them.
        batch: number of the batch; the team sizes take turns.
        least_margin: smallest ε.
        by: "law" or "heading".
        dims: dimensions to choose from.
        step_factors: range of τ over the certified step.
        **fields: of the scenario, not to be drawn.
    """
    n, dim = SIZES[batch % len(SIZES)], int(random.choice(dims))
    weight = (random.uniform(0.5, 1.0), random.uniform(1.0, 2.0))
    family = str(random.choice(FAMILIES))
    chance = (random.uniform(0.2, 0.8),) if family == "erdos_renyi" else ()
    made = getattr(graphs, family if n > 2 or family != "cycle" else "path")
    scenario = Scenario(
        n_robots=n,
        dim=dim,
        graph=made(*chance, weight),
        merge_radius=random.uniform(0.1, 0.3),
        spawn_size=random.uniform(2.0, 4.0),
        local_frames=str(random.choice(["random", "random", "global"])),
        **fields,
    )
    changes: dict[str, Any] = {}
    if step_factors != (1.0, 1.0):
        step = random.uniform(*step_factors) * scenario.certified_step
        changes |= {"time_step": step, "allow_long_step": True}
    if not scenario.model.nonholonomic and random.random() < 1 / 3:
        changes["max_speed"] = random.uniform(0.5, 1.0) * scenario.max_degree
    scenario = scenario.replace(**changes)
    starts = _on_a_line(scenario, random) if random.random() < 0.25 else ()
    return _trial(random, scenario, least_margin, by, starts)


def _trial(
    random: np.random.Generator,
    scenario: Scenario,
    least_margin: float,
    by: str = "heading",
    starts: tuple[Scenario, ...] = (),
) -> Trial:
    """Any margin, turn rate, frame and period under certified headings."""
    arguments = {"min_alignment": float(random.uniform(least_margin, max(least_margin, 0.9)))}
    frame, period = "local", 1
    if by == "heading":
        turn_rates = (1.0, 10.0) if scenario.model.nonholonomic else (0.2, 50.0)
        arguments["max_turn_rate"] = log_uniform(random, *turn_rates)
        frame = str(random.choice(["net_bearing", "local"]))
        period = int(random.choice([1, 1, 5]))
    return Trial(scenario, by, arguments, frame, period, int(random.integers(2**40)), starts=starts)


def _on_a_line(scenario: Scenario, random: np.random.Generator) -> tuple[Scenario, ...]:
    """Starts with all robots of a team on one line, in any order."""
    n, d = scenario.n_robots, scenario.dim
    gaps = random.uniform(2.0, 6.0, (BATCH, n)) * scenario.merge_radius
    places = random.permuted(np.cumsum(gaps, axis=-1), axis=-1)
    direction = random.normal(size=(BATCH, 1, d))
    line: Array = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return tuple(scenario.replace(start_positions=start) for start in places[..., None] * line)


def draw_turning(
    random: np.random.Generator, batch: int, least_margin: float, **given: Any
) -> Trial:
    """Unicycles or 3-D nonholonomic robots, of ``dims``, with any limit on their turn rates."""
    dim = int(random.choice(given.pop("dims", (2, 3))))
    model, turn = "unicycle" if dim == 2 else "nonholonomic_3d", float(random.uniform(1.0, 6.0))
    fields = {"robot_model": model, "max_turn_rate": turn, **given}
    return draw_team(random, batch, least_margin, dims=(dim,), **fields)


def draw_disconnected(random: np.random.Generator, batch: int, least_margin: float) -> Trial:
    """Two trees side by side, robots in any order."""
    n = max(SIZES[batch % len(SIZES)], 3)
    order, cut = random.permutation(n).tolist(), int(random.integers(1, n))
    edges = []
    for piece in (order[:cut], order[cut:]):
        for k in range(1, len(piece)):
            edges.append((piece[k], piece[int(random.integers(k))], random.uniform(0.5, 2.0)))
    scenario = Scenario(
        n_robots=n,
        dim=int(random.choice([2, 3])),
        graph=graphs.from_edges(edges, n),
        require_connected=False,
        spawn_size=3.0,
    )
    return _trial(random, scenario, least_margin, "law")


def draw_trees(random: np.random.Generator, batch: int, least_margin: float) -> Trial:
    """Trees of eight in a narrow space: there merges make V rise."""
    scenario = Scenario(
        n_robots=8,
        dim=int(random.choice([2, 3])),
        graph=graphs.random_tree((0.5, random.uniform(0.5, 2.0))),
        merge_radius=random.uniform(0.1, 0.3),
        spawn_size=3.0,
    )
    return replace(_trial(random, scenario, least_margin), period=1)
