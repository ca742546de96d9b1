"""What V must fall in a step without a merge."""

from __future__ import annotations

import numpy as np

from rendezvous_env import Scenario
from rendezvous_env.trajectory import Step

from .claim import Array


def anything(scenario: Scenario, step: Step) -> Array:
    """Nothing."""
    return np.full(len(step.running), -np.inf)


def no_rise(scenario: Scenario, step: Step) -> Array:
    """V does not rise."""
    return np.zeros(len(step.running))


def by_law_1(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ f_iᵀu_i with u_i = f_i, within the speed limit (theory 4), m²/s."""
    f = scenario.observation_layout.net_bearing(step.observations)
    return scenario.tau * np.sum(f * _limited(f, scenario), axis=(-2, -1))


def as_chosen(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ f_iᵀu_i with what the law chose, at least 0 (theory 4), m²/s."""
    f = scenario.observation_layout.net_bearing(step.observations)
    u = _limited(step.actions.astype(np.float64), scenario)
    return scenario.tau * np.maximum(np.sum(f * u, axis=(-2, -1)), 0.0)


def _limited(velocities: Array, scenario: Scenario) -> Array:
    """Velocities (..., d) scaled to the speed limit, m/s."""
    speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
    return velocities * (scenario.speed_limit / np.maximum(speed, scenario.speed_limit))
