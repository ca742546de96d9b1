"""Validation of external arrays for compiled code, which does not validate."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import bools, check_shape, floats, format_limit, short_repr
from ..obstacles.obstacle_set import faults, pack
from ..obstacles.parsing import only_balls
from ..obstacles.shape import ABSENT, CENTRE, KIND
from ..outcome import StepOutput
from ..scenario.scenario import Scenario
from .memory import AWAITING_RESET, RENDEZVOUS
from .preparation import robot, speed_limits_of
from .step import first_not_finite

_ROUNDING = 1e-9
PLACE = slice(CENTRE, CENTRE + 3)
"""Columns of an obstacle's centre in a table."""
_FINITE = (
    "positions", "memory", "weights", "path_length", "initial_lyapunov", "frames", "past", "held",
    "detection", "errors", "traffic", "commands",
)  # fmt: skip
_NOT_NEGATIVE = "weights", "steps", "contacts", "path_length", "initial_lyapunov", "detection"
_MOST = {
    "positions": 1e36,
    "memory": 1e36,
    "weights": 1e13,
    "path_length": 1e36,
    "initial_lyapunov": 1e54,
    "obstacles": 1e9,
    "past": 1e13,
    "held": 1e13,
    "detection": 1.0,
    "errors": 6.5,
    "traffic": 1e15,
}
"""Absolute values up to which a step does not overflow."""
_FLOAT32 = np.dtype(np.float32)
_FLOATS = _FLOAT32, np.dtype(np.float64)


def check_keys(state: Any, names: tuple[str, ...], *, exactly: bool = False) -> None:
    """Reject a value that is not a mapping with these entries, with a ValueError.

    ``exactly`` also rejects further entries.
    """
    if not isinstance(state, Mapping):
        raise ValueError(
            f"state is {short_repr(state)}; it must be a mapping with {', '.join(names)}"
        )
    for name in names:
        if name not in state:
            raise ValueError(f"state: entry {name!r} is missing")
    if exactly and (unknown := sorted(map(str, set(state) - set(names)))):
        known = ", ".join(names)
        raise ValueError(
            f"state: entry {short_repr(unknown[0])} is unknown; it must be one of {known}"
        )


def check_entries(
    own: Mapping[str, NDArray[Any]], state: Any, *, exactly: bool = False
) -> dict[str, NDArray[Any]]:
    """Entries of a state, with shape and type as in ``own``; lists of numbers are accepted.

    ``exactly`` rejects further entries, and other types instead of converting them.

    Raises:
        ValueError: for an invalid entry; the message gives its name and a remedy.
    """
    check_keys(state, tuple(own), exactly=exactly)
    return {name: _entry(name, state[name], array, exactly) for name, array in own.items()}


def _entry(name: str, given: Any, own: NDArray[Any], exactly: bool) -> NDArray[Any]:
    try:
        value = np.asarray(given)
    except (TypeError, ValueError) as error:
        raise ValueError(f"state: {name} must be an array of {own.dtype}: {error}") from error
    fits = value.dtype == own.dtype if exactly else np.can_cast(value.dtype, own.dtype, "same_kind")
    if value.shape != own.shape or not fits:
        raise ValueError(
            f"state: {name} is {value.dtype} of shape {value.shape}; "
            f"{name} must be an array of shape {own.shape} and must be {own.dtype}"
        )
    return value.astype(own.dtype, copy=False)


def refuse_first(name: str, wrong: NDArray[np.bool_], values: NDArray[Any], what: str) -> None:
    """Raise an error for the first wrong index, if there is any.

    An index is (environment,), (environment, robot), (environment, slot) or longer.
    """
    if wrong.any():
        place = tuple(int(k) for k in np.argwhere(wrong)[0])
        where = ", ".join(map(str, place))
        raise ValueError(f"state: {name}[{where}] is {values[place].tolist()}; it must be {what}")


def check_finite(state: Mapping[str, NDArray[Any]], names: Iterable[str]) -> None:
    """Reject entries that are not finite."""
    for name in names:
        refuse_first(name, ~np.isfinite(state[name]), state[name], "finite")


def check_rotations(state: Mapping[str, NDArray[Any]], teams: Any, tolerance: float) -> None:
    """Reject frames, (B, n, d, d) or (B, n, d·d), of these environments that are not rotations."""
    given = state["frames"]
    d = 3 if given.shape[-1] % 3 == 0 else 2
    frames = given.reshape(*given.shape[:2], d, d)
    with np.errstate(over="ignore", invalid="ignore"):  # huge values are rejected
        gap = np.abs(np.swapaxes(frames, -1, -2) @ frames - np.eye(d)).max(axis=(-2, -1))
        wrong = ~((gap <= tolerance) & (np.linalg.det(frames) > 0))
    refuse_first("frames", wrong & np.reshape(teams, (-1, 1)), frames, "a rotation")


class StatefulMixin:
    """Mixin for components with memory of B environments, in ``_memory``."""

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        """Arrays (B, ...) by name, not copied."""
        raise NotImplementedError

    def _begin(self, which: Any) -> None:
        """Initialise the memory of these environments, indices or a slice, before an episode."""
        for array in self._memory.values():
            array[which] = 0.0

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Reset the memory of all environments, or of those of a mask (B,).

        Raises:
            ValueError: for an invalid mask; the memory is unchanged.
        """
        which: Any = slice(None)
        if mask is not None:  # indices are faster than a mask
            which = np.flatnonzero(check_mask(mask, len(next(iter(self._memory.values())))))
        self._begin(which)

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """Copies of the memory."""
        return {name: array.copy() for name, array in self._memory.items()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Restore a result of ``get_state``; an error of ``check_state`` leaves it unchanged."""
        checked = self.check_state(state)
        for name, array in self._memory.items():
            array[...] = checked[name]

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """Validate a state and return its arrays.

        Raises:
            ValueError: for an entry that is missing, unknown, of another shape or not finite.
        """
        check_keys(state, tuple(self._memory), exactly=True)
        checked = check_entries(self._memory, state)
        check_finite(checked, checked)
        return checked


def _check_velocities(scenario: Scenario, memory: NDArray[Any]) -> None:
    """Reject velocities above the limits, which bound the displacement in a step."""
    limits = speed_limits_of(robot(scenario))
    velocities = memory[..., scenario.model.n_angles :]
    too_fast = np.linalg.norm(velocities, axis=-1) > limits * (1 + _ROUNDING)
    refuse_first(
        "memory", too_fast, memory, f"a velocity of at most {format_limit(limits.max())} m/s"
    )


def _check_conditions(state: Mapping[str, NDArray[Any]]) -> None:
    """Reject impossible steps of activations and of failures."""
    if "last_activation" in state:
        own, latest = state["last_activation"], state["steps"][:, None] - 1
        wrong = (own < -1) | (own > latest)
        refuse_first("last_activation", wrong, own, "from -1 to steps - 1")
    if "faults" in state:
        refuse_first("faults", state["faults"] < 0, state["faults"], "0 or more")


def check_teams(scenario: Scenario, state: Mapping[str, NDArray[Any]]) -> None:
    """Reject a state of ``Simulator.get_state`` that no episode can have.

    Shapes and types are already valid. The ValueError gives the entry, its value and a remedy.
    """

    def refuse(name: str, wrong: Any, what: str) -> None:
        refuse_first(name, wrong, state[name], what)

    check_finite(state, (name for name in _FINITE if name in state))
    for name in _NOT_NEGATIVE:
        if name in state:
            refuse(name, state[name] < 0, "0 or more")
    for name, most in _MOST.items():
        if name in state:
            refuse(name, np.abs(state[name]) > most, f"at most {format_limit(most)}")
    initial, status = state["initial_lyapunov"], state["status"]
    refuse("initial_lyapunov", (initial != 0) & (initial < 1e-30), "0, or 1e-30 or more")
    refuse("min_clearance", ~(state["min_clearance"] > -np.inf), "a length or inf, m")
    refuse("status", (status < 0) | (status > AWAITING_RESET), f"0 to {AWAITING_RESET}")
    refuse("seed", state["seed"] >= 2**63, "below 2**63")
    refuse("episode", state["episode"] < -1, "-1 (none yet) or more")
    _check_conditions(state)
    if "frames" in state:  # environments before their first reset have none
        check_rotations(state, state["episode"] >= 0, _ROUNDING)
    if scenario.model.keeps_velocity:
        _check_velocities(scenario, state["memory"])
    if "first" in state:
        _check_lists(scenario.n_robots, state)
    _check_merges(state, scenario.meeting == "pack")
    _check_neighbours(scenario, state)
    for fault, wanted in faults(state["obstacles"], scenario.dim, only_balls(scenario.obstacles)):
        refuse("obstacles", fault, wanted)
    if "traffic" in state:
        off = _off_place(scenario, state["obstacles"], state["traffic"][..., :3])
        refuse("obstacles", off, "a row displaced by the first numbers of traffic")


def _off_place(
    scenario: Scenario, table: NDArray[np.float64], offsets: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """True for each obstacle of tables (B, M, width) that is not at its displacement, m."""
    assert isinstance(scenario.obstacles, tuple)  # a field does not move
    base = pack(scenario.obstacles, *table.shape[1:])[:, PLACE]
    off, large = table[..., PLACE] - base - offsets, 1.0 + np.abs(base) + np.abs(offsets)
    wrong = (np.abs(off) > _ROUNDING * large).any(axis=-1)
    return np.asarray(wrong & (table[..., KIND] != ABSENT))


def _check_lists(n: int, state: Mapping[str, NDArray[Any]]) -> None:
    """Check lists of links: indices of two robots, the lower first, sorted, unused entries last."""
    first, second, used = state["first"], state["second"], state["weights"] > 0
    refuse_first("first", (first < 0) | (first >= n), first, f"from 0 to {n - 1}")
    refuse_first("second", (second < 0) | (second >= n), second, f"from 0 to {n - 1}")
    refuse_first("second", used & (second <= first), second, "above the other robot of its link")
    order = first * n + second
    ahead = np.concatenate([np.full((len(used), 1), -1), order[:, :-1]], axis=1)
    refuse_first("first", used & (order <= ahead), first, "in the order of the links, each once")
    refuse_first("weights", used[:, 1:] & ~used[:, :-1], state["weights"][:, 1:], "0 after a 0")


def _check_merges(state: Mapping[str, NDArray[Any]], packs: bool) -> None:
    """Check merges: robots are part of an active robot with a lower index; bodies do not merge."""
    into, status = state["merged_into"], state["status"]
    n = into.shape[1]
    if packs:
        refuse_first("merged_into", into != np.arange(n), into, "the robot's own index")
        return
    wrong = (into < 0) | (into > np.arange(n))
    refuse_first("merged_into", wrong, into, "from 0 to the robot's own")
    survives = np.take_along_axis(into, into, axis=1) == into
    refuse_first("merged_into", ~survives, into, "a robot that has itself not merged")
    one_left = (into != np.arange(n)).sum(axis=1) == n - 1
    what = f"{RENDEZVOUS} exactly in environments in which one robot is left"
    refuse_first("status", (status == RENDEZVOUS) != one_left, status, what)


def _check_neighbours(scenario: Scenario, state: Mapping[str, NDArray[Any]]) -> None:
    """Check links: none to the robot itself or a merged one, and no more than neighbour rows."""
    n, weights = scenario.n_robots, state["weights"]
    slots, used = scenario.observation_layout.neighbour_slots, weights > 0
    gone = state["merged_into"] != np.arange(n)
    if weights.ndim == 3:
        own = used & np.eye(n, dtype=bool)
        refuse_first("weights", own, weights, "0: no robot is its own neighbour")
        counts, of_gone = used.sum(axis=2), gone[:, :, None] | gone[:, None, :]
    else:
        ends = (state["first"], state["second"]) if "first" in state else np.triu_indices(n, 1)
        counts, of_gone = np.zeros(gone.shape, np.int64), np.zeros(used.shape, np.bool_)
        for robots in ends:
            robots = np.broadcast_to(robots, used.shape)
            team, e = np.nonzero(used)
            np.add.at(counts, (team, robots[team, e]), 1)
            of_gone |= np.take_along_axis(gone, robots, axis=1)
    refuse_first("weights", used & of_gone, weights, "0 for pairs with a merged robot")
    if (counts > slots).any():
        where = tuple(int(k) for k in np.argwhere(counts > slots)[0])
        raise ValueError(
            f"state: weights give robot_{where[1]} of environment {where[0]} {counts[where]} "
            f"neighbours; there are rows for neighbour_slots = {slots}"
        )


def check_output(output: Any, wanted: tuple[tuple[tuple[int, ...], Any], ...]) -> None:
    """Reject the output of other environments, which compiled code would write to.

    ``wanted`` has shape and type of each of its arrays.
    """
    if not isinstance(output, StepOutput):
        raise ValueError(
            f"outcome is {short_repr(output)}; it must be the output of step(), or None"
        )
    arrays: tuple[Any, ...] = output
    for name, array, (shape, kind) in zip(StepOutput._fields, arrays, wanted, strict=True):
        if array.shape != shape or array.dtype != kind or not array.flags.carray:
            raise ValueError(
                f"outcome: {name} is {array.dtype} of shape {array.shape}; a step of these "
                f"environments returns {kind} of shape {shape}, contiguous and writable"
            )


def check_observations(value: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Observations (B, n, rows, d) of the right environments; ValueError otherwise."""
    return check_numbers("observations", value, shape, "(B, n, rows, d)")


def check_numbers(name: str, value: Any, shape: tuple[int, ...], axes: str) -> NDArray[Any]:
    """Array of float32 or float64 of a shape with ``axes`` as names, in C order.

    Raises:
        ValueError: for another shape or type.
    """
    array = np.asarray(value, order="C")  # kernels read and write flat views
    check_shape(name, array, shape, axes=axes)
    if array.dtype not in _FLOATS:
        raise ValueError(f"{name} are {array.dtype}; they must be float32 or float64")
    return array


def check_actions(actions: ArrayLike, shape: tuple[int, ...], axes: str) -> NDArray[np.float32]:
    """Actions (B, n, ...) of a shape with ``axes`` as names, for kernels.

    Raises:
        ValueError: for a wrong shape, non-numeric input, or a number that is not finite in float32,
            with the robot.
    """
    plain = getattr(actions, "dtype", None) is not _FLOAT32
    given = floats("actions", actions, np.float32) if plain else actions
    table = np.ascontiguousarray(given)
    check_shape("actions", table, shape, axes=axes)
    wrong = first_not_finite(table.reshape(-1))
    if wrong >= 0:
        team, robot, *_ = np.unravel_index(wrong, shape)
        raise ValueError(
            f"action of robot_{robot} in environment {team} is "
            f"{short_repr(np.asarray(actions)[team, robot].tolist())}; it must be finite, in "
            "float32"
        )
    return table


def check_mask(mask: ArrayLike, num_envs: int) -> NDArray[np.bool_]:
    """Mask (B,) of bools; ValueError otherwise."""
    return bools("mask", mask, (num_envs,), "environments")
