"""Steering: raw vectors in, actions out. The memory and the arithmetic behind both heading
wrappers.

Everything here comes from the robots' own observations: no position, no global frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..engine.state_checks import (
    check_entries,
    check_finite,
    check_mask,
    check_observations,
    check_rotations,
)
from ..experiment.checks import choice, flag, floats, positive, shown, whole
from ..experiment.limits import MOST_TEAMS
from ..experiment.scenario import Scenario
from .flexible_law import steer_headings
from .frames import look_along_net_bearing
from .heading import check_gate_constants, step_scale
from .teams import over_teams
from .turning import gate_2d, gate_3d, mean_body_axis_2d, mean_body_axis_3d

FRAMES = ("net_bearing", "local")
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)
_ROUNDING = 1e-6
"""So far from a rotation may a frame be that was put back."""


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the wrapper's arguments."""

    neighbour_slots: int
    merge_radius: float
    duration: float
    min_alignment: float
    dead_zone: float
    max_turn: float
    certified: bool
    long_step: bool


def _check_steerable(scenario: Scenario) -> None:
    """A heading becomes a velocity along it, or the turn rates of a body: nothing else is driven by
    law (4).
    """
    model = scenario.model
    if not model.bounded and model.theorem is None:
        raise ValueError(
            f"scenario has {model.name} robots, whose action is {model.action}; law (4) steers "
            "robots whose action is a velocity, or a speed and turn rates, as robot_model "
            "'single_integrator', 'unicycle' and 'nonholonomic_3d'"
        )


class Steering:
    """Headings, frames and held raw vectors of the robots of B teams.

    Args:
        scenario: whose robots are steered.
        num_envs: B.
        min_alignment: ε, in (0, 1).
        max_turn_rate: of a heading or of a body axis, rad/s; the scenario's limit holds too.
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        certified: False lets the raw vector through: law (4) bare, without margin or gate.
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        min_alignment: float = 0.1,
        max_turn_rate: float = 3.0,
        frame: str = "net_bearing",
        certified: bool = True,
        num_threads: int | None = None,
    ) -> None:
        _check_steerable(scenario)
        dead_zone = scenario.dead_zone if scenario.dead_zone > 0 else 1.0
        check_gate_constants(min_alignment, dead_zone)
        max_turn_rate = positive("max_turn_rate", max_turn_rate, "rad/s")
        choice("frame", frame, FRAMES)
        flag("certified", certified)
        if num_threads is not None:
            num_threads = whole("num_threads", num_threads, 1, MOST_TEAMS)
        self.scenario = scenario
        self.turns_body = scenario.model.nonholonomic
        self.along_net_bearing = frame == "net_bearing" and not self.turns_body
        self.action_size = scenario.model.n_angles if self.turns_body else scenario.dim
        self._limits = self._turn_limits(max_turn_rate)
        self._constants = _Constants(
            neighbour_slots=scenario.observation_layout.neighbour_slots,
            merge_radius=scenario.merge_radius,
            duration=scenario.tau,
            min_alignment=float(min_alignment),
            dead_zone=float(dead_zone),
            max_turn=float(self._limits[0]) * scenario.tau,
            certified=bool(certified),
            long_step=scenario.tau > scenario.certified_step,
        )
        n, d = scenario.n_robots, scenario.dim
        self._batch = num_envs, n, num_threads
        self._seen = (num_envs, n, *scenario.observation_layout.shape)
        self._headings = np.zeros((num_envs, n, d))
        self._frames = np.tile(np.eye(d), (num_envs, n, 1, 1))
        self._held = np.zeros((num_envs, n, self.action_size))
        self.alignment = np.full((num_envs, n), np.nan)
        self.lyapunov_rate = np.zeros((num_envs, n))

    def _turn_limits(self, max_turn_rate: float) -> NDArray[np.float64]:
        """Limit of each turn rate, rad/s: the smaller of the wrapper's and the scenario's."""
        if self.turns_body:
            return np.minimum(max_turn_rate, self.scenario.action_bounds[1:])
        given = self.scenario.max_turn_rate
        return np.array([max_turn_rate if given is None else min(max_turn_rate, given)])

    @property
    def headings(self) -> NDArray[np.float64]:
        """h_i, (B, n, d), in the robots' own frames; zero for a robot that has none yet."""
        return self._headings.copy()

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget everything about all teams, or about those of a mask (B,).

        Raises:
            ValueError: for a bad mask; nothing has changed then.
        """
        which = slice(None) if mask is None else check_mask(mask, len(self._held))
        self._headings[which] = 0.0
        self._frames[which] = np.eye(self.scenario.dim)
        self._held[which] = 0.0
        self.alignment[which] = np.nan
        self.lyapunov_rate[which] = 0.0

    def view(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observations as the policy sees them; brings the frames up to date.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.

        Returns:
            Of the same shape; with x along f where that is asked for, unchanged otherwise.

        Raises:
            ValueError: for observations of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        if not self.along_net_bearing:
            return observations
        seen = np.empty_like(observations)
        first_rows = self.scenario.observation_layout.obstacles.stop

        fixed = (observations, self._constants, first_rows, self._frames, seen)
        over_teams(lambda part: look_along_net_bearing(part, *fixed), *self._batch)
        return seen

    def hold(self, raw: ArrayLike) -> None:
        """Take new raw vectors, fixed in the robots' local frames from now on.

        Args:
            raw: (B, n, k): vectors (d,) as the policy sees them, or turn rates in units of
                ``max_turn_rate``.

        Raises:
            ValueError: for a wrong shape, or naming the robot whose vector is not finite.
        """
        vectors = floats("actions", raw)
        if vectors.shape != self._held.shape:
            raise ValueError(
                f"actions have shape {vectors.shape}; they must be (B, n, k) = {self._held.shape}"
            )
        if not (finite := np.abs(vectors) <= _LARGEST_FLOAT32).all():
            team, robot, _ = (int(k) for k in np.argwhere(~finite)[0])
            raise ValueError(
                f"action of robot_{robot} in team {team} is "
                f"{shown(vectors[team, robot].tolist())}; it must be finite, in float32"
            )
        if self.along_net_bearing:
            vectors = np.einsum("bnij,bnj->bni", self._frames, vectors)
        self._held[...] = vectors

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions for the base environment; sets ``alignment`` and ``lyapunov_rate``.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.

        Returns:
            (B, n, a) float32; zero for robots that see no neighbour.

        Raises:
            ValueError: for observations of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        shape = (*self._held.shape[:2], self.scenario.action_size)
        actions = np.zeros(shape, dtype=np.float32)
        if self.turns_body:
            self._turn_bodies(observations, actions)
            return actions

        fixed = (observations, self._constants, self._held, self._headings)
        given = (actions, self.alignment, self.lyapunov_rate)
        over_teams(lambda part: steer_headings(part, *fixed, *given), *self._batch)
        return actions

    def _turn_bodies(self, observations: NDArray[np.float32], actions: NDArray[np.float32]) -> None:
        """Gated turn rates, and the speed v = mᵀf for the mean body axis m (theory 4, arcs)."""
        constants, scenario = self._constants, self.scenario
        seen = scenario.observation_layout.split(observations)
        f = scenario.observation_layout.net_bearing(observations)
        degree = scenario.observation_layout.degree(observations)
        rates = np.clip(self._held, -1.0, 1.0) * self._limits
        pitch = np.zeros(f.shape[:-1])
        if seen.gravity is not None:
            pitch = np.arctan2(-seen.gravity[..., 0], -seen.gravity[..., 2]).astype(np.float64)
        if constants.certified:
            self._gate(f, pitch, rates)
        rates = rates.astype(np.float32).astype(np.float64)  # m is that of the rate executed
        if scenario.dim == 2:
            mean_axis = mean_body_axis_2d(rates[..., 0], constants.duration)
        else:
            mean_axis = mean_body_axis_3d(rates[..., 0], rates[..., 1], pitch, constants.duration)
        along = np.sum(mean_axis * f, axis=-1)
        scale = step_scale(degree, constants.merge_radius, constants.duration)
        alone = degree == 0
        actions[..., 0] = np.where(alone, 0.0, along * (scale if constants.certified else 1.0))
        actions[..., 1:] = np.where(alone[..., None], 0.0, rates)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.alignment[...] = np.abs(f[..., 0]) / np.linalg.norm(f, axis=-1)
        self.lyapunov_rate[...] = -2.0 * along**2

    def _gate(
        self, f: NDArray[np.float64], pitch: NDArray[np.float64], rates: NDArray[np.float64]
    ) -> None:
        """Replace turn rates that would let a robot stay orthogonal to f, in place."""
        d, constants = f.shape[-1], self._constants
        margins = (constants.min_alignment, constants.dead_zone, constants.duration)
        flat, gated = rates.reshape(-1, d - 1), np.empty((rates.size // (d - 1), d - 1))
        if d == 2:
            gate_2d(flat, f.reshape(-1, d), *margins, self._limits, gated)
        else:
            gate_3d(flat, f.reshape(-1, d), pitch.reshape(-1), *margins, self._limits, gated)
        rates[...] = gated.reshape(rates.shape)

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """The memory: headings, frames and held raw vectors, as copies."""
        return {
            "headings": self._headings.copy(),
            "frames": self._frames.copy(),
            "held": self._held.copy(),
        }

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit, see ``check_state``; nothing has changed then.
        """
        checked = self.check_state(state)
        self._headings[...], self._frames[...] = checked["headings"], checked["frames"]
        self._held[...] = checked["held"]

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """The arrays of a state that ``set_state`` would put back.

        Raises:
            ValueError: naming an entry that is missing, of another shape or not finite, or a frame
                that is no rotation.
        """
        checked = check_entries(self.get_state(), state)
        check_finite(checked, tuple(checked))
        check_rotations(checked, np.ones(len(self._held), np.bool_), _ROUNDING)
        return checked
