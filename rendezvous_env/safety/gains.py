"""Gains: one weight per neighbour in, velocities within the hull of the team out (theorem G)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import positive, refuse
from ..compilation import inner_kernel, kernel
from ..engine.state_checks import check_observations
from ..engine.threads import each_block
from ..physics.rows import net_bearing_of
from ..physics.vectors import combine, dot, load, norm, scaled, store
from ..robots.single_integrator import speed_scale
from ..scenario.scenario import Scenario
from .links import alignment_of
from .safety_filter import (
    SafetyFilter,
    check_goes_anywhere,
    over_teams,
    register_filter,
    teams_of_block,
)

_NOTHING = 1e-30
"""Weights that add up to less, m/s, are none."""


class _Constants(NamedTuple):
    """What the kernels need to know of the scenario and of the arguments."""

    neighbour_slots: int
    min_gain: float
    max_gain: float
    speed_limit: float


class GainRange(NamedTuple):
    """Between which limits the gains of each robot add up, m/s."""

    least: float
    """c: Σ_j c_ij of a robot that sees somebody is at least this."""
    most: float
    """At most r/τ: a robot then stays within the hull of the team for the whole step."""


def gain_range(scenario: Scenario, min_gain: Any = None, max_gain: Any = None) -> GainRange:
    """The limits of Σ_j c_ij in force (theorem G).

    Args:
        scenario: gives the defaults a* and D̄, and r/τ, which no gain exceeds.
        min_gain: c, m/s; None is a*, or ``max_gain`` or r/τ if that is less.
        max_gain: m/s; None is D̄, or ``min_gain`` if that is more.

    Returns:
        Two numbers, m/s.

    Raises:
        ValueError: naming the argument that is not positive, too large for the step, or less than
            the other.
    """
    safe = scenario.merge_radius / scenario.tau
    least = None if min_gain is None else positive("min_gain", min_gain, "m/s")
    most = None if max_gain is None else positive("max_gain", max_gain, "m/s")
    if least is not None and least > safe:
        refuse("min_gain", min_gain, f"at most r/τ = {safe:.6g} m/s, so that the hull never grows")
    if least is not None and most is not None and most < least:
        refuse("max_gain", max_gain, f"at least min_gain = {least:.6g} m/s")
    if most is None:
        most = max(scenario.max_degree, least or 0.0)
    most = min(most, safe)
    if least is None:
        least = min(scenario.bottleneck_weight or most, most)
    return GainRange(least, most)


class Gains(SafetyFilter):
    """Held weights and frames of the robots of B teams (theorem G).

        v_i = Σ_j c_ij g_ij,   c_ij ∝ w_j a_ij,   min_gain ≤ Σ_j c_ij ≤ max_gain

    Weights are cut to [0, 1]; if all of those that count are zero, all are equal. Where ‖v_i‖ would
    exceed v_max all gains of the robot are scaled down to that, and stay at least v_max in all.

    Args:
        scenario: whose robots they are.
        num_envs: B.
        min_gain: m/s, see ``gain_range``.
        max_gain: m/s, likewise.
        frame: of what is observed, "net_bearing" (x along f) or "local".
        num_threads: most threads that may be used; None is one for each core.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    state_key = "gains"
    chooses_vectors = False
    lowest_choice = 0.0

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        min_gain: float | None = None,
        max_gain: float | None = None,
        frame: str = "net_bearing",
        num_threads: int | None = None,
    ) -> None:
        check_goes_anywhere(scenario, "theorem G")
        super().__init__(
            scenario,
            num_envs,
            action_size=scenario.observation_layout.neighbour_slots,
            frame=frame,
            num_threads=num_threads,
        )
        self.range = gain_range(scenario, min_gain, max_gain)
        self._constants = _Constants(
            neighbour_slots=self._sight.neighbour_slots,
            min_gain=float(self.range.least),
            max_gain=float(self.range.most),
            speed_limit=float(scenario.speed_limit),
        )
        self.gain = np.zeros((num_envs, scenario.n_robots))

    @property
    def told(self) -> dict[str, NDArray[Any]]:
        """What there is to tell of the last step, (B, n) each; not copied."""
        return {"gain": self.gain, **super().told}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self.gain[which] = 0.0

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """As ``SafetyFilter.act``."""
        observations = check_observations(observations, self._seen)
        shape = (*self._held.shape[:2], self.scenario.dim)
        actions = np.zeros(shape, dtype=np.float32)
        fixed = (observations, self._constants, self._held)
        given = (actions, self.gain, self.alignment, self.lyapunov_rate)
        over_teams(lambda part: weigh_bearings(part, *fixed, *given), *self._batch)
        return actions


register_filter("gains", Gains)


@kernel
def weigh_bearings(share, observations, constants, held, actions, gain, alignment, lyapunov_rate):
    """The velocities of the teams that this thread takes, v = Σ_j c_ij g_ij (theorem G).

    Args:
        share: this thread's part, see ``engine.threads``.
        observations: (B, n, rows, d), m/s, in the robots' own frames.
        constants: of the scenario and of the arguments, see ``Gains``.
        held: w, (B, n, K), without unit.
        actions: v, (B, n, d) float32, m/s; filled in.
        gain: Σ_j c_ij, (B, n), m/s; filled in.
        alignment: |hᵀf|/‖f‖, (B, n), h along v; filled in, NaN where either is zero.
        lyapunov_rate: −2 f·v, (B, n), m²/s²; filled in.
    """
    arguments = observations, constants, held, actions, gain, alignment, lyapunov_rate
    each_block(share, _weigh_for_teams, arguments)


@inner_kernel(inline="text")
def _weigh_for_teams(block, arguments):
    observations, constants, held, actions, gain, alignment, lyapunov_rate = arguments
    first, last = teams_of_block(block, len(observations))
    for team in range(first, last):
        for i in range(observations.shape[1]):
            rows = observations[team, i]
            total, towards = weighted_bearings(rows, held[team, i], constants.neighbour_slots)
            sought = min(max(total, constants.min_gain), constants.max_gain)
            if total == 0.0:
                sought = 0.0
            velocity = scaled(towards, sought)
            _, within = speed_scale(dot(velocity, velocity), constants.speed_limit)
            velocity = scaled(velocity, within)
            store(velocity, actions[team, i])
            f = net_bearing_of(rows, constants.neighbour_slots)
            gain[team, i] = sought * within
            alignment[team, i] = alignment_of(velocity, f)
            lyapunov_rate[team, i] = -2.0 * dot(f, velocity)


@kernel
def weighted_bearings(rows, weights, neighbour_slots):
    """The sum of weighted gains Σ_j w_j a_ij, and the average Σ_j w_j a_ij g_ij / Σ_j w_j a_ij.

    Args:
        rows: of one robot, a_ij g_ij, (rows, d), m/s; zero rows are absent and do not count.
        weights: w, (K,), cut to [0, 1]; if all that count are zero, all are 1.
        neighbour_slots: K.

    Returns:
        A number, m/s, and a triple without unit; both zero where nobody is seen.
    """
    total, towards = _weighted(rows, weights, neighbour_slots, 0.0)
    if total < _NOTHING:
        total, towards = _weighted(rows, weights, neighbour_slots, 1.0)
    return total, scaled(towards, 1.0 / total if total > 0.0 else 0.0)


@kernel
def _weighted(rows, weights, neighbour_slots, least):
    total, towards = 0.0, (0.0, 0.0, 0.0)
    for k in range(neighbour_slots):
        row, weight = load(rows[k]), min(max(weights[k], least), 1.0)
        total += weight * norm(row)
        towards = combine(1.0, towards, weight, row)
    return total, towards
