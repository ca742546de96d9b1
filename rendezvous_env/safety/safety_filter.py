"""Base class of safety filters: held actions, observation frames, registration by name.

Filters use the robots' own observations only: no positions, no global frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..checks import bools, check_int, choice, floats, raise_invalid
from ..compilation import entry_point, kernel
from ..deprecation import warn_renamed
from ..engine import threads
from ..engine.state_checks import StatefulMixin, check_actions, check_observations, check_rotations
from ..engine.threads import Calls, Slice
from ..limits import MAX_TEAMS
from ..physics.vectors import dot, load
from ..scenario.scenario import Scenario
from .frames import FRAMES, look_along_net_bearing
from .robot_lanes import by_robot, end_of_run, room_for
from .turning import robot_of

Float32 = NDArray[np.float32]
_ROBOTS_PER_THREAD = 4096
_ROUNDING = 1e-6  # tolerance of rotations in a restored state
FILTERS: dict[str, type[SafetyFilter]] = {}
"""Registered filter classes by name."""


def over_teams(
    calls_of: Callable[[Slice], Calls], num_envs: int, n_robots: int, num_threads: int | None
) -> None:
    """Execute calls for a batch on up to ``num_threads`` threads; None is one per core."""
    most = num_envs * n_robots // _ROBOTS_PER_THREAD
    if most > 1:  # querying the number of cores is slow
        most = min(most, threads.max_threads(num_threads))
    threads.share(calls_of, num_envs, max(1, most))


NO_SUMS = np.zeros((3, 0))
"""Sums of rows that are not known."""
_entry_points: dict[tuple[Any, type, np.dtype[Any], int], Callable[..., Any]] = {}


def over_robots(
    kernel: Any,
    part: Slice,
    constants: Any,
    *arrays: NDArray[Any],
    sums: NDArray[np.float64] = NO_SUMS,
    work: Any = None,
) -> Calls:
    """Call of a kernel for the robots of a slice.

    Its arguments are axes, (0, 1) or (0, 1, 2), the range of robots, constants, flat views of
    ``arrays`` (B, n, ...) of any unit, observations first, and working memory, by default for
    ``lanes_of`` and rows, with ``sums`` of rows.
    """
    rows, d = arrays[0].shape[2:]
    robots, flat = by_robot(part, arrays)
    work = (*room_for(rows, d), sums) if work is None else work
    arguments = (0, 1, 2)[:d], robots, constants, flat, work
    kind = kernel, type(constants), arrays[0].dtype, d  # all other types follow from these
    if (run := _entry_points.get(kind)) is None:
        run = _entry_points[kind] = entry_point(kernel, arguments)
    return [partial(run, *arguments)]


@kernel
def _hold(given, frames, held):
    """Store vectors (B, n, d), rotated by frames: h = F q."""
    if frames.shape[3] == 2:
        numbers, kept, turning = given.reshape(-1), held.reshape(-1), frames.reshape(-1)
        for i in range(len(kept) // 2):  # with slices it would not become SIMD
            q = numbers[2 * i], numbers[2 * i + 1]
            kept[2 * i] = dot((turning[4 * i], turning[4 * i + 1]), q)
            kept[2 * i + 1] = dot((turning[4 * i + 2], turning[4 * i + 3]), q)
    else:
        chosen, into, turn = given.reshape(-1, 3), held.reshape(-1, 3), frames.reshape(-1, 3, 3)
        for i in range(len(into)):
            for k in range(3):
                into[i, k] = dot(load(turn[i, k]), load(chosen[i]))


@kernel
def _look_of_some(axes, robots, robot, arrays, work):
    """``look_along_net_bearing`` of holonomic robots; others observe their rows unchanged."""
    observations, frames, seen, turning = arrays
    first = robots[0]
    while first < robots[1]:
        stop = end_of_run(turning, first, robots[1])
        if turning[first]:
            for i in range(first, stop):
                for row in range(observations.shape[1]):
                    for k in range(len(axes)):
                        seen[i, row, k] = observations[i, row, k]
        else:
            given = observations, frames, seen
            look_along_net_bearing(axes, (first, stop), robot, given, work)
        first = stop


@kernel
def _look_of_teams(axes, robots, constants, arrays, work):
    """``look_along_net_bearing`` of the robots of some environments, by number."""
    robot, n, teams = constants
    for team in teams:
        look_along_net_bearing(axes, (team * n, (team + 1) * n), robot, arrays, work)


def check_inputs(scenario: Scenario, theorem: str, *, bodies: bool = False) -> None:
    """Raise a ValueError unless the action is the velocity, as a theorem requires.

    With ``bodies``, a speed and turn rates are accepted as well.
    """
    refused = [
        model
        for model in scenario.models
        if not (model.bounded or (bodies and model.theorem is not None))
    ]
    if not refused:
        return
    model = refused[0]
    needed = "their velocity, as robot_model 'single_integrator'"
    if bodies:
        needed = (
            "a velocity, or a speed and turn rates, as robot_model 'single_integrator', 'unicycle' "
            "and 'nonholonomic_3d'"
        )
    among = f" (robot {scenario.robot_model.index(model.name)})" if scenario.mixes_models else ""
    raise ValueError(
        f"scenario has {model.name} robots{among}, whose action is {model.action}; {theorem} needs "
        f"robots whose action is {needed}"
    )


_RENAMED = {
    "act": "compute",
    "act_of": "apply_calls",
    "book": "update",
    "book_of": "update_calls",
    "keeps_ledger": "uses_feedback",
    "leads": "supports_multi_step",
    "of_actions": "action_diagnostics",
    "told": "diagnostics",
    "view": "observe",
    "view_of": "observe_calls",
}
"""Deprecated names of attributes of filters → their new names."""


def check_sees_all_neighbours(scenario: Scenario) -> None:
    """Reject a scenario that may omit neighbour rows, since f is then not their sum."""
    if scenario.drops_neighbours:
        most = scenario.sensing_graph.most_neighbours(scenario.n_robots)
        raise ValueError(
            f"scenario has neighbour_slots {scenario.neighbour_slots} with neighbour_overflow "
            f"'nearest'; no filter has a guarantee if neighbours are omitted: give it "
            f"neighbour_slots={most} or more"
        )


class SafetyFilter(StatefulMixin):
    """Base class of safety filters: actions with a guarantee from the choices of any policy.

        actions = safety_filter.apply(safety_filter.observe(observations), choices)
        ... step the environments ...
        safety_filter.update(contact, merged_into)         # if safety_filter.uses_feedback

    Choices are held until the next ones; ``apply`` without choices uses them again. A subclass
    overrides ``compute``, in NumPy, or ``apply_calls``, compiled, and extends ``_memory`` and
    ``diagnostics``. Its constructor takes ``(scenario, num_envs, *, num_threads=None, …)`` and
    settings by name. A ValueError names an invalid setting. ``register_filter`` registers the class
    by name.

    ``observe_calls``, ``apply_calls`` and ``update_calls`` return the same work for the
    environments of one slice, without validation, as calls of compiled code for threads.

    Args:
        scenario: the scenario of the environments.
        num_envs: B.
        action_size: k, size of a robot's choice.
        frame: "net_bearing" (x along f; single integrators only, nonholonomic robots keep the body
            frame) or "local".
        num_threads: maximum number of threads; None is one per core.
    """

    chooses_vectors = True  # whether a choice is a vector, which rotates with the observation frame
    lowest_choice = -1.0  # lower bound of each number of a choice; the upper bound is 1
    uses_feedback = False  # whether ``update`` has to be called after every step
    reuses_calls = False  # whether calls can be made again in further steps, with the same arrays
    state_key = "filter"  # key of its memory in a wrapper's state
    observes_level = False  # whether ``observe`` adds a row with the robot's stored energy
    _sums = NO_SUMS  # f_x, f_y, and D if wanted, m/s, of the robots in the last observations
    _summed: Float32 | None = None  # the array of these observations
    _recalled: Float32 | None = None  # the same, if ``apply_calls`` may use ``_sums``

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        action_size: int,
        frame: str,
        num_threads: int | None,
    ) -> None:
        choice("frame", frame, FRAMES)
        check_sees_all_neighbours(scenario)
        if num_threads is not None:
            num_threads = check_int("num_threads", num_threads, 1, MAX_TEAMS)
        n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
        self.scenario, self.action_size = scenario, action_size
        turning = scenario.nonholonomic_robots
        self.turns_body, self.mixes_models = bool(turning.any()), bool(len({*turning.tolist()}) > 1)
        self.along_net_bearing = frame == "net_bearing" and not turning.all()
        self._turning = np.tile(turning, (num_envs, 1))
        self._robot = robot_of(scenario)
        self._batch = num_envs, n, num_threads
        self._seen = (num_envs, n, *layout.shape)
        self._acted = (num_envs, n, scenario.action_size)
        self._frames = np.tile(np.eye(d), (num_envs, n, 1, 1))
        self._held = np.zeros((num_envs, n, action_size))
        self.alignment = np.full((num_envs, n), np.nan)
        self.lyapunov_rate = np.zeros((num_envs, n))

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Accept former names of overridden attributes in subclasses."""
        super().__init_subclass__(**kwargs)
        if {"apply_calls", "update_calls"} & vars(cls).keys() and "reuses_calls" not in vars(cls):
            cls.reuses_calls = False
        for old in _RENAMED.keys() & vars(cls).keys():
            warn_renamed(f"{cls.__name__}.{old}", _RENAMED[old])
            setattr(cls, _RENAMED[old], vars(cls)[old])

    @property
    def diagnostics(self) -> dict[str, NDArray[Any]]:
        """Values of the last step for the infos, by key, (B, n) each; not copied."""
        return {"alignment": self.alignment, "lyapunov_rate": self.lyapunov_rate}

    @property
    def action_diagnostics(self) -> list[NDArray[Any]]:
        """Diagnostics of actions: all that are not in the memory."""
        remembered = list(map(id, self._memory.values()))
        return [values for values in self.diagnostics.values() if id(values) not in remembered]

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        """Memory by name; not copied."""
        return {"frames": self._frames, "held": self._held}

    def _begin(self, which: Any) -> None:
        super()._begin(which)
        self._summed = self._recalled = None
        self._frames[which] = np.eye(self.scenario.dim)
        self.alignment[which], self.lyapunov_rate[which] = np.nan, 0.0

    def observe(self, observations: Float32) -> Float32:
        """Observations of the policy, with x along f for that frame; updates the frames.

        Raises:
            ValueError: for another shape or type than (B, n, rows, d).
        """
        observations = check_observations(observations, self._seen)
        if (shown := self.new_view(observations.dtype)) is None:
            return observations
        over_teams(lambda part: self.observe_calls(part, observations, shown), *self._batch)
        return shown

    @property
    def changes_rows(self) -> bool:
        """True if the policy's observations differ from those of the environments."""
        return self.along_net_bearing or self.observes_level

    def new_view(self, dtype: DTypeLike = np.float32) -> Float32 | None:
        """Buffer for ``observe_calls``; None if observations are passed unchanged."""
        if not self.changes_rows:
            return None
        num_envs, n, rows, d = self._seen
        return np.empty((num_envs, n, rows + self.observes_level, d), dtype)

    def observe_calls(self, part: Slice, observations: Float32, shown: Float32) -> Calls:
        """As ``observe``, into memory of ``new_view``, for a slice."""
        mine = slice(*part[:2])
        if self.along_net_bearing:
            calls = self._look_calls(part, observations, shown)
        else:
            rows = shown[mine, :, : self._seen[2]]
            calls = [partial(np.copyto, rows, observations[mine])]
        return [*calls, *self._level_calls(mine, shown)]

    def observe_again(
        self, which: NDArray[np.bool_], observations: Float32, shown: Float32
    ) -> None:
        """As ``observe_calls``, where observations have changed: environments of a mask, (B,)."""
        plain = type(self).observe_calls is SafetyFilter.observe_calls
        if plain and self.along_net_bearing and not self.mixes_models:
            teams = np.flatnonzero(which)
            calls = self._look_calls((0, len(which), 0), observations, shown, teams)
            calls = [*calls, *self._level_calls(teams, shown)]
        else:
            calls = self.observe_calls((0, len(which), 0), observations, shown)
        for one in calls:
            one()

    def _look_calls(
        self, part: Slice, observations: Float32, shown: Float32, teams: Any = None
    ) -> Calls:
        """Call that updates frames and rotates rows of a slice, or of some environments in it."""
        arrays = observations, self._frames, shown
        self._summed = observations if observations.dtype == np.float32 else None
        sums = NO_SUMS if self._summed is None else self._sums
        if teams is not None:
            constants = self._robot, shown.shape[1], teams
            return over_robots(_look_of_teams, part, constants, *arrays, sums=sums)
        if self.mixes_models:
            mixed = _look_of_some, part, self._robot, *arrays, self._turning
            return over_robots(*mixed, sums=sums)
        return over_robots(look_along_net_bearing, part, self._robot, *arrays, sums=sums)

    def _level_calls(self, teams: Any, shown: Float32) -> Calls:
        """Calls that add the row of stored energy, for a slice or indices of environments."""
        return ()

    def _make_sums(self, *, weighs: bool) -> None:
        """Allocate ``_sums`` for ``apply_calls`` that sum rows, with D if they ``weigh`` them."""
        if self.scenario.dim == 2 and self.along_net_bearing:
            self._sums = np.zeros((3 if weighs else 2, math.prod(self._batch[:2])))

    def recall_sums(self, observations: Float32) -> None:
        """Let the next ``apply_calls`` use the sums of rows of the last ``observe_calls``.

        The array must not change until then.
        """
        self._recalled = observations if observations is self._summed else None

    def recalls(self, observations: Float32) -> bool:
        """True if the sums of these observations' rows are known."""
        return observations is self._recalled

    def _sums_of(self, observations: Float32) -> NDArray[np.float64]:
        """Sums of the observations' rows; empty if they are not known."""
        return self._sums if self.recalls(observations) else NO_SUMS

    @cached_property
    def choice_mask(self) -> NDArray[np.bool_]:
        """True for the numbers of a choice that a robot has, (n, k); the others have no effect.

        In mixed teams choices are padded to the widest. A robot has the first numbers.
        """
        return np.ones((self.scenario.n_robots, self.action_size), np.bool_)

    @property
    def held(self) -> NDArray[np.float64]:
        """Current choices, (B, n, k), vectors in the robots' frames; not copied."""
        return self._held

    def hold(self, raw: ArrayLike) -> None:
        """Set new choices (B, n, k), fixed in the robots' local frames.

        Raises:
            ValueError: for a wrong shape, or naming the robot whose choice is not finite.
        """
        given = check_actions(raw, self._held.shape, "(B, n, k)")
        if given is not raw:  # may be float64
            given = np.ascontiguousarray(floats("actions", raw))
        if self.along_net_bearing and self.chooses_vectors:
            _hold(given, self._frames, self._held)
        else:
            self._held[...] = given

    def __getstate__(self) -> dict[str, Any]:
        """State for pickle and deepcopy, without known sums."""
        return vars(self) | {"_summed": None, "_recalled": None}

    def apply(
        self,
        observations: Float32,
        choices: ArrayLike | None = None,
        *,
        elapsed: float | None = None,
    ) -> Float32:
        """Actions for the base environment; updates the ``diagnostics``.

        Args:
            observations: (B, n, rows, d), in the robots' own frames.
            choices: (B, n, k), as ``hold`` takes them; None keeps those that are held.
            elapsed: time since the last actions, s, in which a heading may turn; None is τ.

        Returns:
            Actions (B, n, a), float32; zero for robots without visible neighbours.
        """
        if choices is not None:
            self.hold(choices)
        if elapsed is None:
            return self.compute(observations)
        return self.compute(observations, elapsed)

    def compute(self, observations: Float32, elapsed: float | None = None) -> Float32:
        """Actions (B, n, a) under the choices ``held``; called by ``apply``, to be overridden."""
        self._recalled = None  # a caller may have changed the array
        seen = check_observations(observations, self._seen)
        observations = np.ascontiguousarray(seen, np.float32)
        actions = np.zeros(self._acted, dtype=np.float32)
        over_teams(
            lambda part: self.apply_calls(part, observations, actions, elapsed), *self._batch
        )
        return actions

    def apply_calls(
        self, part: Slice, observations: Float32, actions: Float32, elapsed: float | None = None
    ) -> Calls:
        """As ``compute``, into ``actions``, for a slice."""
        raise NotImplementedError(f"{type(self).__name__} needs compute(observations) → actions")

    def update(
        self,
        contact: ArrayLike | None = None,
        merged_into: ArrayLike | None = None,
        resting: ArrayLike | None = None,
    ) -> None:
        """Update the memory with the outcome of the last actions; see ``uses_feedback``.

        A ValueError for an impossible outcome leaves the memory unchanged.

        Args:
            contact: (B, n) bool, whether the robot was in contact with an obstacle; None is False.
            merged_into: (B, n) int, the robot that each one has merged into; None is itself.
            resting: (B,) bool, environments that did not step; None is False.
        """
        team = self._held.shape[:2]
        contact = np.zeros(team, np.bool_) if contact is None else contact
        resting = np.zeros(team[0], np.bool_) if resting is None else resting
        touched = np.ascontiguousarray(bools("contact", contact, team, "robots"))
        passed = np.ascontiguousarray(bools("resting", resting, team[:1], "environments"))
        alone = np.tile(np.arange(team[1]), (team[0], 1))
        robots = np.asarray(alone if merged_into is None else merged_into)
        if robots.shape != team or robots.dtype.kind not in "iu":
            raise_invalid("merged_into", merged_into, f"integers of shape (B, n) = {team}")
        if robots.min() < 0 or robots.max() >= team[1]:
            raise_invalid("merged_into", merged_into, f"indices of robots, from 0 to {team[1] - 1}")
        merged = np.ascontiguousarray(robots, np.int64)
        for one in self.update_calls((0, *team), touched, merged, passed):
            one()

    def update_calls(self, part: Slice, contact: Any, merged_into: Any, resting: Any) -> Calls:
        """As ``update``, unchecked, for a slice."""
        return ()

    @cached_property
    def supports_multi_step(self) -> bool:
        """True if ``Simulator.step_n`` can use this filter.

        ``apply``, ``compute``, ``observe`` and ``update`` are then those of this class, and threads
        make many steps without synchronisation.
        """
        own, names = type(self), ("apply", "compute", "observe", "update")
        return all(getattr(own, name) is getattr(SafetyFilter, name) for name in names)

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """As ``StatefulMixin.set_state``."""
        super().set_state(state)
        self._summed = self._recalled = None

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """As ``StatefulMixin.check_state``; frames must be rotations."""
        checked = super().check_state(state)
        check_rotations(checked, np.ones(len(self._held), np.bool_), _ROUNDING)
        return checked


def _alias(old: str, new: str) -> property:
    """Alias of a renamed attribute under its former name, also for ``super()``."""

    def read(self: SafetyFilter) -> Any:
        warn_renamed(f"SafetyFilter.{old}", "apply" if old == "act" else new)
        kinds = [kind for kind in type(self).__mro__ if old in vars(kind)]
        return getattr(super(kinds[-2], self) if len(kinds) > 1 else self, new)

    return property(read, doc=f"Deprecated: ``{new}``.")


for _old, _new in _RENAMED.items():
    setattr(SafetyFilter, _old, _alias(_old, _new))


def register_filter(name: str, safety_filter: type[SafetyFilter]) -> None:
    """Register a filter by name for ``GuaranteeWrapper`` and ``training_env(guarantee=name)``.

    Raises:
        ValueError: for an invalid or used name, or a class that is not a filter.
    """
    if not (isinstance(name, str) and name.isidentifier()):
        raise_invalid("name", name, "a word")
    if not (isinstance(safety_filter, type) and issubclass(safety_filter, SafetyFilter)):
        raise_invalid("safety_filter", safety_filter, "a subclass of SafetyFilter")
    taken, names = FILTERS.get(name, safety_filter), ("__module__", "__qualname__")
    if any(getattr(taken, one) != getattr(safety_filter, one) for one in names):
        raise_invalid("name", name, f"none of {', '.join(FILTERS)}, which are taken")
    FILTERS[name] = safety_filter
