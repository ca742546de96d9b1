"""What a learned policy is shown: tables made from the robot's own observations, and its memory.

Nothing here knows a position or a distance. The tables are in the frame with x along f, so a policy
that reads them does not notice how the world is turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.obstacle_avoidance import tangent_joined_heading
from rendezvous_env.jit import kernel
from rendezvous_env.scenario import Scenario
from rendezvous_env.steering import Steering

VERSION = 1
"""Of what the columns mean; a network trained with another one cannot read the tables."""
NEIGHBOUR_COLUMNS = 3
"""Unit bearing x, y; gain a_ij, m/s."""
OBSTACLE_COLUMNS = 6
"""Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s."""
CONTEXT_COLUMNS = 5
"""‖f‖/D; ‖f‖, m/s, at most 2; 1/number of neighbours; base heading x, y, which stand last."""
FASTEST = 3.0
"""Turn rates of edges are cut off here, rad/s."""


class Perceived(NamedTuple):
    """What one robot is shown, taken apart; every part is a view."""

    neighbours: Any
    """(..., K, NEIGHBOUR_COLUMNS); zero rows are absent."""
    obstacles: Any
    """(..., M, OBSTACLE_COLUMNS); zero rows are absent."""
    context: Any
    """(..., CONTEXT_COLUMNS)."""

    @property
    def base_heading(self) -> Any:
        """Heading of the joined-silhouette rule on the side of f, (..., 2)."""
        return self.context[..., -2:]


class PerceptionLayout(NamedTuple):
    """Which part of a flat row of numbers is what. Nobody else counts columns."""

    neighbour_slots: int
    """K."""
    obstacle_slots: int
    """M."""

    @property
    def size(self) -> int:
        """Numbers for each robot."""
        sets = self.neighbour_slots * NEIGHBOUR_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return sets + CONTEXT_COLUMNS

    def split(self, shown: Any) -> Perceived:
        """Take (..., size) apart, an array or a tensor."""
        leading, K, M = shown.shape[:-1], self.neighbour_slots, self.obstacle_slots
        stop = K * NEIGHBOUR_COLUMNS
        return Perceived(
            shown[..., :stop].reshape(*leading, K, NEIGHBOUR_COLUMNS),
            shown[..., stop:-CONTEXT_COLUMNS].reshape(*leading, M, OBSTACLE_COLUMNS),
            shown[..., -CONTEXT_COLUMNS:],
        )


def check_readable(scenario: Scenario) -> None:
    """Refuse robots that a learned policy cannot steer.

    Raises:
        ValueError: unless they are single integrators in the plane.
    """
    if scenario.robot_model != "single_integrator" or scenario.dim != 2:
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots in {scenario.dim}-D; "
            "learned policies steer single_integrator robots in 2-D"
        )


class Perception:
    """Shows B teams of n robots to a network, once for each decision.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: s between two decisions of a team.
        clearance: of the joined-silhouette rule, rad.
        obstacle_slots: M, at least the scenario's; further rows are absent. None is the scenario's.

    Raises:
        ValueError: for robots that it cannot show, or too few obstacle slots.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        decision_time: float,
        clearance: float = 0.05,
        obstacle_slots: int | None = None,
    ) -> None:
        check_readable(scenario)
        rows = self._rows = scenario.observation_layout
        slots = rows.obstacle_slots if obstacle_slots is None else obstacle_slots
        if slots < rows.obstacle_slots:
            raise ValueError(
                f"obstacle_slots is {slots}; scenario {scenario.name!r} needs "
                f"{rows.obstacle_slots} or more"
            )
        self.layout = PerceptionLayout(rows.neighbour_slots, slots)
        self._decision_time, self._clearance = float(decision_time), float(clearance)
        self._shape = num_envs, scenario.n_robots
        self._edges = np.zeros((*self._shape, rows.obstacle_slots, 2, 2))

    def see(
        self,
        observations: NDArray[np.float32],
        steering: Steering,
        which: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """What the robots are shown; brings the steering's frames and the memory up to date.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            steering: of the same robots, with x along f.
            which: (B,), whose memory moves on; the others are shown as zeros. None is all teams.

        Returns:
            (B, n, layout.size); zeros for a robot without neighbours.
        """
        seen = steering.view(observations)
        teams = np.arange(len(seen)) if which is None else np.flatnonzero(which)
        f = self._rows.net_bearing(seen[teams])
        base = tangent_joined_heading(
            f, self._rows.split(seen[teams]).obstacles, clearance=self._clearance
        )
        base *= np.where(np.sum(base * f, axis=-1, keepdims=True) < 0, -1.0, 1.0)
        shown = np.zeros((*self._shape, self.layout.size), dtype=np.float32)
        _show(
            teams, observations, seen, base, self._rows.neighbour_slots, self._decision_time,
            self._edges, shown,
        )  # fmt: skip
        return shown

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget what all teams saw, or those of a mask (B,)."""
        self._edges[slice(None) if mask is None else mask] = 0.0

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """The memory, as copies."""
        return {"edges": self._edges.copy()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming a missing entry or one of another shape; nothing has changed then.
        """
        if "edges" not in state or np.shape(state["edges"]) != self._edges.shape:
            raise ValueError(f"state: edges must be an array of shape {self._edges.shape}")
        self._edges[...] = state["edges"]


@kernel
def _show(teams, observations, seen, base, neighbour_slots, decision_time, edges, shown):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Fill the rows of ``shown`` (B, n, size) that belong to these teams."""
    M = edges.shape[2]
    for k in range(len(teams)):
        team = teams[k]
        for i in range(seen.shape[1]):
            rows, out = seen[team, i], shown[team, i]
            if not _show_neighbours(rows[:neighbour_slots], base[k, i], out):
                continue
            column = neighbour_slots * NEIGHBOUR_COLUMNS
            for m in range(M):
                row = neighbour_slots + 2 * m
                table = out[column + m * OBSTACLE_COLUMNS : column + (m + 1) * OBSTACLE_COLUMNS]
                local = observations[team, i, row : row + 2]
                _show_obstacle(rows[row : row + 2], local, edges[team, i, m], decision_time, table)


@kernel
def _show_neighbours(rows, base, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Write bearings, gains and context of one robot; whether it has a neighbour at all."""
    x, y, degree, count = 0.0, 0.0, 0.0, 0
    for k in range(rows.shape[0]):
        gain = math.hypot(rows[k, 0], rows[k, 1])
        if gain > 0.0:
            x, y, degree, count = x + rows[k, 0], y + rows[k, 1], degree + gain, count + 1
            column = k * NEIGHBOUR_COLUMNS
            out[column], out[column + 1] = rows[k, 0] / gain, rows[k, 1] / gain
            out[column + 2] = gain
    if count == 0:
        return False
    strength, context = math.hypot(x, y), out[out.shape[0] - CONTEXT_COLUMNS :]
    context[0], context[1], context[2] = strength / degree, min(strength, 2.0), 1.0 / count
    context[3], context[4] = base[0], base[1]
    return True


@kernel
def _show_obstacle(edges, local, before, decision_time, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Write both edges of an obstacle and how fast they turned since the last decision."""
    if local[0, 0] == 0.0 and local[0, 1] == 0.0:
        before[:] = 0.0
        return
    known = before[0, 0] != 0.0 or before[0, 1] != 0.0
    for s in range(2):
        out[2 * s], out[2 * s + 1] = edges[s, 0], edges[s, 1]
        if known:
            across = before[s, 0] * local[s, 1] - before[s, 1] * local[s, 0]
            along = before[s, 0] * local[s, 0] + before[s, 1] * local[s, 1]
            rate = math.atan2(across, along) / decision_time
            out[4 + s] = min(max(rate, -FASTEST), FASTEST)
        before[s, 0], before[s, 1] = local[s, 0], local[s, 1]
