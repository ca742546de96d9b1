"""Gain filter: neighbour weights to velocities that keep the convex hull (theorem G)."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import positive, raise_invalid
from ..compilation import inner_kernel, kernel
from ..engine.threads import Calls, Slice
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import combine, dot, load, norm, scaled, store
from ..robots.single_integrator import speed_scale
from ..scenario.scenario import Scenario
from .links import alignment_of
from .safety_filter import Float32, SafetyFilter, check_inputs, over_robots, register_filter

_NOTHING = 1e-30  # weights that add up to less, m/s, are none


class _Constants(NamedTuple):
    neighbour_slots: int
    min_gain: float  # m/s
    max_gain: float
    speed_limit: float


def gain_range(
    scenario: Scenario, min_gain: Any = None, max_gain: Any = None
) -> tuple[float, float]:
    """Limits c and C of Σ_j c_ij in force, numbers, m/s, at most r/τ (theorem G).

    The defaults are a* and D̄, adjusted to a given other limit.

    Raises:
        ValueError: naming a limit that is not positive, too large for the step, or inconsistent.
    """
    safe = scenario.merge_radius / scenario.tau
    least = None if min_gain is None else positive("min_gain", min_gain, "m/s")
    most = None if max_gain is None else positive("max_gain", max_gain, "m/s")
    if least is not None and least > safe:
        raise_invalid(
            "min_gain", min_gain, f"at most r/τ = {safe} m/s, so that the hull never grows"
        )
    if least is not None and most is not None and most < least:
        raise_invalid("max_gain", max_gain, f"at least min_gain = {least} m/s")
    if most is None:
        most = max(scenario.max_degree, least or 0.0)
    most = min(most, safe)
    if least is None:
        least = min(scenario.bottleneck_weight or most, most)
    return least, most


class Gains(SafetyFilter):
    """Gain filter of B environments (theorem G).

        v_i = Σ_j c_ij g_ij,   c_ij ∝ w_j a_ij,   min_gain ≤ Σ_j c_ij ≤ max_gain

    Weights are clipped to [0, 1]; if all present ones are zero, they are equal. Gains are scaled
    down where ‖v_i‖ would exceed v_max. Arguments as ``SafetyFilter`` and ``gain_range``.
    """

    state_key = "gains"
    reuses_calls = True
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
        check_inputs(scenario, "theorem G")
        size = scenario.observation_layout.neighbour_slots
        super().__init__(scenario, num_envs, size, frame, num_threads)
        limits = *gain_range(scenario, min_gain, max_gain), scenario.min_speed_limit
        self._constants = _Constants(self._robot.neighbour_slots, *map(float, limits))
        self.gain = np.zeros((num_envs, scenario.n_robots))

    @property
    def diagnostics(self) -> dict[str, NDArray[Any]]:
        """As ``SafetyFilter.diagnostics``."""
        return {"gain": self.gain, **super().diagnostics}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self.gain[which] = 0.0

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``SafetyFilter.apply_calls``."""
        arrays = observations, self._held, actions, self.gain, self.alignment, self.lyapunov_rate
        return over_robots(_weigh, part, self._constants, *arrays)


register_filter("gains", Gains)


@kernel
def _weigh(axes, robots, constants, arrays, work):
    observations, held, actions, gain, alignment, lyapunov_rate = arrays
    for i in range(robots[0], robots[1]):
        rows, weights = observations[i], held[i]
        total, towards = _weighted(rows, weights, constants.neighbour_slots, 0.0)
        if total < _NOTHING:  # all count alike
            total, towards = _weighted(rows, weights, constants.neighbour_slots, 1.0)
        sought = min(max(total, constants.min_gain), constants.max_gain) if total > 0.0 else 0.0
        velocity = scaled(scaled(towards, 1.0 / total if total > 0.0 else 0.0), sought)
        _, within = speed_scale(dot(velocity, velocity), constants.speed_limit)
        velocity = scaled(velocity, within)
        store(velocity, actions[i])
        f = net_bearing_of(rows, constants.neighbour_slots)
        gain[i] = sought * within
        alignment[i] = alignment_of(velocity, f)
        lyapunov_rate[i] = -2.0 * dot(f, velocity)


@inner_kernel
def _weighted(rows, weights, neighbour_slots, least):
    """Σ_j w_j a_ij, m/s, and Σ_j w_j a_ij g_ij, a triple, for weights clipped to [``least``, 1]."""
    total, towards = 0.0, (0.0, 0.0, 0.0)
    for k in range(neighbour_slots):
        row, weight = load(rows[k]), min(max(weights[k], least), 1.0)
        total += weight * norm(row)
        towards = combine(1.0, towards, weight, row)
    return total, towards
