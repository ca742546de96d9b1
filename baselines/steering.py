"""From a desired velocity to the inputs of a robot model, and how turning changes a robot's memory.

A single integrator goes where a policy wants; a unicycle or a nonholonomic robot of space turns
there, and drives once it nearly faces it. Its frame turns with it, and it has no compass: what it
remembers it turns by the rates it commands.
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
ALIGNED = 0.5  # rad; within this angle of where it is to go a robot that turns drives
ALIGNED_IN_SPACE = 1.0  # as pitch turns slowly, and driving where the axis is clear is safe
WITHIN = 1.0 - 1e-6
"""Share of the speed limit that is used, so that rounding to float32 exceeds no limit, and what is
sent is what the tank has booked."""


turns = of_model("unicycle", "nonholonomic_3d")
"""Whether a scenario's robots are unicycles or nonholonomic ones of space, whose frames turn."""
can_steer = of_model("single_integrator", "unicycle", "nonholonomic_3d")
"""Whether ``Steering`` knows a scenario's robots."""


def check_steerable(scenario: Scenario, what_steers: str = "learned policies steer") -> None:
    """Refuse, with a ValueError, robots that ``Steering`` does not know."""
    if not can_steer(scenario):
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots; {what_steers} "
            "single_integrator, unicycle and nonholonomic_3d"
        )


class Steering:
    """How robots follow desired velocities, in their own frames at the start of a step; pitch is
    read from their observations (..., rows, d).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.turns = turns(scenario)
        self.gate = robot_of(scenario).gate if self.turns else None
        """Step and turn limits for kernels; None for a single integrator."""
        self._gravity = scenario.observation_layout.gravity.start

    def pitches(self, observations: Rows) -> Array:
        """β, (...), rad; 0 in the plane and of points."""
        out = np.zeros(observations.shape[:-2])
        if self.turns:
            rows = np.ascontiguousarray(observations).reshape(-1, *observations.shape[-2:])
            _pitches_of(rows, self._gravity, self.gate, out.reshape(-1))
        return out

    def actions(self, wanted: Rows, observations: Rows) -> Array:
        """Actions (..., a) that follow velocities (..., d), m/s; see ``inputs_towards``."""
        return self._over_robots(_steer, wanted, observations, self.scenario.action_size)

    def velocities(self, actions: Rows, observations: Rows) -> Array:
        """Mean velocity (..., d) over a step, v m, m/s, of robots that take actions (..., a)."""
        return self._over_robots(_mean_velocities, actions, observations, self.scenario.dim)

    def turned(
        self, vectors: Rows, actions: Rows, observations: Rows, elapsed: float | None = None
    ) -> Array:
        """Vectors (..., d) in the frames after ``elapsed`` s, None is τ, with actions (..., a)."""
        if self.gate is None:
            return np.asarray(vectors, dtype=np.float64)
        gate = self.gate if elapsed is None else self.gate._replace(duration=elapsed)
        both = np.concatenate([vectors, actions], axis=-1)
        return self._over_robots(_turn_back, both, observations, self.scenario.dim, gate)

    def _over_robots(
        self, function: Any, values: Rows, observations: Rows, size: int, gate: Any = None
    ) -> Array:
        if not self.turns:  # they go as they are told
            return np.asarray(values, dtype=np.float64)
        given = np.ascontiguousarray(values, np.float64).reshape(-1, values.shape[-1])
        rows = np.ascontiguousarray(observations).reshape(-1, *observations.shape[-2:])
        out = np.zeros((len(given), size))
        function(given, rows, self._gravity, gate or self.gate, out)
        return out.reshape(*values.shape[:-1], size)


@inner_kernel
def inputs_towards(wanted, pitch, gate, aligned=ALIGNED):
    """Speed, m/s, and a pair of turn rates, rad/s, of a nonholonomic robot that is to follow w.

        v = max(0, mᵀw) where ∠(h, w) ≤ φ, else 0;   the rates turn h towards w

    m is the mean of the body axis h over the step, so that the displacement τ v m is the best that
    these rates allow. With w = 0 it rests. Of w, a triple in the body frame, m/s, and β and φ, rad.
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


@kernel
def _turn_back(vectors_and_actions, observations, gravity_row, gate, out):
    """Vectors after a step, u' = R(Δα, β + Δβ)ᵀ R(0, β) u,   in the plane R(−ωτ) u."""
    d = out.shape[1]
    for i in range(out.shape[0]):
        pitch = pitch_of(observations[i], gravity_row, gate)
        vector, action = load(vectors_and_actions[i, :d]), vectors_and_actions[i, d:]
        yaw_rate, pitch_rate = rates_of(action, gate)
        yaw, rise = yaw_rate * gate.duration, pitch_rate * gate.duration
        before, after = body_frame_3d(0.0, pitch), body_frame_3d(yaw, pitch + rise)
        store(to_local(after, to_global(before, vector)), out[i])
