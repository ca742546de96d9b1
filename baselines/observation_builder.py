"""Conversion of one robot's measurements to observation rows: weights, slots, edge order."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_shape, floats, raise_invalid
from rendezvous_env.scenario.observation_layout import ObservationLayout

Array = NDArray[np.float64]
_ROUNDING = 1e-3  # tolerance of the length of a unit vector, for rounded directions
_AWAY = 1.0
"""Maximum summed rotation of both edges of an obstacle between ticks, rad.

Above it, the obstacle counts as another one."""
_OPPOSITE = 1e-6  # edges with a smaller sine of the angle between them are opposite
_FLAT = 1e-4
"""Product of the rays' sum and vector area below which they count as coplanar or parallel."""


class ObservationBuilder:
    """Assembles observation rows and tracks obstacles between ticks.

    Neighbours need no identity, since policies sum or pool their rows. Obstacles keep their slots,
    because the rotation rate of an edge is a measurement: current obstacles are matched to those
    of the last tick with minimal total rotation. Weights sum to at most D̄, m/s, which the time
    step assumes; ``gain`` as ``OneRobot``.
    """

    def __init__(self, layout: ObservationLayout, max_degree: float, gain: float = 1.0) -> None:
        self._layout, self._max_degree, self._gain = layout, max_degree, gain
        self._marks = np.zeros((layout.obstacle_slots, 2, layout.dim))
        self._unseen = np.zeros(layout.obstacle_slots)
        self.forget()

    def forget(self) -> None:
        """Clear the assignment of obstacles to slots."""
        self._unseen[:] = np.inf

    def rows(
        self,
        bearings: ArrayLike,
        obstacles: ArrayLike,
        weights: ArrayLike | None,
        gravity: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Observation of the robot, (rows, d); arguments and errors as ``RobotPolicy.act``.

        An angular extent is below π, which determines its counter-clockwise edge and the direction
        of rays. For opposite edges it is the first one; coplanar rays count as right-handed.
        """
        layout = self._layout
        points = layout.rows_per_obstacle, layout.dim
        seen = _unit_vectors("bearings", bearings, points[1:], layout.neighbour_slots, "neighbours")
        edges = _unit_vectors("obstacles", obstacles, points, layout.obstacle_slots, "obstacles")
        down = _direction_of_gravity(gravity, layout.senses_gravity)
        usual = np.full(len(seen), self._gain)
        gains = _gains(usual if weights is None else weights, len(seen), self._max_degree)
        rows = np.zeros(layout.shape, dtype=np.float32)
        rows[: len(seen)] = gains[:, np.newaxis] * seen
        rows[layout.gravity] = down
        if layout.dim == 2:  # the counter-clockwise edge first
            first, second = edges[:, 0].T, edges[:, 1].T
            turned = first[0] * second[1] - first[1] * second[0] > _OPPOSITE
            ordered = marks = np.where(turned[:, np.newaxis, np.newaxis], edges[:, ::-1], edges)
        else:
            ordered, marks = _round_their_middles(edges, layout.net_bearing(rows))
        # visible obstacles keep their slots; others get the slots that are vacant longest
        along = np.einsum("mid,sid->msi", marks, self._marks)
        turns = np.arccos(np.clip(along, -1.0, 1.0)).sum(axis=-1)
        vacant = _AWAY + 1e-3 / (1.0 + self._unseen)
        slots = min_cost_slots(np.where(self._unseen == 0.0, turns, vacant))
        rows[layout.obstacles].reshape(-1, *points)[slots] = ordered
        self._unseen += 1.0
        self._unseen[slots] = 0.0
        self._marks[slots] = marks
        return rows


def min_cost_slots(cost: Array) -> NDArray[np.int64]:
    """Slots (m,) that minimise the total of finite costs (m, s), m ≤ s; each slot at most once.

    Shortest augmenting paths (Jonker & Volgenant 1987), so that robots need no SciPy.
    """
    if not len(cost):
        return np.zeros(0, dtype=np.int64)
    nearest = cost.argmin(axis=1)
    if len(set(nearest.tolist())) == len(cost):
        return nearest
    row_price, slot_price = np.zeros(len(cost)), np.zeros(cost.shape[1])
    owner = np.full(cost.shape[1], -1)
    for row in range(len(cost)):
        slack, came_from = np.full(cost.shape[1], np.inf), np.full(cost.shape[1], -1)
        is_open, last, k = np.ones(cost.shape[1], dtype=bool), row, -1
        while last >= 0:  # until it reaches a free slot
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
) -> Array:
    """Validate unit vectors, (k, *shape) with k ≤ most."""
    vectors = floats(name, value)
    if vectors.size == 0:
        return np.zeros((0, *shape))
    if vectors.shape[1:] != shape:
        axes = ", ".join(map(str, shape))
        raise ValueError(f"{name} have shape {vectors.shape}; they must be (…, {axes})")
    if len(vectors) > most:
        raise ValueError(
            f"{name} are of {len(vectors)} {what}; this scenario has at most {most}: see its "
            f"{'neighbour_slots' if name == 'bearings' else 'obstacle_slots'}"
        )
    lengths = np.linalg.norm(vectors, axis=-1)
    for index in np.argwhere(~(np.abs(lengths - 1.0) <= _ROUNDING)):  # also NaN
        place = tuple(index.tolist())
        raise_invalid(f"{name}{list(place)}", vectors[place].tolist(), "a unit vector")
    return vectors


def _direction_of_gravity(gravity: ArrayLike | None, sensed: bool) -> Array:
    """Gravity row, (1, 3), or an empty array for robots that do not sense it."""
    if not sensed:
        if gravity is not None:
            raise_invalid("gravity", gravity, "omitted: these robots do not sense it")
        return np.zeros((0, 1))
    down = np.zeros(0) if gravity is None else floats("gravity", gravity)
    if down.shape != (3,) or not abs(np.linalg.norm(down) - 1.0) <= _ROUNDING:
        raise_invalid("gravity", gravity, "its direction in the body frame, a unit vector (3,)")
    return down[np.newaxis]


def _gains(weights: ArrayLike, count: int, most: float) -> Array:
    """Weights (count,), m/s, whose sum is at most ``most``."""
    gains = floats("weights", weights)
    check_shape("weights", gains, (count,), axes="(k,)")
    for index in np.flatnonzero(~((gains > 0.0) & np.isfinite(gains))):
        raise_invalid(f"weights[{index}]", float(gains[index]), "positive and finite (m/s)")
    if (total := float(gains.sum())) > (1.0 + _ROUNDING) * most:
        raise ValueError(
            f"weights sum to {total:g} m/s; the maximum in this scenario is D̄ = {most:g} m/s. "
            "Give weights that are not 1"
        )
    return gains


def _round_their_middles(rays: Array, net_bearing: Array) -> tuple[Array, Array]:
    """Rays of cones (m, 8, 3), right-handed and starting at the side of f, and their signatures.

    A signature, (2, 3), is the axis of a cone and (cos α, sin α, 0) of its half-angle α.
    """
    total = rays.sum(axis=1)
    area = np.cross(rays, np.roll(rays, -1, axis=1)).sum(axis=1)
    backwards = (np.einsum("md,md->m", area, total) < -_FLAT)[:, np.newaxis]
    middles = total + np.where(backwards, -area, area)
    lengths = np.linalg.norm(middles, axis=-1, keepdims=True)
    for index in np.flatnonzero(lengths <= _FLAT):
        raise_invalid(f"obstacles[{index}]", rays[index].tolist(), "rays around a cone")
    middles /= lengths
    rays = np.where(backwards[..., np.newaxis], rays[:, ::-1], rays)
    across = net_bearing - (middles @ net_bearing)[:, np.newaxis] * middles
    first = np.einsum("msd,md->ms", rays, across)
    cosines = np.einsum("msd,md->m", rays, middles) / rays.shape[1]
    widths = np.stack([cosines, np.sqrt(1.0 - np.minimum(cosines, 1.0) ** 2), 0.0 * cosines], -1)
    marks = np.stack([middles, widths], axis=1)
    order = (first.argmax(axis=1)[:, np.newaxis] + np.arange(rays.shape[1])) % rays.shape[1]
    return np.take_along_axis(rays, order[..., np.newaxis], axis=1), marks
