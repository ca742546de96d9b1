"""Cases on which the claims are tried: random teams, graphs, starts, steps and limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario, graphs

Array = NDArray[np.float64]

BATCH = 40
"""Teams of one case: they share everything but start, frames, weights and adversaries."""
SIZES = (2, 3, 5, 8)


@dataclass(frozen=True)
class Case:
    """What the teams of a batch share."""

    scenario: Scenario
    margin: float
    """ε of the certified heading, or of a heading at a fixed angle to f."""
    options: dict[str, Any] = field(default_factory=dict)
    """Given parts of the start, as ``Simulator.reset`` takes them."""


FAMILIES = ("complete", "path", "cycle", "star", "random_tree", "erdos_renyi")
"""Kinds of graphs."""


def draw_case(
    random: np.random.Generator,
    batch: int,
    least_margin: float,
    *,
    dims: tuple[int, ...] = (2, 3),
    step_factors: tuple[float, float] = (1.0, 1.0),
    speed_limits: bool = True,
    **fields: Any,
) -> Case:
    """Team size, dimension, graph, weights, start, radius, frames, speed limit and ε.

    Args:
        random: draws them.
        batch: number of the batch; the team sizes take turns.
        least_margin: smallest ε.
        dims: dimensions to choose from.
        step_factors: range of τ over the certified step.
        speed_limits: whether every third team is slower than law (1).
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
    if speed_limits and not scenario.model.nonholonomic and random.random() < 1 / 3:
        changes["max_speed"] = random.uniform(0.5, 1.0) * scenario.max_degree
    scenario = scenario.replace(**changes)
    options = {"positions": _on_a_line(scenario, random)} if random.random() < 0.25 else {}
    return Case(scenario, float(random.uniform(least_margin, max(least_margin, 0.9))), options)


def _on_a_line(scenario: Scenario, random: np.random.Generator) -> Array:
    """Starts (B, n, d) with all robots of a team on one line, in any order."""
    n, d = scenario.n_robots, scenario.dim
    gaps = random.uniform(2.0, 6.0, (BATCH, n)) * scenario.merge_radius
    places = random.permuted(np.cumsum(gaps, axis=-1), axis=-1)
    direction = random.normal(size=(BATCH, 1, d))
    line: Array = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return places[..., None] * line


def draw_unlimited(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Single integrators that can move at any f_i."""
    return draw_case(random, batch, least_margin, speed_limits=False)


def draw_unicycles(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Unicycles, with any limit on their turn rate."""
    turn = float(random.uniform(1.0, 6.0))
    return draw_case(
        random, batch, least_margin, dims=(2,), robot_model="unicycle", max_turn_rate=turn
    )


def draw_3d(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """3-D nonholonomic robots, with any limit on their turn rates."""
    turn = float(random.uniform(1.0, 6.0))
    return draw_case(
        random, batch, least_margin, dims=(3,), robot_model="nonholonomic_3d", max_turn_rate=turn
    )


def draw_nonholonomic(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Either of the two."""
    draw = draw_unicycles if random.random() < 0.5 else draw_3d
    return draw(random, batch, least_margin)


def draw_long_steps(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Steps of 4 to 10 times the certified one."""
    return draw_case(random, batch, least_margin, step_factors=(4.0, 10.0))


def draw_disconnected(random: np.random.Generator, batch: int, least_margin: float) -> Case:
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
    return Case(scenario, 1.0)


def draw_trees(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Trees of eight in a narrow space: there merges make V rise."""
    scenario = Scenario(
        n_robots=8,
        dim=int(random.choice([2, 3])),
        graph=graphs.random_tree((0.5, random.uniform(0.5, 2.0))),
        merge_radius=random.uniform(0.1, 0.3),
        spawn_size=3.0,
    )
    return Case(scenario, float(random.uniform(least_margin, max(least_margin, 0.9))))
