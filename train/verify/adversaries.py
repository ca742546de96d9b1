"""Adversaries that know where all robots are: of what a policy may choose, and of what robots see,
where bearings are wrong by a bounded angle.
"""

import math
from typing import Any

import gymnasium
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
    perpendicular,
    scaled,
    split,
    store,
    subtract,
    without,
)
from rendezvous_env.safety.settings import MAX_TURN_RATE

from .monitors import Moment

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
KINDS = (
    *("flee", "across", "outward", "from_farthest", "from_nearest", "to_nearest"),
    *("frozen", "random", "rest"),
)
"""Against V; against its fall; against the hull; against links; to make merges; and blindly; of the
frozen ones half spin."""
_FROZEN, _REST = KINDS.index("frozen"), KINDS.index("rest")
_FASTEST_SPIN = 20.0  # rad/s
_ERRORS = ("against", "to one side", "anyhow", "to changing sides", "outward")
"""Where bearings are turned: away from f, …, away from the middle of what is seen."""
_SWITCHING = 7  # steps after which errors turn round
_AT_ONCE = 16  # steps for which random numbers are drawn at once
_ROUNDED = 1.0 - 1e-6  # share of an error that is still none too much after rounding to float32
_TINY = 1e-12
DOWN = (0.0, 0.0, -1.0)  # v × DOWN is v turned by 90° in the plane


class Adversary:
    """Makes choices, (B, n, k), for robots that ``by`` stands before; ``max_turn_rate``, rad/s, is
    of headings, and of robots that turn the unit of choices.

    In half of the teams all robots want the same kind; every fourth team draws anew now and then.
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
        full = random.random((*self.size, 1)) < 0.7
        self.strength = np.where(full, 1.0, random.random((*self.size, 1)))
        self.blind = random.uniform(-1.0, 1.0, (*self.size, max(scenario.action_size, 3)))
        self.spin = random.uniform(-_FASTEST_SPIN, _FASTEST_SPIN, (*self.size, 1))
        self.spin[random.random(self.size) < 0.5] = 0.0
        self.turn_rates = scenario.action_bounds[1:]
        if by == "heading":
            self.turn_rates = np.minimum(max_turn_rate, self.turn_rates)

    def __call__(self, observations: Float32, teams: Moment) -> ArrayLike:
        """Choices (B, n, k)."""
        restless = self.kinds[3::4]
        anew = self.random.random(restless.shape) < 0.1
        restless[anew] = self.random.integers(len(KINDS), size=int(anew.sum()))
        if self.by == "gains":
            rows = self.scenario.observation_layout.split(observations).neighbours
            weights = self.random.random(rows.shape[:-1])
            _lean(rows, self.desired(teams), self.kinds, weights)
            return weights
        if self.scenario.model.bounded:
            return self.desired(teams)
        return self.controls(observations, teams)

    def desired(self, teams: Moment) -> Array:
        """The velocity that each robot desires, in its own frame, (B, n, d)."""
        desired = self.random.normal(size=self.frozen.shape)
        now, angle = (teams.positions, teams.active, teams.weights, teams.frames), self._spun(teams)
        spun = np.cos(angle) * self.frozen + np.sin(angle) * np.roll(self.frozen, 1, axis=-1)
        _desire(now, (self.kinds, spun, self.axes, self.strength), desired)
        return desired

    def _spun(self, teams: Moment) -> Array:
        """By how much each robot has spun, (B, n, 1), rad."""
        return np.asarray(self.spin * teams.time[:, None, None])

    def controls(self, observations: Float32, teams: Moment) -> Array:
        """Inputs of robots that turn, over their bounds: away from f or across it, held, blind, to
        and fro.
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
        return np.choose(self.kinds[..., None] % 4, (full, held, anew, to_and_fro))


def orthogonal_rates(f: Array, pitch: Array | None, duration: float) -> Array:
    """ω = −(f_x/τ) P_h f / ‖P_h f‖², (..., d − 1), rad/s, the yaw rate divided by cos β: rates that
    bring the heading h = x to h ⟂ f within a step, f in the body frame; β is None in the plane.
    """
    side = f[..., 1:]
    square = np.sum(side**2, axis=-1, keepdims=True)
    # h along f: any side will do
    rates = np.where(square > _TINY, -side * f[..., :1] / (duration * (square + _TINY)), 1.0)
    if pitch is not None:
        rates[..., 0] /= np.maximum(np.abs(np.cos(pitch)), 1e-3)
    return rates


@kernel
def _desire(now, kinds_of, desired):
    """Write what robots desire by their KINDS, in their own frames, over random vectors (B, n, d).

    ``now``: places (B, n, d), who is there (B, n), weights (B, n, n), frames (B, n, d, d);
    ``kinds_of``: kinds (B, n), fixed vectors and axes (B, n, d or 3), lengths (B, n, 1).
    """
    kinds, frozen, axes, strength = kinds_of
    for b in range(desired.shape[0]):
        for i in range(desired.shape[1]):
            kind, aim, frame = kinds[b, i], load(desired[b, i]), now[3][b, i]
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
            for k in range(desired.shape[2]):
                desired[b, i, k] = dot(aim, load(frame[:, k]))


@kernel
def _lean(rows, desired, kinds, weights):
    """Write weights of rows (B, n, K, d) over random ones in [0, 1), (B, n, K): of the row desired
    most alone, for some robots of all that are desired or blindly, none for those that rest.
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
def _look_round(now, b, i):
    """f_i, the offset of all others together, of the farthest and of the nearest linked robot."""
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


class Misled(gymnasium.vector.VectorWrapper):
    """Teams whose neighbour rows are turned by an error, rad, each robot's in one of _ERRORS' ways,
    in half of the teams all alike; team b draws from seed + b, so that it errs alone as among
    others.
    """

    def __init__(self, env: Any, scenario: rv.Scenario, error: float, seed: int) -> None:
        super().__init__(env)
        n, slots = scenario.n_robots, scenario.observation_layout.neighbour_slots
        self._step, self._rows = 0, scenario.observation_layout.neighbours
        self._errors = np.full((env.num_envs, n, slots), error * _ROUNDED)
        self._randoms = [np.random.default_rng([seed + b, 3]) for b in range(env.num_envs)]
        kinds = [r.integers(len(_ERRORS), size=n if r.random() < 0.5 else 1) for r in self._randoms]
        self._kinds = np.array([np.resize(own, n) for own in kinds])
        self._axes = np.array([r.normal(size=(n, 3)) for r in self._randoms])
        if scenario.dim == 2:
            self._axes[:] = DOWN

    def reset(self, **asked: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment."""
        observations, infos = self.env.reset(**asked)
        return self._turned(observations), infos

    def step(self, actions: Any) -> Any:
        """As the environment."""
        observations, *others = self.env.step(actions)
        return self._turned(observations), *others

    def _turned(self, observations: Float32) -> Float32:
        """Observations (B, n, rows, d) with turned rows."""
        seen, ahead = observations.copy(), self._step % _AT_ONCE
        rows = observations[..., self._rows, :].astype(np.float64)
        if ahead == 0:
            shape = _AT_ONCE, *rows.shape[1:]
            self._anyhow = np.array([random.normal(size=shape) for random in self._randoms])
        self._step += 1
        side = -1.0 if self._step // _SWITCHING % 2 else 1.0
        towards = self._anyhow[:, ahead]
        _aim(rows, (self._kinds, self._axes, side), towards)
        turn_rows(rows, towards, self._errors)
        seen[..., self._rows, :] = rows
        return seen


@kernel
def _aim(rows, how, towards):
    """Write where rows (B, n, K, d) are turned to, over random vectors of that shape, by kinds
    (B, n), axes (B, n, 3) and ±1 for changing sides.
    """
    kinds, axes, side = how
    for b in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            kind, axis, against, outward = kinds[b, i], load(axes[b, i]), ORIGIN, ORIGIN
            for row in rows[b, i]:
                against = subtract(against, load(row))
                outward = subtract(outward, split(load(row))[1])
            for k in range(rows.shape[2]):
                if kind == 1 or kind == 3:
                    aside = cross(load(rows[b, i, k]), axis)
                    store(scaled(aside, 1.0 if kind == 1 else side), towards[b, i, k])
                elif kind != 2:
                    store(against if kind == 0 else outward, towards[b, i, k])


@kernel
def turn_rows(rows, towards, errors):
    """Turn rows (B, n, K, d) towards directions of that shape by errors (B, n, K), rad, or across
    where they are in line; lengths stay.
    """
    for b in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            for k in range(rows.shape[2]):
                length, ahead = split(load(rows[b, i, k]))
                size, aside = split(without(load(towards[b, i, k]), ahead))
                if size < 1e-9:
                    _, aside = split(perpendicular(ahead))
                along, beside = math.cos(errors[b, i, k]), math.sin(errors[b, i, k])
                store(combine(length * along, ahead, length * beside, aside), rows[b, i, k])
