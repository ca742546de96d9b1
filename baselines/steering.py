"""Inputs of a robot model for a desired velocity, and rotation of remembered directions.

A single integrator executes the velocity. A nonholonomic robot turns towards it and drives once it
nearly faces it. It has no compass, so remembered directions are rotated by its commanded rates.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import dot, load, norm, scaled, store, to_global, to_local
from rendezvous_env.robots.nonholonomic_3d import body_frame_3d
from rendezvous_env.safety.turning import (
    mean_axis,
    pitch_of,
    rates_of,
    rates_towards,
    robot_of,
    send_rates,
)
from rendezvous_env.scenario.scenario import Scenario

from .policy import of_model

Array = NDArray[np.float64]
Rows = NDArray[Any]
ALIGNED = 0.5  # rad; nonholonomic robots drive within this angle of the desired direction
ALIGNED_IN_SPACE = 1.0  # larger, as pitch turns slowly, and driving with a clear axis is safe
WITHIN = 1.0 - 1e-6
"""Fraction of the speed limit in use.

Rounding to float32 then exceeds no limit, and commands equal the values used by a tank."""


turns = of_model("unicycle", "nonholonomic_3d")
"""True if a scenario's robots are unicycles or 3-D nonholonomic robots, whose frames rotate."""
STEERED = "single_integrator", "unicycle", "nonholonomic_3d"
"""Robot models that ``Steering`` supports."""
can_steer = of_model(*STEERED)
"""True if ``Steering`` supports a scenario's robot model."""


def check_steerable(scenario: Scenario, what_steers: str = "learned policies steer") -> None:
    """Raise a ValueError for a robot model that ``Steering`` does not support."""
    if not can_steer(scenario):
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.model.name} robots; {what_steers} "
            "single_integrator, unicycle and nonholonomic_3d"
        )


class Steering:
    """Conversion of desired velocities to actions, in the robots' frames at the start of a step.

    The pitch is read from observations (..., rows, d).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.turns = turns(scenario)
        self.gate = robot_of(scenario).gate if self.turns else None
        """Step and turn limits for kernels; None for a single integrator."""
        self._gravity = scenario.observation_layout.gravity.start

    def pitches(self, observations: Rows) -> Array:
        """Pitch β, (...), rad; 0 in the plane and for single integrators."""
        out = np.zeros(observations.shape[:-2])
        if self.turns:
            rows = np.ascontiguousarray(observations).reshape(-1, *observations.shape[-2:])
            _pitches_of(rows, self._gravity, self.gate, out.reshape(-1))
        return out

    def actions(self, wanted: Rows, observations: Rows) -> Array:
        """Actions (..., a) that follow velocities (..., d), m/s; see ``inputs_towards``."""
        return self._over_robots(_steer, wanted, observations, self.scenario.action_size)

    def velocities(self, actions: Rows, observations: Rows) -> Array:
        """Mean velocity v m over a step, (..., d), m/s, for actions (..., a)."""
        return self._over_robots(_mean_velocities, actions, observations, self.scenario.dim)

    def turned(
        self, vectors: Rows, actions: Rows, observations: Rows, elapsed: float | None = None
    ) -> Array:
        """Vectors (..., d) in the frames after ``elapsed`` s (default τ) of actions (..., a)."""
        if self.gate is None:
            return np.asarray(vectors, dtype=np.float64)
        gate = self.gate if elapsed is None else self.gate._replace(duration=elapsed)
        both = np.concatenate([vectors, actions], axis=-1)
        return self._over_robots(_turn_back, both, observations, self.scenario.dim, gate)

    def _over_robots(
        self, function: Any, values: Rows, observations: Rows, size: int, gate: Any = None
    ) -> Array:
        if not self.turns:  # single integrators execute the command
            return np.asarray(values, dtype=np.float64)
        given = np.ascontiguousarray(values, np.float64).reshape(-1, values.shape[-1])
        rows = np.ascontiguousarray(observations).reshape(-1, *observations.shape[-2:])
        out = np.zeros((len(given), size))
        function(given, rows, self._gravity, gate or self.gate, out)
        return out.reshape(*values.shape[:-1], size)


@inner_kernel
def inputs_towards(wanted, pitch, gate, aligned=ALIGNED):
    """Speed, m/s, and turn rates, rad/s, of a nonholonomic robot for a desired velocity w.

        v = max(0, mᵀw) if ∠(h, w) ≤ φ, else 0;   the rates turn h towards w

    m is the mean of the body axis h over the step, so τ v m is the best displacement for these
    rates. The robot rests for w = 0. w is a triple in the body frame, m/s; β and φ are in rad.
    """
    length = norm(wanted)
    if length == 0.0:
        return 0.0, (0.0, 0.0)
    rates = rates_towards(wanted, pitch, gate)
    if wanted[0] < math.cos(aligned) * length:
        return 0.0, rates
    return max(dot(mean_axis(rates, pitch, gate), wanted), 0.0), rates


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


@inner_kernel
def turned_back(vector, rates, pitch, gate):
    """Triple in the body frame after a step with these rates, rad/s, of one before it.

    u' = R(Δα, β + Δβ)ᵀ R(0, β) u,   in the plane R(−ωτ) u
    """
    yaw, rise = rates[0] * gate.duration, rates[1] * gate.duration
    before, after = body_frame_3d(0.0, pitch), body_frame_3d(yaw, pitch + rise)
    return to_local(after, to_global(before, vector))


@kernel
def _turn_back(vectors_and_actions, observations, gravity_row, gate, out):
    d = out.shape[1]
    for i in range(out.shape[0]):
        pitch = pitch_of(observations[i], gravity_row, gate)
        vector, action = load(vectors_and_actions[i, :d]), vectors_and_actions[i, d:]
        store(turned_back(vector, rates_of(action, gate), pitch, gate), out[i])
