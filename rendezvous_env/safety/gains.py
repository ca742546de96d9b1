"""Gain filter: neighbour weights to velocities that keep the convex hull (theorem G)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import is_sequence, positive, raise_invalid
from ..compilation import inner_kernel, kernel
from ..engine.threads import Calls, Slice
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import combine, dot, load, norm, scaled, store
from ..robots.single_integrator import speed_scale
from ..scenario.scenario import Scenario
from .links import alignment_of
from .safety_filter import Float32, SafetyFilter, check_inputs, over_robots, register_filter

_NOTHING = 1e-30  # m/s; a smaller sum of weights counts as zero


class _Constants(NamedTuple):
    neighbour_slots: int
    min_gains: NDArray[np.float64]  # of each robot, (n,), m/s
    max_gains: NDArray[np.float64]
    speed_limit: float


def gain_ranges(
    scenario: Scenario, min_gain: Any = None, max_gain: Any = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Limits c_i and C_i in use of Σ_j c_ij of each robot, (n,), m/s, at most r/τ (theorem G).

    Limits are one number for all robots or a list with one for each. The defaults are a* and D̄,
    adjusted to a given other limit.

    Raises:
        ValueError: naming a limit that is not positive, too large for the step, or inconsistent.
    """
    safe, n = scenario.merge_radius / scenario.tau, scenario.n_robots
    least, most = _given("min_gain", min_gain, n), _given("max_gain", max_gain, n)
    for robot in range(n):
        at = f"[{robot}]" * is_sequence(min_gain)
        if least is not None and least[robot] > safe:
            wanted = f"at most r/τ = {safe} m/s, so that the hull never grows"
            raise_invalid(f"min_gain{at}", float(least[robot]), wanted)
        if least is not None and most is not None and most[robot] < least[robot]:
            wanted = f"at least min_gain{at} = {float(least[robot])} m/s"
            at = f"[{robot}]" * is_sequence(max_gain)
            raise_invalid(f"max_gain{at}", float(most[robot]), wanted)
    if most is None:
        most = np.maximum(scenario.max_degree, 0.0 if least is None else least.max())
    most = np.broadcast_to(np.minimum(most, safe), n)
    if least is None:
        least = np.minimum(scenario.bottleneck_weight or most, most)
    return least, most


def _given(field: str, value: Any, n: int) -> NDArray[np.float64] | None:
    """A limit of each robot, (n,), m/s, from one number or a list; None for None."""
    if value is None:
        return None
    if not is_sequence(value):
        return np.full(n, positive(field, value, "m/s"))
    if len(value) != n:
        wanted = f"{n} numbers, one for each robot, or a single one for all of them"
        raise_invalid(field, list(value), wanted)
    return np.array([positive(f"{field}[{k}]", own, "m/s") for k, own in enumerate(value)])


def gain_range(
    scenario: Scenario, min_gain: Any = None, max_gain: Any = None
) -> tuple[float, float]:
    """Pair of limits c and C on Σ_j c_ij for all robots, m/s, as theorem G assumes.

    They are the least and the largest of ``gain_ranges``; errors are the same.
    """
    least, most = gain_ranges(scenario, min_gain, max_gain)
    return float(least.min()), float(most.max())


class Gains(SafetyFilter):
    """Gain filter of B environments (theorem G).

        v_i = Σ_j c_ij g_ij,   c_ij ∝ w_j a_ij,   min_gain ≤ Σ_j c_ij ≤ max_gain

    Both limits may differ between robots. Weights are clipped to [0, 1]; if all present ones are
    zero, they are equal. Gains are scaled down where ‖v_i‖ would exceed v_max. Arguments as
    ``SafetyFilter`` and ``gain_ranges``.
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
        min_gain: float | Sequence[float] | None = None,
        max_gain: float | Sequence[float] | None = None,
        frame: str = "net_bearing",
        num_threads: int | None = None,
    ) -> None:
        check_inputs(scenario, "theorem G")
        size = scenario.observation_layout.neighbour_slots
        super().__init__(scenario, num_envs, size, frame, num_threads)
        least, most = gain_ranges(scenario, min_gain, max_gain)
        self._constants = _Constants(
            neighbour_slots=self._robot.neighbour_slots,
            min_gains=np.array(least),
            max_gains=np.array(most),
            speed_limit=float(scenario.min_speed_limit),
        )
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
    n = len(constants.min_gains)
    for i in range(robots[0], robots[1]):
        rows, weights = observations[i], held[i]
        total, towards = _weighted(rows, weights, constants.neighbour_slots, 0.0)
        if total < _NOTHING:  # equal weights
            total, towards = _weighted(rows, weights, constants.neighbour_slots, 1.0)
        low, high = constants.min_gains[i % n], constants.max_gains[i % n]
        sought = min(max(total, low), high) if total > 0.0 else 0.0
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
