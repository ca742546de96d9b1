"""Energy-tank filter: any motion while stored energy lasts, else law (4) (theorem D).

See docs/guarantees.md, section 8. Each robot updates its tank from its own bearings. Vectors
are pairs or triples in one frame. Bearing errors η cause an error of f of at most e = 2 sin(η/2) D,
m/s.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import flag, number
from ..compilation import inner_kernel, kernel
from ..engine.memory import read, write
from ..engine.state_checks import refuse_first
from ..engine.threads import Calls, Slice
from ..physics.neighbour_rows import degree_of, net_bearing_of
from ..physics.vectors import dot, norm, rounded, scaled, split
from ..robots.single_integrator import limit_factor, speed_scale
from ..robots.unicycle import clip
from ..scenario.scenario import Scenario
from .heading import into_cap, scale_of_step, without_error
from .robot_lanes import LANES, end_of_run, lanes_of, recall_sums, report, take_in, tell, weigh_rows
from .safety_filter import Float32, SafetyFilter, check_inputs, over_robots, register_filter
from .settings import TANK_MARGIN, check_margin, levels_follow_v
from .turning import desired_rates, gated_rates, pitch_of, rates_of, robot_of, turn


@inner_kernel(inline="code")
def descent_scale(strength, degree, merge_radius, duration, speed_limit):
    """Factor min(1, r/(2 D τ), v_max/‖f‖) on f with which V decreases, a number without unit.

    See theorem D; ‖f‖, D > 0 and v_max in m/s, r in m, τ in s.
    """
    unhurried = speed_limit / max(strength, speed_limit)
    return min(scale_of_step(degree, merge_radius, duration), unhurried)


@inner_kernel(inline="code")
def certain_descent(net_bearing, degree, displacement, merge_radius, error=0.0):
    """Certain decrease of V by a displacement: 2 f·Δ − (2/r) D ‖Δ‖² − 2 e ‖Δ‖, a number, m²/s.

    Summed over robots, for a step that begins with neighbours at least r apart (theorem D).
    """
    spent = 2.0 / merge_radius * degree * dot(displacement, displacement)
    sure = 2.0 * dot(net_bearing, displacement) - spent
    return sure - 2.0 * error * norm(displacement) if error > 0.0 else sure


@inner_kernel(inline="code")
def promised_descent(strength, scale, min_alignment, duration, error=0.0):
    """Required decrease of V per step: ε² τ s ‖f‖², a number, m²/s (theorem D).

    With errors τ s max(0, ε ‖f‖ − e)². It ensures rendezvous in finite time.
    """
    if error > 0.0:
        sure = max(min_alignment * strength - error, 0.0)
        return duration * scale * sure * sure
    return min_alignment * min_alignment * duration * scale * strength * strength


def descending_velocity(wanted, net_bearing, scale, min_alignment, error=0.0):
    """Velocity of law (4) along the desired line with the required decrease, pair or triple, m/s.

        v = s max(0, hᵀf − e) h,   h the wanted direction projected onto the cap |hᵀf| ≥ ε‖f‖

    ``wanted`` has any length; the direction is f/‖f‖ if it is zero. f is not zero. The tank kernel
    splits both vectors in separate loops and calls ``_law``.
    """
    (length, h), (_, towards) = split(wanted), split(net_bearing)
    h = h if length > 0.0 else towards
    return _law(h, towards, net_bearing, scale, min_alignment, error)


@inner_kernel(inline="code")
def _law(line, towards, net_bearing, scale, min_alignment, error):
    """``descending_velocity`` along a line ±h, for u = f/‖f‖, unit vectors."""
    h = scaled(line, -1.0 if dot(line, towards) < 0.0 else 1.0)  # h and −h are the same line
    h = into_cap(h, towards, min_alignment, towards)
    along = dot(h, net_bearing)
    return scaled(h, scale * (max(along - error, 0.0) if error > 0.0 else along))


@kernel(unroll=False)
def _spend(axes, robots, robot, arrays, work):
    """Actions of single integrators, executed where A + G(Δ) ≥ 0, and diagnostics (theorem D).

    Robots without a visible neighbour stop at no cost.
    """
    numbers, room, sums = work
    if numbers.shape[1] != LANES:  # always true; tells the compiler the row stride
        return
    observations, held, levels, actions, linked, deposits, carried_out = arrays[:7]
    alignment, lyapunov_rate = arrays[7:]
    lanes, limit, radius = lanes_of(numbers), robot.speed_limit, robot.merge_radius
    margin, duration = robot.gate.min_alignment, robot.gate.duration
    for first in range(robots[0], robots[1], LANES):
        stop = min(first + LANES, robots[1])
        rows = observations[first:stop]
        if sums.shape[1] > 0:
            recall_sums(sums, first, stop, lanes)
        else:
            weigh_rows(axes, rows, robot.neighbour_slots, room, lanes.f, lanes.degree)
        take_in(axes, held, first, stop, lanes.choice)
        level = levels[first:stop]
        for lane in range(len(level)):
            lanes.level[lane] = level[lane]
        _owe(axes, lanes, robot)
        _want(axes, lanes, robot)
        for lane in range(LANES):
            f, degree = read(lanes.f, lane, axes), lanes.degree[lane]
            error, accepted = robot.error_chord * degree, lanes.accepted[lane] > 0.0
            line, towards = read(lanes.heading, lane, axes), read(lanes.towards, lane, axes)
            law = rounded(_law(line, towards, f, lanes.scale[lane], margin, error))
            sent, sees = _either(accepted, read(lanes.wanted, lane, axes), law), degree > 0.0
            write(sent, lanes.sent, lane)
            lanes.accepted[lane] = 1.0 if accepted & sees else 0.0
        for lane in range(LANES):
            f, degree = read(lanes.f, lane, axes), lanes.degree[lane]
            sent, sees, strength = read(lanes.sent, lane, axes), degree > 0.0, lanes.strength[lane]
            moved, length = _moved(sent, limit, duration)
            error = robot.error_chord * degree
            deposit = certain_descent(f, degree, moved, radius, error) - lanes.owed[lane]
            write(scaled(sent, 1.0 if sees else 0.0), lanes.sent, lane)
            lanes.deposit[lane] = deposit if sees else 0.0
            along = dot(f, moved)
            told = sees & (strength > 0.0) & (length > 0.0)
            lanes.alignment[lane] = abs(along) / (length * strength) if told else np.nan
            lanes.lyapunov_rate[lane] = -2.0 * along / duration if sees else 0.0
        tell(lanes.degree, first, stop, linked)
        tell(lanes.accepted, first, stop, carried_out)
        tell(lanes.deposit, first, stop, deposits)
        report(axes, lanes, first, stop, actions, alignment, lyapunov_rate)


# Short loops: a long one has more operations that wait for each other than a processor looks ahead.


@inner_kernel(inline="text")
def _owe(axes, lanes, robot):
    """Length and direction of f in lanes, the factor s, and the guaranteed decrease of V."""
    margin, duration = robot.gate.min_alignment, robot.gate.duration
    for lane in range(LANES):
        lanes.strength[lane], towards = split(read(lanes.f, lane, axes))
        write(towards, lanes.towards, lane)
    for lane in range(LANES):
        strength, degree = lanes.strength[lane], lanes.degree[lane]
        scale = descent_scale(strength, degree, robot.merge_radius, duration, robot.speed_limit)
        error = robot.error_chord * degree
        lanes.scale[lane] = scale
        lanes.owed[lane] = promised_descent(strength, scale, margin, duration, error)


@inner_kernel(inline="text")
def _want(axes, lanes, robot):
    """Desired velocities in lanes, their lines, and whether they are accepted."""
    limit, duration = robot.speed_limit, robot.gate.duration
    for lane in range(LANES):
        desired = scaled(read(lanes.choice, lane, axes), limit)
        speed, line = split(desired)
        write(_either(speed > 0.0, line, read(lanes.towards, lane, axes)), lanes.heading, lane)
        write(rounded(scaled(desired, limit_factor(speed, limit))), lanes.wanted, lane)
    for lane in range(LANES):
        f, degree = read(lanes.f, lane, axes), lanes.degree[lane]
        moved, _ = _moved(read(lanes.wanted, lane, axes), limit, duration)
        error = robot.error_chord * degree
        earned = certain_descent(f, degree, moved, robot.merge_radius, error) - lanes.owed[lane]
        lanes.accepted[lane] = 1.0 if lanes.level[lane] + earned >= 0.0 else 0.0


@inner_kernel(inline="code")
def _either(first, one, other):
    """Branch-free selection between two pairs or triples."""
    x, y = one[0] if first else other[0], one[1] if first else other[1]
    if len(one) == 2:
        return x, y
    return x, y, one[2] if first else other[2]


@inner_kernel(inline="code")
def _moved(sent, limit, duration):
    """Executed displacement of a commanded velocity, and its length, m."""
    speed, within = speed_scale(dot(sent, sent), limit)
    return scaled(sent, duration * within), duration * within * speed


@kernel(unroll=False)
def _spend_bodies(axes, robots, robot, arrays, work):
    """As ``_spend``, for nonholonomic robots, in their body frames."""
    observations, held, levels, actions, linked, deposits, carried_out = arrays[:7]
    alignment, lyapunov_rate = arrays[7:]
    limit, radius, gate = robot.speed_limit, robot.merge_radius, robot.gate
    for i in range(robots[0], robots[1]):
        deposits[i], carried_out[i] = 0.0, False
        alignment[i], lyapunov_rate[i] = np.nan, 0.0
        rows, action = observations[i], actions[i]
        action[:] = 0.0
        degree = degree_of(rows, robot.neighbour_slots)
        linked[i] = degree > 0.0
        if degree == 0.0:
            continue
        f, error = net_bearing_of(rows, robot.neighbour_slots), robot.error_chord * degree
        pitch, strength = pitch_of(rows, robot.gravity_row, gate), norm(f)
        action[0] = clip(held[i, 0], 1.0) * limit
        m = turn(desired_rates(held[i, 1:], gate), pitch, action, gate)
        moved = _driven(m, action, limit, gate)
        deposits[i] = certain_descent(f, degree, moved, radius, error)
        carried_out[i] = levels[i] + deposits[i] >= 0.0
        if not carried_out[i]:
            m = turn(gated_rates(rates_of(action, gate), f, pitch, gate), pitch, action, gate)
            scale = descent_scale(strength, degree, radius, gate.duration, limit)
            action[0] = scale * without_error(dot(m, f), error)
            moved = _driven(m, action, limit, gate)
            deposits[i] = certain_descent(f, degree, moved, radius, error)
        if strength > 0.0:
            alignment[i] = abs(f[0]) / strength
        lyapunov_rate[i] = -2.0 * dot(f, moved) / gate.duration


@kernel
def _spend_by_model(axes, robots, robot, arrays, work):
    """``_spend`` of holonomic robots, ``_spend_bodies`` of nonholonomic ones."""
    observations, held, levels, actions, linked, deposits, carried_out = arrays[:7]
    alignment, lyapunov_rate, turning = arrays[7:]
    memory = observations, held, levels, actions, linked
    given = (*memory, deposits, carried_out, alignment, lyapunov_rate)
    first = robots[0]
    while first < robots[1]:
        run = first, end_of_run(turning, first, robots[1])
        if turning[first]:
            _spend_bodies(axes, run, robot, given, work)
        else:
            _spend(axes, run, robot, given, work)
        first = run[1]


@inner_kernel(inline="code")
def _driven(m, action, limit, gate):
    """The displacement τ v m of an action's speed, after rounding (theory 4, arcs)."""
    return scaled(m, gate.duration * clip(np.float64(action[0]), limit))


@kernel
def _book(teams, levels, deposits, linked, contact, merged_into, resting, follow_v):
    """Update A ← max(A + G, 0) in place (theorem D); negative values are rounding.

    In a step with contact only losses count, since pressing against a wall would otherwise fill the
    tank.
    """
    first, stop = teams[0], teams[1]
    for team in range(first, stop):
        if resting[team]:
            deposits[team] = 0.0
    level, deposit = levels[first:stop].reshape(-1), deposits[first:stop].reshape(-1)
    touched = contact[first:stop].reshape(-1)
    for i in range(len(level)):
        lost = touched[i] & (deposit[i] > 0.0)
        level[i] = max(level[i] + (0.0 if lost else deposit[i]), 0.0)
    for team in range(first, stop):
        merged = 0
        for i in range(levels.shape[1]):
            merged += merged_into[team, i] != i
        if merged > 0:
            _hand_over(levels[team], linked[team], merged_into[team], follow_v)
    deposits[first:stop] = 0.0
    linked[first:stop] = False


@inner_kernel
def _hand_over(levels, linked, merged_into, follow_v):
    """Transfer stored energy to survivors, (n,); levels that follow V scale by (m' − 1)/(m − 1)."""
    before, gone = 0, 0
    for i in range(len(levels)):
        survivor = merged_into[i]
        before += linked[i]
        if survivor != i:
            gone += linked[i]
            levels[survivor] += levels[i]
            levels[i] = 0.0
    if follow_v and gone > 0:
        for i in range(len(levels)):
            levels[i] *= (before - gone - 1) / (before - 1)


_LARGEST = float(np.finfo(np.float32).max)
_FULLEST = 1e60  # m²/s; above any level of an episode, with finite sums


def unit_of_tanks(scenario: Scenario) -> float:
    """Unit r D̄ of observed levels, a number, m²/s: twice the maximum gain of a step (theorem D).

    It is 1 without links.
    """
    return float(scenario.merge_radius * scenario.max_degree) or 1.0


class EnergyTank(SafetyFilter):
    """Energy-tank filter of B environments (theorem D).

        A ← A + G(Δ),   G(Δ) = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²              (guarantees 8)

    A desired velocity is executed where A + G ≥ 0, else law (4) along it; G is that of the
    commanded float32 action. For nonholonomic robots G has no term ε²; with an empty tank they turn
    through the gate and drive with v = s mᵀf. A policy, which does not observe contacts and merges,
    calls ``update()`` without arguments after each ``apply``.

    Args:
        scenario, num_envs, frame, num_threads: as ``SafetyFilter``.
        budget: B_i, initial stored energy of every robot, m²/s.
        min_alignment: ε, at least 10⁻⁶ and less than 1.
        observe_level: whether ``observe`` appends a row (A/(r D̄), 0, …).
        bearing_error: η, rad, maximum bearing error covered by the guarantee.
    """

    state_key = "tank"
    reuses_calls = True
    uses_feedback = True

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        budget: float = 0.0,
        min_alignment: float = TANK_MARGIN,
        frame: str = "net_bearing",
        observe_level: bool = False,
        bearing_error: float = 0.0,
        num_threads: int | None = None,
    ) -> None:
        check_inputs(scenario, "law (4)", bodies=True)
        super().__init__(scenario, num_envs, scenario.action_size, frame, num_threads)
        self._robot = robot_of(scenario, check_margin(min_alignment), bearing_error)
        self._make_sums(weighs=True)
        self.budget = number("budget", budget, 0.0, unit="m²/s")
        self.observes_level = flag("observe_level", observe_level)
        team = num_envs, scenario.n_robots
        self._levels = np.full(team, self.budget)
        self._deposits, self._linked = np.zeros(team), np.zeros(team, np.bool_)
        self._follow_v = levels_follow_v(scenario)
        self.carried_out = np.zeros(team, dtype=np.bool_)

    @property
    def levels(self) -> NDArray[np.float64]:
        """Stored energy A, (B, n), m²/s; zero for a merged robot."""
        return self._levels.copy()

    @property
    def normalised_levels(self) -> NDArray[np.float64]:
        """A/(r D̄), (B, n), see ``unit_of_tanks``."""
        return self._levels / unit_of_tanks(self.scenario)

    @property
    def diagnostics(self) -> dict[str, NDArray[Any]]:
        """As ``SafetyFilter.diagnostics``."""
        return {"tank": self._levels, "carried_out": self.carried_out, **super().diagnostics}

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        return {"levels": self._levels, **super()._memory}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._levels[which], self._deposits[which] = self.budget, 0.0
        self._linked[which] = self.carried_out[which] = False

    def _level_calls(self, teams: Any, shown: Float32) -> Calls:
        return [partial(self._show_levels, teams, shown)] if self.observes_level else ()

    def _show_levels(self, teams: Any, shown: Float32) -> None:
        levels = self._levels[teams] / unit_of_tanks(self.scenario)
        shown[teams, :, -1] = 0.0
        shown[teams, :, -1, 0] = np.minimum(levels, _LARGEST)

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``SafetyFilter.apply_calls``; ``update`` adds the gain of the step."""
        act: Any = _spend_bodies if self.turns_body else _spend
        told: tuple[NDArray[Any], ...] = self._deposits, self.carried_out
        told = *told, self.alignment, self.lyapunov_rate
        memory = self._held, self._levels, actions, self._linked
        if self.mixes_models:
            act, told = _spend_by_model, (*told, self._turning)
        given, sums = (act, part, self._robot, observations), self._sums_of(observations)
        return over_robots(*given, *memory, *told, sums=sums)

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """As ``SafetyFilter.update_calls``; a step truncated by a merge counts as commanded."""
        account = self._levels, self._deposits, self._linked
        step = contact, merged_into, resting
        return [partial(_book, part, *account, *step, self._follow_v)]

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """As ``SafetyFilter.check_state``; levels must not be negative."""
        checked = super().check_state(state)
        levels = checked["levels"]
        wrong = (levels < 0) | (levels > _FULLEST)
        refuse_first("levels", wrong, levels, f"from 0 to {_FULLEST:g} m²/s")
        return checked


register_filter("tank", EnergyTank)
