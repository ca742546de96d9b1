"""Adversaries with full state: of the actions, and of bearings with a bounded error."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rendezvous_env.baselines.laws.paper_laws import pitch_of

import rendezvous_env as rv

from .monitors import BatchMoment, across, lengths, unit

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Random = np.random.Generator
KINDS = (
    *("flee", "across", "outward", "from_farthest", "from_nearest", "to_nearest"),
    *("frozen", "random", "rest"),
)
"""Objectives: increase V, slow its decrease, grow the hull, stretch links, cause merges, random.
Half of the frozen ones rotate."""
_REST = KINDS.index("rest")
_FASTEST_SPIN = 20.0  # rad/s
_ERRORS = ("against", "to one side", "anyhow", "to changing sides", "outward")
"""Directions into which bearings are rotated: away from f, …, away from the mean bearing."""
_SWITCHING = 7  # steps after which errors change sign
_ROUNDED = 1.0 - 1e-6  # factor on errors, so that rounding to float32 does not exceed the bound
_TINY = 1e-12


class Adversary:
    """Adversarial actions (B, n, k) for robots behind the safety filter ``by``.

    ``max_turn_rate``, rad/s, limits headings, and is the unit of actions of nonholonomic robots. In
    half of the environments all robots share an objective; every fourth environment resamples it.
    """

    def __init__(
        self, scenario: rv.Scenario, num_envs: int, by: str, random: Random, max_turn_rate: float
    ) -> None:
        self.scenario, self.by, self.random = scenario, by, random
        self.size = num_envs, scenario.n_robots
        self.kinds = random.integers(len(KINDS), size=self.size)
        alike = np.arange(num_envs) % 2 == 0
        self.kinds[alike] = self.kinds[alike, :1]
        self.frozen = random.normal(size=(*self.size, scenario.dim))
        self.side = random.choice([-1.0, 1.0], size=(*self.size, 1))
        full = random.random((*self.size, 1)) < 0.7
        self.strength = np.where(full, 1.0, random.random((*self.size, 1)))
        self.blind = random.uniform(-1.0, 1.0, (*self.size, max(scenario.action_size, 3)))
        self.spin = random.uniform(-_FASTEST_SPIN, _FASTEST_SPIN, (*self.size, 1))
        self.spin[random.random(self.size) < 0.5] = 0.0
        self.turning = turning = scenario.nonholonomic_robots
        bounds = scenario.robot_bounds[turning] if turning.any() else scenario.robot_bounds
        self.turn_rates = bounds.max(axis=0)[1:]
        if by == "heading":
            self.turn_rates = np.minimum(max_turn_rate, self.turn_rates)

    def __call__(self, observations: Float32, teams: BatchMoment) -> ArrayLike:
        """Actions (B, n, k)."""
        restless = self.kinds[3::4]
        anew = self.random.random(restless.shape) < 0.1
        restless[anew] = self.random.integers(len(KINDS), size=int(anew.sum()))
        if self.by == "gains":
            rows = self.scenario.observation_layout.split(observations).neighbours
            anyhow = self.random.random(rows.shape[:-1])
            return self._lean(rows.astype(np.float64), self.desired(teams), anyhow)
        if self.scenario.model.bounded:
            return self.desired(teams)
        controls = self.controls(observations, teams)
        if self.turning.all() or not self.turning.any():
            return controls
        desired = self.desired(teams)
        # unused numbers are arbitrary
        padded = np.concatenate([controls, self.blind], axis=-1)[..., : desired.shape[-1]]
        return np.where(self.turning[:, np.newaxis], padded, desired)

    def desired(self, teams: BatchMoment) -> Array:
        """Desired velocity of each robot in its own frame, (B, n, d)."""
        anyhow, angle = self.random.normal(size=self.frozen.shape), self._spun(teams)
        spun = np.cos(angle) * self.frozen + np.sin(angle) * np.roll(self.frozen, 1, axis=-1)
        f, others = teams.net_bearings, (teams.both[..., None] * teams.offsets).sum(axis=2)
        far = _offset_of(teams, np.argmax(np.where(teams.linked, teams.distances, 0.0), axis=2))
        near = _offset_of(teams, np.argmin(np.where(teams.linked, teams.distances, np.inf), axis=2))
        aside = self.side * across(f, self.frozen)
        known = unit(np.stack([-f, aside, -others, -far, -near, near]))
        all_kinds = np.stack([*known, spun, anyhow, np.zeros_like(f)])
        aims = np.take_along_axis(all_kinds, self.kinds[None, ..., None], axis=0)[0] * self.strength
        return np.asarray((aims[..., None] * teams.frames).sum(axis=2))

    def _lean(self, rows: Array, desired: Array, anyhow: Array) -> Array:
        """Weights (B, n, K) of rows (B, n, K, d).

        Only the most desired row has weight, for some robots all desired rows (all with
        ``anyhow``), and none for robots that rest.
        """
        there = lengths(rows)[..., 0] > 0.0
        scores = (unit(rows) * desired[..., None, :]).sum(axis=-1)
        best = np.argmax(np.where(there, scores, -np.inf), axis=-1, keepdims=True)
        alone = there & (best == np.arange(rows.shape[2]))
        teams, robots = np.indices(self.size)
        style = (robots + teams // 2)[..., None] % 4
        weights = np.choose(style, (alone, alone, np.clip(scores, 0.0, 1.0), anyhow))
        return np.where(self.kinds[..., None] == _REST, 0.0, weights)

    def _spun(self, teams: BatchMoment) -> Array:
        """Accumulated rotation of each robot, (B, n, 1), rad."""
        return np.asarray(self.spin * teams.time[:, None, None])

    def controls(self, observations: Float32, teams: BatchMoment) -> Array:
        """Normalised inputs of nonholonomic robots: away from f, across, held or random."""
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
    """Turn rates that make the heading h = x perpendicular to f within a step.

        ω = −(f_x/τ) P_h f / ‖P_h f‖²

    (..., d − 1), rad/s, with f in the body frame; the yaw rate is divided by cos β in 3-D.
    """
    side = f[..., 1:]
    square = np.sum(side**2, axis=-1, keepdims=True)
    # h along f: any side will do
    rates = np.where(square > _TINY, -side * f[..., :1] / (duration * (square + _TINY)), 1.0)
    if pitch is not None:
        rates[..., 0] /= np.maximum(np.abs(np.cos(pitch)), 1e-3)
    return rates


def _offset_of(teams: BatchMoment, others: NDArray[np.int64]) -> Array:
    """Offset from each robot to another one, (B, n, d), m; zero without a link."""
    found = np.take_along_axis(teams.offsets, others[..., None, None], axis=2)[..., 0, :]
    return np.where(teams.linked.any(axis=2, keepdims=True), found, 0.0)


class Misled(gymnasium.vector.VectorWrapper):
    """Vector environment whose neighbour rows are rotated by a bounded error, rad.

    Each robot uses one of ``_ERRORS``, in half of the environments a common one. Environment b
    draws from seed + b, independent of the batch.
    """

    part_of_world = True

    def __init__(self, env: Any, scenario: rv.Scenario, error: float, seed: int) -> None:
        super().__init__(env)
        n, self._rows = scenario.n_robots, scenario.observation_layout.neighbours
        self._step, self._error = 0, error * _ROUNDED
        self._randoms = [np.random.default_rng([seed + b, 3]) for b in range(env.num_envs)]
        kinds = [r.integers(len(_ERRORS), size=n if r.random() < 0.5 else 1) for r in self._randoms]
        self._kinds = np.array([np.resize(own, n) for own in kinds])[..., None, None]
        self._axes = np.array([r.normal(size=(n, 3)) for r in self._randoms])[:, :, None]

    def reset(self, **asked: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment."""
        observations, infos = self.env.reset(**asked)
        return self._turned(observations), infos

    def step(self, actions: Any) -> Any:
        """As the environment."""
        observations, *others = self.env.step(actions)
        return self._turned(observations), *others

    def _turned(self, observations: Float32) -> Float32:
        """Observations (B, n, rows, d) with rotated rows."""
        seen, rows = observations.copy(), observations[..., self._rows, :].astype(np.float64)
        anyhow = np.array([random.normal(size=rows.shape[1:]) for random in self._randoms])
        self._step += 1
        side = -1.0 if self._step // _SWITCHING % 2 else 1.0
        against, aside = -rows.sum(axis=2, keepdims=True), across(rows, self._axes)
        outward = -unit(rows).sum(axis=2, keepdims=True)
        ways = (against, aside, anyhow, side * aside, outward)
        seen[..., self._rows, :] = turned_rows(rows, np.choose(self._kinds, ways), self._error)
        return seen


def turned_rows(rows: Array, towards: Array, errors: Array | float) -> Array:
    """Rows (..., d) rotated towards directions (..., d) by errors (..., 1), rad.

    Collinear rows rotate sideways; lengths are unchanged.
    """
    ahead, aside = unit(rows), towards
    for _ in range(2):  # so that rounding leaves no component ahead
        aside = aside - (aside * ahead).sum(axis=-1, keepdims=True) * ahead
    least = np.eye(rows.shape[-1])[np.argmin(np.abs(ahead), axis=-1)]
    aside = unit(np.where(lengths(aside) < 1e-9, across(ahead, least), aside))
    return lengths(rows) * (np.cos(errors) * ahead + np.sin(errors) * aside)
