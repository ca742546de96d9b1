"""Tables of docs/scenarios.md: measures from the literature, for the laws that fit.

``python research/field_tables.py huettenrauch`` or ``rssdoa`` prints one as Markdown.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray
from tyro.conf import Positional

import baselines
from baselines.policy import kind_of
from rendezvous_env import Scenario, scenarios
from rendezvous_env.trajectory import Trajectory, rollout

Array = NDArray[np.float64]

_PENALTY = 0.001
"""Action penalty in the reward of Hüttenrauch et al."""
_WORLD = 100.0
"""Edge of their world, m."""
_NOISES = (0.0, 0.1, 0.35, 1.0)
"""Noise levels, rad; the second and third occur in versions of RSSDOA's main file."""
_SLOW = ("privileged-circumcentre",)
"""Laws that compute a smallest ball per robot and step in Python, which would take minutes."""


@dataclasses.dataclass(frozen=True)
class Config:
    """Print a table of docs/scenarios.md."""

    table: Positional[Literal["huettenrauch", "rssdoa"]]
    """Name of the table."""
    episodes: int = 100
    """Number of initial conditions per row."""
    seed: int = 0
    """First seed: initial condition k has the seed SEED + k."""


def diameter(positions: Array) -> Array:
    """Largest distance between robots of a team, max_ij ‖p_i − p_j‖.

    Args:
        positions: (..., n, d), m.

    Returns:
        (...), m.
    """
    ways = positions[..., np.newaxis, :, :] - positions[..., np.newaxis, :]
    return np.asarray(np.linalg.norm(ways, axis=-1).max(axis=(-2, -1)))


def reward(positions: Array, actions: Array, sight: float) -> Array:
    """Reward of one step (Hüttenrauch, Šošić & Neumann, 2019, as released).

        −mean over pairs of min(d, r_c)/r_c − 0.001 mean of u²

    Args:
        positions: positions after the step, (..., n, d), m.
        actions: u, in units of their bounds, (..., n, a).
        sight: r_c, m.

    Returns:
        (...).
    """
    first, second = np.triu_indices(positions.shape[-2], 1)
    distances = np.linalg.norm(positions[..., first, :] - positions[..., second, :], axis=-1)
    apart = np.mean(np.minimum(distances, sight) / sight, axis=-1)
    return np.asarray(-apart - _PENALTY * np.mean(actions**2, axis=(-2, -1)))


def mean_reward(found: Trajectory) -> Array:
    """Mean reward (B,) over all steps of an episode without early termination.

    After rendezvous, a team rests, with zero reward and cost.

    Args:
        found: a rollout with recorded actions.
    """
    scenario = found.scenario
    sight = scenario.sensing.range or _WORLD * math.sqrt(2.0)
    earned = np.zeros(len(found.success))
    for t, running in enumerate(found.running):
        acting = (found.active[t] & running[:, np.newaxis])[..., np.newaxis]
        shares = np.where(acting, found.actions[t] / scenario.action_bounds, 0.0)
        earned += np.where(running, reward(found.positions[t + 1], shares, sight), 0.0)
    return earned / scenario.max_steps


def _huettenrauch(config: Config) -> Iterator[Sequence[str]]:
    yield "scenario", "law", "collision-free success", "median time, s", "mean reward"
    for name in ("huettenrauch-20", "huettenrauch-20-sight-40"):
        scenario = scenarios.get(name)
        for law in _laws(scenario):
            found = _played(scenario, law, config, record="actions")
            earned = mean_reward(found)
            spread = earned.std() / math.sqrt(len(earned))
            yield name, law, *_shares(found), f"{earned.mean():.4f} ± {spread:.4f}"


def _rssdoa(config: Config) -> Iterator[Sequence[str]]:
    yield "σ, rad", "law", "success", "median time, s", "final diameter, m: median, 90 %"
    scenario = scenarios.get("rssdoa-15")
    laws = [name for name in _laws(scenario) if name not in _SLOW]
    references = [name for name in laws if kind_of(name) == "privileged"]
    for noise in _NOISES:
        noisy = scenario.replace(sensing=dataclasses.replace(scenario.sensing, noise=noise))
        for law in laws:
            if kind_of(law) not in ("privileged", "blind"):
                yield f"{noise:g}", *_ends_row(noisy, law, config)
    for law in references:  # their bearings have no noise
        yield "any", *_ends_row(scenario, law, config)


def _laws(scenario: Scenario) -> list[str]:
    """Policies that fit, except those trained for other tasks."""
    return [name for name in baselines.names(scenario) if kind_of(name) != "learned"]


def _played(scenario: Scenario, law: str, config: Config, record: str = "") -> Trajectory:
    policy = baselines.make(law, scenario)
    return rollout(scenario, policy, config.seed, config.episodes, record=record.split())


def _ends_row(scenario: Scenario, law: str, config: Config) -> tuple[str, ...]:
    found = _played(scenario, law, config)
    middle, high = np.quantile(diameter(found.positions[-1]), (0.5, 0.9))
    return law, *_shares(found), f"{middle:.2f}, {high:.2f}"


def _shares(found: Trajectory) -> tuple[str, str]:
    clean, middle = (
        found.success & ~found.contacts.any(axis=(0, 2)),
        np.median(found.rendezvous_time),
    )
    return f"{100 * clean.mean():.0f} %", f"{middle:.1f}" if math.isfinite(middle) else "–"


def markdown(rows: Iterator[Sequence[Any]]) -> Iterator[str]:
    """Lines of a table with a header row."""
    head = next(rows)
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def run_table(config: Config) -> None:
    """Print the table row by row."""
    rows = {"huettenrauch": _huettenrauch, "rssdoa": _rssdoa}[config.table](config)
    for line in markdown(rows):
        print(line, flush=True)


if __name__ == "__main__":
    run_table(tyro.cli(Config))
