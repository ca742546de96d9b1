"""From a wanted velocity to the inputs of a robot model, and what turning does to a robot's memory.

A policy decides in the robot's frame where to go, whatever the robot. A single integrator goes
there; a unicycle or a nonholonomic robot of space turns there, and drives once it nearly faces it.
Its frame turns with it, and it has no compass: what it remembers it turns by the rates it commands.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import dot, load, norm, scaled, store, to_global, to_local
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.safety.turning import (
    Gate,
    gate_of,
    mean_axis,
    pitch_of,
    rates_of,
    rates_towards,
    send_rates,
)

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

ALIGNED = 0.5
"""rad; a robot that turns drives within this angle of where it is to go, and else turns on the
spot."""
ALIGNED_IN_SPACE = 1.0
"""rad; pitch turns slowly, and who drives only where its axis is clear meets nothing meanwhile."""
WITHIN = 1.0 - 1e-6
"""Share of the speed limit that is used: after rounding to float32 no action is above the limit,
and what is sent is what the budget has booked."""
_TURNING = ("unicycle", "nonholonomic_3d")


def can_steer(scenario: Scenario) -> bool:
    """Whether ``Steering`` knows a scenario's robots."""
    return scenario.robot_model in ("single_integrator", *_TURNING)


class Steering:
    """How the robots of a scenario follow wanted velocities.

    Frames are the robots' own at the start of a step; observations are (..., rows, d) as
    ``scenario.observation_layout`` says, of which pitch is read in space.

    Args:
        scenario: single integrators, unicycles or nonholonomic robots of space.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.turns = scenario.robot_model in _TURNING
        """Whether the frame turns with the robot."""
        self.gate = gate_of(scenario, 0.0, 0.0) if self.turns else None
        """Step and turn limits for the kernels here; None for a single integrator."""
        self._gravity = scenario.observation_layout.gravity.start

    def pitches(self, observations: NDArray[Any]) -> NDArray[np.float64]:
        """β of robots that see (..., rows, d), (...), rad; 0 in the plane and of points."""
        rows, leading = np.ascontiguousarray(observations), observations.shape[:-2]
        out = np.zeros(leading)
        if self.turns:
            flat = rows.reshape(-1, *rows.shape[-2:])
            _pitches_of(flat, self._gravity, self.gate, out.reshape(-1))
        return out

    def actions(self, wanted: NDArray[Any], observations: NDArray[Any]) -> NDArray[np.float64]:
        """Actions (..., a) that follow velocities (..., d), m/s; see ``inputs_towards``."""
        if not self.turns:
            return np.asarray(wanted, dtype=np.float64)
        return self._over_robots(_steer, wanted, observations, self._scenario.action_size)

    def velocities(self, actions: NDArray[Any], observations: NDArray[Any]) -> NDArray[np.float64]:
        """Mean velocity (..., d) over a step, m/s, of robots that take actions (..., a): v m."""
        if not self.turns:
            return np.asarray(actions, dtype=np.float64)
        return self._over_robots(_mean_velocities, actions, observations, self._scenario.dim)

    def turned(
        self,
        vectors: NDArray[Any],
        actions: NDArray[Any],
        observations: NDArray[Any],
        elapsed: float | None = None,
    ) -> NDArray[np.float64]:
        """Vectors (..., d) as they are in the frames after so many s, a step if it is None, with
        actions (..., a).
        """
        if self.gate is None:
            return np.asarray(vectors, dtype=np.float64)
        gate = self.gate if elapsed is None else self.gate._replace(duration=elapsed)
        both = np.concatenate([vectors, actions], axis=-1)
        return self._over_robots(_turn_back, both, observations, self._scenario.dim, gate)

    def _over_robots(
        self,
        function: Any,
        values: NDArray[Any],
        observations: NDArray[Any],
        size: int,
        gate: Gate | None = None,
    ) -> NDArray[np.float64]:
        leading = values.shape[:-1]
        given = np.ascontiguousarray(values, np.float64).reshape(-1, values.shape[-1])
        rows = np.ascontiguousarray(observations)
        out = np.zeros((len(given), size))
        function(given, rows.reshape(-1, *rows.shape[-2:]), self._gravity, gate or self.gate, out)
        return out.reshape(*leading, size)


# ---- kernels over robots that turn ---------------------------------------------------------------


@kernel
def inputs_towards(wanted, pitch, gate, aligned=ALIGNED):
    """Speed and turn rates with which a nonholonomic robot follows a wanted velocity w.

        v = max(0, mᵀw) where ∠(h, w) ≤ φ, else 0;   the rates turn h towards w

    m is the mean of the body axis h over the step, so that the displacement τ v m is the best that
    these rates allow. With w = 0 it rests.

    Args:
        wanted: w, a triple, m/s, in the body frame.
        pitch: β, rad; 0 in the plane.
        gate: a Gate.
        aligned: φ, rad.

    Returns:
        v, m/s, and a pair, rad/s.
    """
    length = norm(wanted)
    if length == 0.0:
        return 0.0, (0.0, 0.0)
    rates = rates_towards(wanted, pitch, gate)
    if wanted[0] < math.cos(aligned) * length:
        return 0.0, rates
    return max(dot(mean_axis(rates, pitch, gate), wanted), 0.0), rates


@kernel
def turned_back(vector, rates, pitch, gate):
    """A triple of the body frame as it is in the body frame after a step with some turn rates.

        u' = R(Δα, β + Δβ)ᵀ R(0, β) u,   in the plane R(−ωτ) u

    Args:
        vector: u, a triple of any unit.
        rates: a pair, rad/s.
        pitch: β at the start of the step, rad; 0 in the plane.
        gate: a Gate.
    """
    yaw, rise = rates[0] * gate.duration, rates[1] * gate.duration
    before, after = body_frame_3d(0.0, pitch), body_frame_3d(yaw, pitch + rise)
    return to_local(after, to_global(before, vector))


@kernel
def _pitches_of(observations, gravity_row, gate, out):
    for i in range(out.shape[0]):
        out[i] = pitch_of(observations[i], gravity_row, gate)


@kernel
def _steer(wanted, observations, gravity_row, gate, out):
    for i in range(out.shape[0]):
        pitch = pitch_of(observations[i], gravity_row, gate)
        out[i, 0], rates = inputs_towards(load(wanted[i]), pitch, gate)
        send_rates(rates, out[i], gate)


@kernel
def _mean_velocities(actions, observations, gravity_row, gate, out):
    for i in range(out.shape[0]):
        pitch = pitch_of(observations[i], gravity_row, gate)
        m = mean_axis(rates_of(actions[i], gate), pitch, gate)
        store(scaled(m, actions[i, 0]), out[i])


@kernel
def _turn_back(vectors_and_actions, observations, gravity_row, gate, out):
    d = out.shape[1]
    for i in range(out.shape[0]):
        pitch = pitch_of(observations[i], gravity_row, gate)
        vector, action = load(vectors_and_actions[i, :d]), vectors_and_actions[i, d:]
        store(turned_back(vector, rates_of(action, gate), pitch, gate), out[i])
