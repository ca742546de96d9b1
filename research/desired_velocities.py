"""Adversarial desired velocities for energy tanks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario
from train.verify.monitors import across, unit

Array = NDArray[np.float64]
Desired = Callable[[NDArray[Any], int], Array]
"""Observations (B, n, rows, d) of a policy and step number → raw (B, n, k)."""

KINDS = ("flee", "orthogonal", "spiral", "frozen", "random", "switching", "rest", "mixed")
_SWITCHING = 7
"""Number of steps after which a switching robot reverses."""


def desired_velocities(
    scenario: Scenario, num_envs: int, random: np.random.Generator, kind: str = "mixed"
) -> Desired:
    """Velocities in units of v_max; controls in units of their bounds for other models.

    Args:
        scenario: the experiment.
        num_envs: B.
        random: random number generator.
        kind: one of KINDS; "mixed" gives each robot its own kind. Nonholonomic robots are always
            mixed.
    """
    if scenario.model.nonholonomic:
        return _controls(scenario, num_envs, random)
    size = num_envs, scenario.n_robots, scenario.dim
    frozen = random.normal(size=size)
    own = random.permuted(np.arange(size[0] * size[1]) % (len(KINDS) - 1)).reshape(size[:2])

    def choose(seen: NDArray[Any], step: int) -> Array:
        f = scenario.observation_layout.net_bearing(seen)
        ahead = unit(f)
        side = unit(across(ahead, frozen)) * np.sign(frozen[..., :1])
        desired = {
            "flee": -ahead,
            "orthogonal": side,
            "spiral": side - 0.4 * ahead,
            "frozen": frozen,
            "random": random.normal(size=size) * random.uniform(0, 2, (*size[:2], 1)),
            "switching": ahead if step // _SWITCHING % 2 else -ahead,
            "rest": np.zeros(size),
        }
        if kind != "mixed":
            return desired[kind]
        return np.asarray(np.choose(own[..., None], list(desired.values())))

    return choose


def _controls(scenario: Scenario, num_envs: int, random: np.random.Generator) -> Desired:
    """Constant controls, random ones, or backwards: away from f at full speed."""
    size = num_envs, scenario.n_robots, scenario.action_size
    frozen, own = random.uniform(-1, 1, size), np.arange(size[1])[:, None] % 3

    def choose(seen: NDArray[Any], step: int) -> Array:
        backwards = np.zeros(size)
        backwards[..., 0] = -np.sign(scenario.observation_layout.net_bearing(seen)[..., 0])
        return np.choose(own, [frozen, random.uniform(-1.5, 1.5, size), backwards])

    return choose
