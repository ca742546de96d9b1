"""Policies that try to break the guarantee: raw headings and turn rates nobody should choose.

Each robot of a batch gets a kind of its own; half of the teams have the same kind throughout.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import baselines
from baselines.laws.paper_laws import pitch_of
from rendezvous_env import Scenario
from rendezvous_env.safety.heading import HeadingFilter, flexible_velocity
from rendezvous_env.safety.settings import MAX_TURN_RATE
from rendezvous_env.trajectory import Policy

from .adversarial_bearings import across, unit
from .cases import Case
from .claim import Law

Array = NDArray[np.float64]
Adversary = Callable[[NDArray[Any], ArrayLike], Array]
"""Observations (B, n, rows, d) as the policy sees them and times (B,) in s → raw (B, n, k)."""

KINDS = ("random", "frozen", "orthogonal", "spinning")
_FASTEST_SPIN = 20.0
_TINY = 1e-12


class Steered:
    """An adversary under ``HeadingFilter``, as a policy: base observations in, base actions out.

    It chooses anew every ``decision_period`` steps; ``options`` are of ``HeadingFilter``.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        adversary: Adversary,
        *,
        decision_period: int = 1,
        **options: Any,
    ) -> None:
        self.steering = HeadingFilter(scenario, num_envs, **options)
        self._adversary, self._period, self._step = adversary, decision_period, 0

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (B, n, a)."""
        if self._step % self._period == 0:
            self.steering.hold(self._adversary(self.steering.view(observations), time))
        self._step += 1
        return self.steering.act(observations)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the headings."""
        self.steering.forget(mask)
        self._step = 0


def adversary(
    scenario: Scenario,
    num_envs: int,
    random: np.random.Generator,
    *,
    max_turn_rate: float = MAX_TURN_RATE,
    kind: str | None = None,
) -> Adversary:
    """Raw vectors of all KINDS, or of one, for single integrators; turn rates for other models, in
    units of ``max_turn_rate``, rad/s, or of the scenario's limits where those are less.
    """
    size = num_envs, scenario.n_robots
    if kind is None:
        kinds = random.integers(len(KINDS), size=size)
        alike = random.random(num_envs) < 0.5
        kinds[alike] = kinds[alike, :1]
    else:
        kinds = np.full(size, KINDS.index(kind))
    if scenario.model.nonholonomic:
        limits = np.minimum(max_turn_rate, scenario.action_bounds[1:])
        return _turn_rates(scenario, kinds, random, limits)
    return _directions(scenario, kinds, random)


def _directions(
    scenario: Scenario, kinds: NDArray[np.int64], random: np.random.Generator
) -> Adversary:
    """random: anew each time; frozen; orthogonal: across f; spinning: in a plane, at any rate."""
    layout, size = scenario.observation_layout, (*kinds.shape, scenario.dim)
    frozen, other = random.normal(size=size), random.normal(size=size)
    side = random.choice([-1.0, 1.0], size=(*kinds.shape, 1))
    rate, phase = random.uniform(-_FASTEST_SPIN, _FASTEST_SPIN, kinds.shape), random.normal(size=1)

    def choose(seen: NDArray[Any], time: ArrayLike) -> Array:
        angle = (rate * np.asarray(time)[..., None] + phase)[..., None]
        spinning = np.cos(angle) * frozen + np.sin(angle) * other
        aside = side * across(layout.net_bearing(seen), other)
        options = random.normal(size=size), frozen, aside, spinning
        return np.asarray(np.choose(kinds[..., None], options))

    return choose


def _turn_rates(
    scenario: Scenario, kinds: NDArray[np.int64], random: np.random.Generator, limits: Array
) -> Adversary:
    """random: anew each time; frozen; orthogonal: whatever keeps h ⟂ f; spinning: to and fro."""
    layout, size = scenario.observation_layout, (*kinds.shape, scenario.model.n_angles)
    frozen = random.uniform(-1.0, 1.0, size)
    frozen[random.random(kinds.shape) < 0.3] = 0.0
    rate, phase = random.uniform(0, _FASTEST_SPIN, size), random.uniform(-np.pi, np.pi, size)

    def choose(seen: NDArray[Any], time: ArrayLike) -> Array:
        f, gravity = layout.net_bearing(seen), layout.split(seen).gravity
        turn = orthogonal_rates(f, None if gravity is None else pitch_of(gravity), scenario.tau)
        spinning = np.sin(rate * np.asarray(time)[..., None, None] + phase)
        options = random.uniform(-1.0, 1.0, size), frozen, turn / limits, spinning
        return np.clip(np.choose(kinds[..., None], options), -1.0, 1.0)

    return choose


def orthogonal_rates(f: Array, pitch: Array | None, duration: float) -> Array:
    """Turn rates (..., d − 1), rad/s, that bring the heading h = x to h ⟂ f within a step, and keep
    it there.

        ω = −(f_x/τ) P_h f / ‖P_h f‖²,   the yaw rate divided by cos β

    f, (..., d), m/s, is in the body frame; the pitch β, (...), rad, is None in the plane.
    """
    side = f[..., 1:]
    square = np.sum(side**2, axis=-1, keepdims=True)
    # h along f: any side will do
    rates = np.where(square > _TINY, -side * f[..., :1] / (duration * (square + _TINY)), 1.0)
    if pitch is not None:
        rates[..., 0] /= np.maximum(np.abs(np.cos(pitch)), 1e-3)
    return rates


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
        h = epsilon * unit(f) + side * math.sqrt(1 - epsilon**2) * unit(across(f, axis))
        return flexible_velocity(f, h).astype(np.float32)

    return policy
