"""``rendezvous list``: scenarios and policies, one line each, and which policies fit which."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from string import ascii_uppercase
from typing import Literal

from rendezvous_env.baselines.policy import KINDS
from rich.table import Table
from tyro.conf import Positional

from rendezvous_env import baselines
from rendezvous_env.checks import counted
from rendezvous_env.engine.preparation import has_fixed_start
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.obstacles.moving import moving_slots
from rendezvous_env.obstacles.walls import WallField
from rendezvous_env.scenario import scenarios
from rendezvous_env.scenario.scenario import Scenario

from . import policies
from .checks import Flags
from .console import Console

EXAMPLES = ("scenarios", "policies")


@dataclass(frozen=True)
class Config(Flags):
    """List scenarios and policies, one line each, with the scenarios that each policy fits."""

    what: Positional[Literal["all", "scenarios", "policies"]] = "all"
    """Kind of entries to list."""


def run(config: Config) -> int:
    """Print the list."""
    console = Console()
    listed: list[tuple[str, list[tuple[str, ...]]]] = []
    if config.what != "policies":
        listed.append(("", [(n, describe(scenarios.get(n))) for n in scenarios.names()]))
    if config.what != "scenarios":
        listed += _policies()
    for title, rows in listed:
        table = Table.grid(padding=(0, 2, 0, 0))
        for _ in rows[0][:-1]:
            table.add_column(no_wrap=True)
        for row in rows:
            table.add_row(*row)
        if title:
            console.print(f"\n{title}", style="bold")
        console.print(table)
    return 0


def _policies() -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Policies by kind: titles and lines with a matrix of fitting scenarios."""
    fitting = {name: baselines.names(scenarios.get(name)) for name in scenarios.names()}
    columns = columns_of(fitting)
    for kind, title in KINDS.items():
        rows: list[tuple[str, ...]] = [("", " ".join(columns), "")]
        for name in baselines.names():
            if policies.kind_of(name) == kind:
                marks = ("●" if name in fitting[own[0]] else "·" for own in columns.values())
                rows.append((name, " ".join(marks), policies.about(name)))
        if len(rows) > 1:
            yield title, rows
    yield (
        "scenarios that the same policies fit",
        [(letter, ", ".join(own)) for letter, own in columns.items()],
    )


def columns_of(fitting: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Groups of scenarios that the same policies fit, by letter, largest group first."""
    groups: dict[frozenset[str], list[str]] = {}
    for scenario, names in fitting.items():
        groups.setdefault(frozenset(names), []).append(scenario)
    ordered = sorted(groups.values(), key=len, reverse=True)
    return dict(zip(ascii_uppercase, ordered, strict=False))


def describe(scenario: Scenario) -> str:
    """One-line summary of a scenario from its fields; single integrators are the default."""
    where = "in the plane" if scenario.dim == 2 else "in 3-D"
    parts = [f"{scenario.n_robots} robots {where}"]
    if scenario.robot_model != "single_integrator":
        parts.append(scenario.model.name.replace("_", " "))
    graph = scenario.sensing_graph
    low, high = graph.weight_range
    gains = "" if low == high else f" with gains of {low:g} to {high:g} m/s"
    parts.append(f"{graph.kind.replace('_', ' ')} graph{gains}")
    if scenario.obstacles:
        passed = ", which robots pass through" if scenario.obstacle_contact == "ignore" else ""
        parts.append(f"{_obstacles(scenario)}{passed}")
    if not scenario.sensing.exact:
        parts.append(f"sensing with {scenario.sensing.departures()}")
    if not scenario.activation.synchronous:
        parts.append(f"activation {scenario.activation}, hold = {scenario.hold!r}")
    if not scenario.events.none:
        parts.append(f"events with {scenario.events}")
    parts += ["given initial condition"] if has_fixed_start(scenario) else []
    return ", ".join(parts)


def _obstacles(scenario: Scenario) -> str:
    field = scenario.obstacles
    if isinstance(field, ObstacleField):
        low, high = field.count_range
        count = f"{low}" if low == high else f"{low} to {high}"
        return f"{count} drawn {'discs' if scenario.dim == 2 else 'spheres'}"
    if isinstance(field, WallField):
        return f"{field.layout} of drawn walls"
    moving = len(moving_slots(field))
    if not moving:
        return counted(len(field), "fixed obstacle")
    return f"{counted(len(field), 'obstacle')}, {moving} moving"
