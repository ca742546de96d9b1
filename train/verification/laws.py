"""The laws and policies that claims are about."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

import baselines
from rendezvous_env.guarantee.gains import Gains
from rendezvous_env.guarantee.heading import flexible_velocity
from rendezvous_env.trajectory import Policy

from .adversaries import Steered, across, adversary
from .cases import Case
from .claim import Array, Law


def by_name(name: str) -> Law:
    """A scripted policy."""
    return lambda case, num_envs, random: baselines.make(name, case.scenario)


def unicycle_laws(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """(7) with (8), or with ω = cos t."""
    name = str(random.choice(["unicycle", "unicycle-cosine"]))
    return baselines.make(name, case.scenario)


def certified(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All adversaries under the certified heading, or under the gate."""
    scenario = case.scenario
    turn_rate = float(random.uniform(1.0, 10.0))
    return Steered(
        scenario,
        num_envs,
        adversary(scenario, num_envs, random, max_turn_rate=turn_rate),
        decision_period=int(random.choice([1, 1, 5])),
        min_alignment=case.margin,
        max_turn_rate=turn_rate,
        frame=str(random.choice(["net_bearing", "local"])),
    )


def at_fixed_angle(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (4) with hᵀf = ε‖f‖ always, each robot to a side of its own."""
    scenario, epsilon = case.scenario, case.margin
    axis = random.normal(size=(num_envs, scenario.n_robots, scenario.dim))
    side = random.choice([-1.0, 1.0], size=(num_envs, scenario.n_robots, 1))

    def policy(observations: NDArray[np.float32], time: Array) -> NDArray[np.float32]:
        f = scenario.observation_layout.net_bearing(observations)
        h = epsilon * _unit(f) + side * math.sqrt(1 - epsilon**2) * _unit(across(f, axis))
        return flexible_velocity(f, h).astype(np.float32)

    return policy


def weighted(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Any weights of neighbours under theorem G: one neighbour, whoever is most against the rest,
    or drawn anew in every step.
    """
    scenario = case.scenario
    gains, layout = Gains(scenario, num_envs, frame="local"), scenario.observation_layout
    kinds = random.integers(3, size=(num_envs, scenario.n_robots, 1))
    liking = random.random((num_envs, scenario.n_robots, layout.neighbour_slots))

    def policy(observations: NDArray[np.float32], time: Array) -> NDArray[np.float32]:
        rows = layout.split(observations).neighbours.astype(np.float64)
        seen = np.any(rows, axis=-1)
        against = -np.sum(_unit(rows) * rows.sum(axis=-2, keepdims=True), axis=-1)
        score = np.where(kinds == 0, liking, against)
        score[~seen] = -np.inf
        one = score == score.max(axis=-1, keepdims=True)
        gains.hold(np.where(kinds == 2, random.random(liking.shape), one))
        return gains.act(observations)

    return policy


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
