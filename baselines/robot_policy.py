"""A policy on board of one robot: what it measured since the last tick in, its velocity out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, positive, refuse, shown
from rendezvous_env.scenario.observation_layout import ObservationLayout
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from . import policy as registry
from .policy import Policy, RealTimePolicy

_KINDS = ("law", "rule", "learned")
"""Kinds whose policies ask neither which robot is which nor how often they were called."""
_MODELS = ("single_integrator", "unicycle")
_ROUNDING = 1e-3
"""So far from 1 may the length of a unit vector be: directions come rounded, too."""
_AWAY = 1.0
"""By how much both edges of an obstacle together turn between ticks, rad, before it is taken for
another one."""
_OPPOSITE = 1e-6
"""Edges are opposite below this sine of the angle between them."""


class OneRobot:
    """One robot's policy, called with what it has measured since its last tick.

    Args:
        scenario: whose robot this is.
        policy: of a team of as many robots, of which this one is the first.
        gain: a_ij of each neighbour where none are given, m/s.
    """

    def __init__(self, scenario: Scenario, policy: Policy, gain: float = 1.0) -> None:
        self.scenario, self.policy = scenario, policy
        layout = scenario.observation_layout
        self._sight = RobotSight(layout, scenario.max_degree, gain)
        self._time = -1.0  # before the first tick
        self._team = np.zeros((1, scenario.n_robots, *layout.shape), dtype=np.float32)
        self.reset()

    @property
    def time(self) -> float:
        """Of the last tick since the first one, s."""
        return max(self._time, 0.0)

    def act(
        self,
        bearings: ArrayLike,
        obstacles: ArrayLike = (),
        dt: float | None = None,
        *,
        weights: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """What to do until the next tick.

        Args:
            bearings: unit vectors to the neighbours that are seen now, (k, 2), in any order, in the
                robot's own frame: one that does not turn, for a single integrator; the body's, for
                a unicycle.
            obstacles: both edges of each obstacle that is near, (m, 2, 2), unit vectors in the same
                frame, obstacles and edges in any order. Each silhouette is narrower than π.
            dt: s since the tick before; None is the scenario's time step. Of no account in the
                first tick.
            weights: gains a_ij of the neighbours, (k,), m/s; None is what all links of the
                scenario weigh, or 1 where they differ.

        Returns:
            The velocity, (2,), m/s, in the same frame; of a unicycle (v, ω), m/s and rad/s. Zeros
            if no neighbour is seen.

        Raises:
            ValueError: naming the argument, its value and what would be right; nothing has changed
                then.
        """
        elapsed = self.scenario.tau if dt is None else positive("dt", dt, "s")
        self._team[0, 0] = self._sight.rows(bearings, obstacles, weights)
        self._time = self._time + elapsed if self._time >= 0.0 else 0.0
        if isinstance(self.policy, RealTimePolicy):
            return self.policy.after(elapsed, self._team, self._time)[0, 0]
        return self.policy(self._team, self._time)[0, 0]

    def reset(self) -> None:
        """Forget everything: the next tick is the first."""
        self._time = -1.0
        self._sight.forget()
        self.policy.reset()


class RobotPolicy(OneRobot):
    """One robot that ticks in its own time, and knows nothing but its own bearings.

    Where every tick comes one time step after the last one, it does what a robot of a batch does.
    The scenario tells what team this is: how many, which gains, how close is met. Its ``time_step``
    is the longest that a velocity may be held; see to it that the next tick, or a watchdog that
    stops the robot, comes by then (docs/robot.md).

    Args:
        scenario: whose robot this is; a Scenario, the name of one or a TOML file. Single
            integrators or unicycles in the plane.
        policy: a name of ``baselines.names(scenario)`` of the kinds law, rule or learned; the path
            of a run, of a checkpoint or of an exported network; or a policy.
        options: of a policy that is named.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self, scenario: ScenarioLike, policy: str | Path | Policy = "learned", **options: Any
    ) -> None:
        scenario = resolve(scenario)
        check_planar(scenario)
        super().__init__(scenario, _made(policy, scenario, options), common_gain(scenario))


def common_gain(scenario: Scenario) -> float:
    """What every link weighs, m/s; 1 where they differ."""
    least, most = scenario.sensing_graph.extreme_weights(scenario.n_robots)
    return float(least) if least == most else 1.0


def check_planar(scenario: Scenario) -> None:
    """Refuse robots that are neither single integrators nor unicycles in the plane.

    Raises:
        ValueError: naming the robot model.
    """
    if scenario.dim != 2 or scenario.robot_model not in _MODELS:
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots in {scenario.dim}-D; "
            f"a RobotPolicy steers {' and '.join(_MODELS)} robots in 2-D"
        )


def _made(policy: Any, scenario: Scenario, options: dict[str, Any]) -> Policy:
    """The policy that is meant."""
    if isinstance(policy, Path):
        from .learned.learned_policy import load

        return load(policy, scenario)
    if not isinstance(policy, str):
        if not callable(policy) or not hasattr(policy, "reset"):
            raise ValueError(
                f"policy is {shown(policy)}; it must be a name, a Path, or a policy with reset()"
            )
        made: Policy = policy
        return made
    found = registry.make(policy, scenario, **options)
    check_kind(policy)
    return found


def check_kind(policy: str) -> None:
    """Refuse the name of a policy that one robot alone cannot run.

    Raises:
        ValueError: saying of which kind it is.
    """
    if (kind := registry.kind_of(policy)) not in _KINDS:
        raise ValueError(
            f"policy {policy!r} is one of the {registry.KINDS[kind]}, which count calls, tell "
            "robots apart or see nothing; a RobotPolicy takes laws, rules and learned policies"
        )


# ---- what it measures ---------------------------------------------------------------------------


class RobotSight:
    """Orders what a robot measures in the plane, and knows obstacles again from tick to tick.

    Neighbours need no names: policies add up their rows or pool them. Obstacles keep their slots,
    because how fast an edge turns is a measurement, too: what is seen now is matched to what was
    seen at the last tick so that all edges together turn least.

    Args:
        layout: of the observation, in the plane.
        max_degree: D̄, the most that all gains may come to, m/s: time steps are made for it.
        gain: of each neighbour where none are given, m/s.
    """

    def __init__(self, layout: ObservationLayout, max_degree: float, gain: float = 1.0) -> None:
        self._layout, self._max_degree, self._gain = layout, max_degree, gain
        self._edges = np.zeros((layout.obstacle_slots, 2, 2))
        self._unseen = np.zeros(layout.obstacle_slots)
        self.forget()

    def forget(self) -> None:
        """Forget which obstacle stood in which slot."""
        self._unseen[:] = np.inf

    def rows(
        self, bearings: ArrayLike, obstacles: ArrayLike, weights: ArrayLike | None
    ) -> NDArray[np.float32]:
        """The observation of the robot, (rows, 2); arguments and refusals as ``RobotPolicy.act``.

        A silhouette is narrower than π, which tells its counter-clockwise edge; of two opposite
        edges that is the first.
        """
        layout = self._layout
        seen = _unit_vectors("bearings", bearings, (2,), layout.neighbour_slots, "neighbours")
        edges = _unit_vectors("obstacles", obstacles, (2, 2), layout.obstacle_slots, "obstacles")
        usual = np.full(len(seen), self._gain)
        gains = _gains(usual if weights is None else weights, len(seen), self._max_degree)
        rows = np.zeros(layout.shape, dtype=np.float32)
        rows[: len(seen)] = gains[:, np.newaxis] * seen
        silhouettes = rows[layout.obstacles].reshape(-1, 2, 2)
        ordered = _counter_clockwise_first(edges)
        slots = self._slots_of(ordered)
        silhouettes[slots] = ordered
        self._unseen += 1.0
        self._unseen[slots] = 0.0
        self._edges[slots] = ordered
        return rows

    def _slots_of(self, edges: NDArray[np.float64]) -> NDArray[np.int64]:
        """A slot for each obstacle (m, 2, 2), the same as at the last tick for those seen then."""
        if not len(edges):
            return np.zeros(0, dtype=np.int64)
        along = np.einsum("mid,sid->msi", edges, self._edges)
        turned = np.arccos(np.clip(along, -1.0, 1.0)).sum(axis=-1)
        vacant = _AWAY + 1e-3 / (1.0 + self._unseen)  # the longer, the sooner taken
        cost = np.where(self._unseen == 0.0, turned, vacant)
        return least_cost_slots(cost)


def least_cost_slots(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """A slot for each obstacle, none twice, so that all costs together are least.

    Shortest augmenting paths (Jonker & Volgenant 1987), for few rows: SciPy's solver of the same
    problem is not on every robot.

    Args:
        cost: (m, s), m ≤ s, of obstacle m in slot s, finite.

    Returns:
        Slots, (m,).
    """
    nearest = cost.argmin(axis=1)
    if len(set(nearest.tolist())) == len(cost):
        return nearest
    row_price, slot_price = np.zeros(len(cost)), np.zeros(cost.shape[1])
    owner = np.full(cost.shape[1], -1)
    for row in range(len(cost)):
        slack, came_from = np.full(cost.shape[1], np.inf), np.full(cost.shape[1], -1)
        is_open, last, k = np.ones(cost.shape[1], dtype=bool), row, -1
        while last >= 0:  # until a slot is reached that nobody has
            reduced = cost[last] - row_price[last] - slot_price
            better = is_open & (reduced < slack)
            slack[better], came_from[better] = reduced[better], k
            step = slack[is_open].min()
            ends = is_open & (slack <= step)
            k = int((ends & (owner < 0)).argmax() if (owner[ends] < 0).any() else ends.argmax())
            row_price[[row, *owner[~is_open]]] += step
            slot_price[~is_open] -= step
            slack[is_open] -= step
            is_open[k], last = False, owner[k]
        while k >= 0:
            before = came_from[k]
            owner[k], k = (row if before < 0 else owner[before]), before
    slots = np.empty(len(cost), dtype=np.int64)
    slots[owner[owner >= 0]] = np.flatnonzero(owner >= 0)
    return slots


def _unit_vectors(
    name: str, value: ArrayLike, shape: tuple[int, ...], most: int, what: str
) -> NDArray[np.float64]:
    """Some (k, *shape) unit vectors, k ≤ most."""
    vectors = floats(name, value)
    if vectors.size == 0:
        return np.zeros((0, *shape))
    if vectors.shape[1:] != shape:
        axes = ", ".join(map(str, shape))
        raise ValueError(f"{name} have shape {vectors.shape}; they must be (…, {axes})")
    if len(vectors) > most:
        raise ValueError(
            f"{name} are of {len(vectors)} {what}; this scenario has room for {most}: see its "
            f"{'neighbour_slots' if name == 'bearings' else 'obstacle_slots'}"
        )
    lengths = np.linalg.norm(vectors, axis=-1)
    wrong = ~(np.abs(lengths - 1.0) <= _ROUNDING)  # true of NaN, too
    for index in np.argwhere(wrong):
        place = tuple(index.tolist())
        refuse(f"{name}{list(place)}", vectors[place].tolist(), "a unit vector")
    return vectors


def _gains(weights: ArrayLike, count: int, most: float) -> NDArray[np.float64]:
    """Weights (count,), m/s, that come to no more than ``most``."""
    gains = floats("weights", weights)
    if gains.shape != (count,):
        raise ValueError(
            f"weights have shape {gains.shape}; they must be ({count},), one for each bearing"
        )
    for index in np.flatnonzero(~((gains > 0.0) & np.isfinite(gains))):
        refuse(f"weights[{index}]", float(gains[index]), "positive and finite (m/s)")
    if (total := float(gains.sum())) > (1.0 + _ROUNDING) * most:
        raise ValueError(
            f"weights sum to {total:g} m/s; this scenario's come to D̄ = {most:g} m/s at most. "
            "Where they are not 1, give them"
        )
    return gains


def _counter_clockwise_first(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pairs of edges (m, 2, 2), the counter-clockwise one first."""
    first, second = edges[:, 0], edges[:, 1]
    across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.where(across[:, np.newaxis, np.newaxis] > _OPPOSITE, edges[:, ::-1], edges)
