"""Frames that do not turn with their robots: what unicycles remember, and how they follow headings.

A robot that turns sees everything in its body frame. It has no compass, but it knows by how much it
has turned since its episode began, from the rates that it commanded; so it remembers directions in
the frame that its body had then.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.engine.state_checks import Remembering
from rendezvous_env.engine.threads import Part
from rendezvous_env.physics.neighbour_rows import degree_of, net_bearing_of
from rendezvous_env.physics.vectors import load, norm, scaled
from rendezvous_env.robots.unicycle import arc_2d, clip
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.turning import gate_of
from rendezvous_env.scenario.scenario import Scenario

from .steering import inputs_towards


class SteadyFrames(Remembering):
    """Headings of the unicycles of B teams, in frames that stay as the bodies were at first.

        u = R(θ) u_body,   θ ← θ + ω τ

    Args:
        scenario: whose robots they are.
        num_envs: B.
        aligned: within this angle of where it is to go a robot drives, rad, as ``inputs_towards``.
        most: at most so fast may a body turn, rad/s; the scenario's limit holds too.
    """

    def __init__(
        self, scenario: Scenario, num_envs: int, aligned: float, most: float = math.inf
    ) -> None:
        robots = num_envs, scenario.n_robots
        self.headings = np.zeros((*robots, 2))
        """h, where they are to go, (B, n, 2); zero where there is none yet."""
        self.velocities = np.zeros((*robots, 2))
        """Their mean velocities over the step before, (B, n, 2), m/s."""
        self._angles, self._turns, self._bends = (np.zeros(robots) for _ in range(3))
        layout = scenario.observation_layout
        self._neighbour_slots = layout.neighbour_slots
        self._seen = np.zeros((*robots, *layout.shape), np.float32)
        self._gate, self._aligned = gate_of(scenario, 0.0, 0.0, most), float(aligned)
        self._limits = float(scenario.merge_radius), float(scenario.speed_limit)

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {
            "headings": self.headings,
            "velocities": self.velocities,
            "angles": self._angles,
            "turns": self._turns,
            "bends": self._bends,
        }

    def seen(
        self, observations: NDArray[np.float32], teams: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Observations (B, n, rows, 2) in these frames, until the next call; only those of
        some teams are brought up to date.
        """
        _turn_rows(teams, observations, self._angles, self._seen)
        return self._seen

    def follow(
        self, teams: Part, observations: NDArray[np.float32], held: NDArray[np.float64]
    ) -> None:
        """Write the desired inputs of a part of the teams, in units of their bounds: (v, ω) or,
        where another sets the speed, ω alone. See ``inputs_towards``; the speed is law (1)'s.
        """
        arguments = self._angles, self.headings, self._limits, (self._gate, self._aligned)
        _follow(teams, observations, self._neighbour_slots, arguments, held)

    def turn(self, teams: Part, actions: NDArray[np.float32]) -> None:
        """Take note of the actions (v, ω) that these teams take for τ."""
        memory = self._angles, self._turns, self._bends, self.velocities
        _turn(teams, actions, self._limits[1], self._gate, memory)

    def settle(self, share: float) -> NDArray[np.float64]:
        """Correct what the last step turned: it lasted only a share of τ, at most all of it.

        Returns:
            |v ω| τ² of that step, (B, n), m: how far its arc may have been from a straight line.
        """
        self._angles += (min(share, 1.0) - 1.0) * self._turns
        bends, self._turns[...], self._bends[...] = self._bends.copy(), 0.0, 0.0
        return bends


@kernel
def _turn_rows(teams, observations, angles, seen):
    for team in teams:
        for i in range(observations.shape[1]):
            c, s = math.cos(angles[team, i]), math.sin(angles[team, i])
            rows, turned = observations[team, i], seen[team, i]
            for k in range(rows.shape[0]):
                x, y = np.float64(rows[k, 0]), np.float64(rows[k, 1])
                turned[k, 0], turned[k, 1] = c * x - s * y, s * x + c * y


@kernel
def law_speed(rows, neighbour_slots, merge_radius, duration):
    """Of law (1) in a step of τ, min(1, r/(2 D τ)) ‖f‖, of a robot that sees these rows, m/s."""
    scale = scale_of_step(degree_of(rows, neighbour_slots), merge_radius, duration)
    return norm(net_bearing_of(rows, neighbour_slots)) * scale


@kernel
def _follow(teams, observations, neighbour_slots, arguments, held):
    angles, headings, (merge_radius, speed_limit), (gate, aligned) = arguments
    for team in range(teams[0], teams[1]):
        for i in range(observations.shape[1]):
            rows, desired = observations[team, i], held[team, i]
            speed = min(law_speed(rows, neighbour_slots, merge_radius, gate.duration), speed_limit)
            c, s = math.cos(angles[team, i]), math.sin(angles[team, i])
            x, y, _ = scaled(load(headings[team, i]), speed)
            wanted = c * x + s * y, c * y - s * x, 0.0
            forward, (rate, _) = inputs_towards(wanted, 0.0, gate, aligned)
            desired[-1] = rate / gate.yaw_limit if gate.yaw_limit > 0.0 else 0.0
            if len(desired) > 1:
                desired[0] = forward / speed_limit


@kernel
def _turn(teams, actions, speed_limit, gate, memory):
    angles, turns, bends, velocities = memory
    for team in range(teams[0], teams[1]):
        for i in range(actions.shape[1]):
            speed = clip(np.float64(actions[team, i, 0]), speed_limit)
            rate = clip(np.float64(actions[team, i, 1]), gate.yaw_limit)
            x, y = arc_2d(speed, angles[team, i], rate, gate.duration)
            velocities[team, i, 0], velocities[team, i, 1] = x / gate.duration, y / gate.duration
            turns[team, i] = rate * gate.duration
            bends[team, i] = abs(speed * turns[team, i]) * gate.duration
            angles[team, i] += turns[team, i]
