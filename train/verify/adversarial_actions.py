"""Adversaries that know where all robots are, and choose what a policy is allowed to choose."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rendezvous_env as rv
from baselines.laws.paper_laws import pitch_of
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import (
    ORIGIN,
    combine,
    cross,
    dot,
    load,
    scaled,
    split,
    subtract,
)
from rendezvous_env.safety.settings import MAX_TURN_RATE

from .adversarial_bearings import DOWN
from .monitors import Moment

Array = NDArray[np.float64]
_TINY = 1e-12

KINDS = (
    "flee",
    "across",
    "outward",
    "from_farthest",
    "from_nearest",
    "to_nearest",
    "frozen",
    "random",
    "rest",
)
"""Against V; against its fall; against the hull; against links; to make merges; and blindly; of the
frozen ones half spin."""
_FASTEST_SPIN = 20.0
"""rad/s."""
_FROZEN, _REST = KINDS.index("frozen"), KINDS.index("rest")


class Adversary:
    """Knows where all robots are, and makes of it what a policy is allowed to choose.

    Half of the teams have one kind of desired input, which all their robots share; in the others
    each robot has its own, and every fourth team draws anew now and then.

    Args:
        scenario: whose robots are misled.
        num_envs: B.
        by: what stands between the choices and the robots.
        random: draws all kinds.
        max_turn_rate: of headings, rad/s; of robots that turn, the unit of choices.
    """

    def __init__(
        self,
        scenario: rv.Scenario,
        num_envs: int,
        by: str,
        random: np.random.Generator,
        max_turn_rate: float = MAX_TURN_RATE,
    ) -> None:
        self.scenario, self.by, self.random = scenario, by, random
        self.size = num_envs, scenario.n_robots
        self.kinds = random.integers(len(KINDS), size=self.size)
        alike = np.arange(num_envs) % 2 == 0
        self.kinds[alike] = self.kinds[alike, :1]
        self.frozen = random.normal(size=(*self.size, scenario.dim))
        side = random.choice([-1.0, 1.0], size=(*self.size, 1))
        self.axes = side * (self.frozen if scenario.dim == 3 else np.array(DOWN))
        self.strength = np.where(
            random.random((*self.size, 1)) < 0.7, 1.0, random.random((*self.size, 1))
        )
        self.blind = random.uniform(-1.0, 1.0, (*self.size, max(scenario.action_size, 3)))
        self.spin = random.uniform(-_FASTEST_SPIN, _FASTEST_SPIN, (*self.size, 1))
        self.spin[random.random(self.size) < 0.5] = 0.0
        self.turn_rates = scenario.action_bounds[1:]
        if by == "heading":
            self.turn_rates = np.minimum(max_turn_rate, self.turn_rates)

    def __call__(self, observations: NDArray[np.float32], teams: Moment) -> ArrayLike:
        """Choices (B, n, k)."""
        restless = self.kinds[3::4]
        anew = self.random.random(restless.shape) < 0.1
        restless[anew] = self.random.integers(len(KINDS), size=int(anew.sum()))
        if self.by == "gains":
            rows = self.scenario.observation_layout.split(observations).neighbours
            weights = self.random.random(rows.shape[:-1])
            _lean(rows, self._desired(teams), self.kinds, weights)
            return weights
        if self.scenario.model.bounded:
            return self._desired(teams)
        return self._controls(observations, teams)

    def _desired(self, teams: Moment) -> Array:
        """What each robot wants, in its own frame, (B, n, d)."""
        wanted = self.random.normal(size=self.frozen.shape)
        now, angle = (teams.positions, teams.active, teams.weights, teams.frames), self._spun(teams)
        spun = np.cos(angle) * self.frozen + np.sin(angle) * np.roll(self.frozen, 1, axis=-1)
        _want(now, (self.kinds, spun, self.axes, self.strength), wanted)
        return wanted

    def _spun(self, teams: Moment) -> Array:
        """By how much each robot has spun, (B, n, 1), rad."""
        return np.asarray(self.spin * teams.time[:, None, None])

    def _controls(self, observations: NDArray[np.float32], teams: Moment) -> Array:
        """Inputs of robots that turn, in units of their bounds: blind, held, to and fro, away from
        f or keeping it abeam.
        """
        scenario, layout = self.scenario, self.scenario.observation_layout
        f, gravity = layout.net_bearing(observations), layout.split(observations).gravity
        size = scenario.action_size - (self.by == "heading")
        if size < 1:
            return np.zeros((*self.size, 1))
        held, anew = self.blind[..., :size], self.random.uniform(-1, 1, (*self.size, size))
        abeam = anew
        if scenario.model.nonholonomic:
            pitch = None if gravity is None else pitch_of(gravity)
            abeam = np.clip(orthogonal_rates(f, pitch, scenario.tau) / self.turn_rates, -1.0, 1.0)
        full = abeam
        if self.by != "heading":
            full = np.concatenate([-np.sign(f[..., :1]), abeam], axis=-1)[..., :size]
        to_and_fro = np.sin(self._spun(teams) + np.copysign(0.5 * np.pi, held))
        chosen = np.choose(self.kinds[..., None] % 4, (full, held, anew, to_and_fro))
        return np.asarray(chosen)


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


@kernel
def _want(now: Any, kinds_of: Any, wanted: Any) -> None:
    """Write what robots want, by their KINDS, in their own frames, over what they would want
    blindly.

    Args:
        now: places (B, n, d), who is there (B, n), weights (B, n, n), frames (B, n, d, d).
        kinds_of: kinds (B, n), fixed vectors and axes (B, n, d or 3), lengths (B, n, 1).
        wanted: random vectors, (B, n, d).
    """
    kinds, frozen, axes, strength = kinds_of
    for b in range(wanted.shape[0]):
        for i in range(wanted.shape[1]):
            kind, aim, frame = kinds[b, i], load(wanted[b, i]), now[3][b, i]
            if kind == _FROZEN:
                aim = load(frozen[b, i])
            elif kind == _REST:
                aim = ORIGIN
            elif kind < _FROZEN:
                f, others, farthest, nearest = _look_round(now, b, i)
                aside = cross(f, load(axes[b, i]))
                aim = (f, aside, others, farthest, nearest, nearest)[kind]
                _, aim = split(scaled(aim, 1.0 if kind == 1 or kind == 5 else -1.0))
            aim = scaled(aim, strength[b, i, 0])
            for k in range(wanted.shape[2]):
                wanted[b, i, k] = dot(aim, load(frame[:, k]))


@kernel
def _lean(rows: Any, desired: Any, kinds: Any, weights: Any) -> None:
    """Write weights of rows: the one that is wanted most alone, of some robots all that are wanted
    or blindly; nothing for those that want to rest.

    Args:
        rows: of neighbours, (B, n, K, d) float32.
        desired: what robots want, (B, n, d).
        kinds: their KINDS, (B, n).
        weights: random numbers in [0, 1), (B, n, K).
    """
    for b in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            style, best, most = (i + b // 2) % 4, -1, -np.inf
            aim = load(desired[b, i])
            for k in range(weights.shape[2]):
                length, bearing = split(load(rows[b, i, k]))
                score = dot(bearing, aim)
                if length > 0.0 and score > most:
                    best, most = k, score
                if style == 2:
                    weights[b, i, k] = min(max(score, 0.0), 1.0)
            for k in range(weights.shape[2]):
                if style < 2:
                    weights[b, i, k] = 1.0 if k == best else 0.0
                if kinds[b, i] == _REST:
                    weights[b, i, k] = 0.0


@inner_kernel
def _look_round(now: Any, b: int, i: int) -> Any:
    """f_i, the offset of all others together, and those of the farthest and of the nearest robot
    that robot i is linked to, triples; zero where there is nobody.
    """
    places, active, weights, _ = now
    f, others, far, near, most, least = ORIGIN, ORIGIN, ORIGIN, ORIGIN, 0.0, np.inf
    for j in range(places.shape[1]):
        if j == i or not (active[b, i] and active[b, j]):
            continue
        offset = subtract(load(places[b, j]), load(places[b, i]))
        (distance, bearing), weight = split(offset), weights[b, i, j]
        f, others = combine(1.0, f, weight, bearing), combine(1.0, others, 1.0, offset)
        if weight > 0.0 and distance > most:
            far, most = offset, distance
        if weight > 0.0 and distance < least:
            near, least = offset, distance
    return f, others, far, near
