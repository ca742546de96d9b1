"""Steering: raw vectors in, actions out. The memory and the arithmetic behind both heading
wrappers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.state_checks import check_observations
from ..experiment.checks import flag, positive, refuse
from ..experiment.scenario import Scenario
from .action_filter import ActionFilter
from .bearing_errors import check_bearing_error, error_chord
from .flexible_law import steer_headings
from .heading import check_gate_constants, step_scale
from .teams import over_teams
from .turning import gate_2d, gate_3d, mean_body_axis_2d, mean_body_axis_3d


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
    error_chord: float


class Steering(ActionFilter):
    """Headings, frames and held raw vectors of the robots of B teams.

    Args:
        scenario: whose robots are steered.
        num_envs: B.
        min_alignment: ε, in (0, 1).
        max_turn_rate: of a heading or of a body axis, rad/s; the scenario's limit holds too.
        frame: "net_bearing" (x along f; single integrators only, the other models keep the body
            frame) or "local".
        certified: False lets the raw vector through: law (4) bare, without margin or gate.
        bearing_error: η, rad: a robot goes slower by what bearings that are wrong by no more than
            that could feign (theorem N1').
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
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        turns_body = scenario.model.nonholonomic
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.model.n_angles if turns_body else scenario.dim,
            frame=frame,
            num_threads=num_threads,
        )
        check_gate_constants(min_alignment, self._sight.dead_zone)
        max_turn_rate = positive("max_turn_rate", max_turn_rate, "rad/s")
        flag("certified", certified)
        bearing_error = check_bearing_error(bearing_error)
        if bearing_error > 0.0 and not certified:
            refuse("bearing_error", bearing_error, "0 with certified=False: nothing is promised")
        self._limits = self._turn_limits(max_turn_rate)
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            merge_radius=scenario.merge_radius,
            duration=scenario.tau,
            min_alignment=float(min_alignment),
            dead_zone=self._sight.dead_zone,
            max_turn=float(self._limits[0]) * scenario.tau,
            certified=bool(certified),
            long_step=scenario.tau > scenario.certified_step,
            error_chord=error_chord(bearing_error),
        )
        self._headings = np.zeros((num_envs, scenario.n_robots, scenario.dim))

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

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"headings": self._headings, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._headings[which] = 0.0

    def act(
        self, observations: NDArray[np.float32], elapsed: float | None = None
    ) -> NDArray[np.float32]:
        """Actions for the base environment; sets ``alignment`` and ``lyapunov_rate``.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.
            elapsed: s since the actions before, in which a heading may have turned; None is τ.
                Bodies turn for τ from now on, whatever it is.

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

        constants = self._constants
        if elapsed is not None:
            constants = constants._replace(max_turn=float(self._limits[0]) * elapsed)
        fixed = (observations, constants, self._held, self._headings)
        given = (actions, self.alignment, self.lyapunov_rate)
        over_teams(lambda part: steer_headings(part, *fixed, *given), *self._batch)
        return actions

    def _turn_bodies(self, observations: NDArray[np.float32], actions: NDArray[np.float32]) -> None:
        """Gated turn rates, and the speed v = mᵀf for the mean body axis m (theory 4, arcs).

        With bearing errors it is less by e, so that V falls whatever f is.
        """
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
        sure = along
        if constants.error_chord > 0.0:
            sure = np.copysign(np.maximum(abs(along) - constants.error_chord * degree, 0.0), along)
        actions[..., 0] = np.where(alone, 0.0, sure * (scale if constants.certified else 1.0))
        actions[..., 1:] = np.where(alone[..., None], 0.0, rates)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.alignment[...] = np.abs(f[..., 0]) / np.linalg.norm(f, axis=-1)
        self.lyapunov_rate[...] = -2.0 * along * sure

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
