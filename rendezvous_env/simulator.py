"""Simulator: many teams at once. Every environment of this project is one of these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compilation import compiled, entry_point
from .engine import threads
from .engine.lanes import FEW, LANES
from .engine.preparation import empty_teams, fixed_obstacles, physics, start_rules
from .engine.sharing import Part
from .engine.starts import StartRules, reset_teams
from .engine.step import first_not_finite, observe_blocks, step_blocks
from .engine.teams import (
    ACTIVE,
    BOOK,
    CONTACTS,
    FRESH,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    MIN_CLEARANCE,
    PATH_LENGTH,
    RENDEZVOUS,
    RUNNING,
    STATUS,
    STEPS,
    TIME_OUT,
    Results,
    Teams,
    from_book,
    from_lanes,
    to_book,
    to_lanes,
)
from .experiment.scenario import Scenario
from .experiment.start_options import StartOptions, parse_options
from .outcome import Outcome

_WORK_PER_THREAD = 4096
"""Robot pairs below which another thread costs more than it saves."""
_KEPT = {
    BOOK[entry]: (entry, kind)
    for entry, kind in (
        (STATUS, np.int64),
        (STEPS, np.int64),
        (CONTACTS, np.int64),
        (PATH_LENGTH, np.float64),
        (INITIAL_LYAPUNOV, np.float64),
        (MIN_CLEARANCE, np.float64),
    )
}
"""What of a team's book belongs to its state, and as what; the rest follows."""


class Simulator:
    """B teams of one scenario, advanced together.

    A batch of one and a batch of many give bit-equal trajectories for equal seeds, with any number
    of threads.

    Args:
        scenario: the experiment.
        num_envs: B, number of teams, at least 1.
        num_threads: most threads a step may use; None is one for each core.

    Raises:
        ValueError: if ``num_envs`` or ``num_threads`` is not a positive whole number.
    """

    def __init__(
        self, scenario: Scenario, num_envs: int = 1, *, num_threads: int | None = None
    ) -> None:
        for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
            if value is not None and (not isinstance(value, int | np.integer) or value < 1):
                raise ValueError(f"{name} is {value!r}; it must be a whole number, 1 or more")
        self.scenario = scenario
        self.num_envs = int(num_envs)
        self.num_threads = num_threads
        self.max_steps = scenario.max_steps
        self._teams = empty_teams(scenario, self.num_envs)
        self._seed = np.zeros(self.num_envs, dtype=np.uint64)
        self._episode = np.full(self.num_envs, -1)
        self._seeded = np.zeros(self.num_envs, dtype=np.bool_)
        self._ready = False
        self._prepare()

    def _prepare(self) -> None:
        """Make what follows from the scenario: constants and working memory."""
        scenario = self.scenario
        self._axes = tuple(range(scenario.dim))
        self._span = (0,) if self.num_envs <= FEW else ()
        self._acted = (self.num_envs, scenario.n_robots, scenario.action_size)
        self._observed = (self.num_envs, scenario.n_robots, *scenario.observation_layout.shape)
        self._width = _width(scenario, self.num_envs, self.num_threads)
        self._physics = physics(scenario, self.max_steps)
        self._run: Callable[..., Any] | None = None
        self._rules = start_rules(scenario)
        self._fixed_obstacles = fixed_obstacles(scenario)
        self._all_running = self._none_rests()
        self._themselves = np.tile(np.arange(scenario.n_robots), (self.num_envs, 1))

    # ---- episodes -----------------------------------------------------------------------------

    def reset(
        self,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
        *,
        mask: NDArray[np.bool_] | None = None,
        resting: bool = False,
    ) -> NDArray[np.float32]:
        """Begin a new episode in all teams, or in those of a mask.

        Args:
            seed: s gives team i the seed s + i, a list gives each team its own (None in it keeps
                that team's); None goes on to the next episode of every team's seed, or draws a seed
                if it has none yet.
            options: "positions" (n, d) m, "headings" (n,) rad or (n, 2) yaw and pitch, "frames"
                (n, d, d) rotations, "weights" (n, n) m/s, "obstacles"; each may carry a leading
                axis B.
            mask: (B,), which teams; None is all.
            resting: let these teams pass the next step without moving (for autoreset).

        Returns:
            Observations of all teams, (B, n, rows, d) float32.

        Raises:
            ValueError: for a bad option, seed or mask; nothing has changed then.
            RuntimeError: if no room was found for a start or an obstacle; nothing has changed then.
        """
        given = parse_options(self.scenario, self.num_envs, options)
        self._begin(self._which(mask), self._new_seeds(seed), given, resting)
        return self.observe()

    def restart(self, mask: NDArray[np.bool_], outcome: Outcome | None = None) -> None:
        """Send some teams on to the next episode of their seed, at little cost to the others.

        Args:
            mask: (B,), which teams.
            outcome: what the last step gave out; in place of these teams' last observation, contact
                and clearance it takes those of their start. If None, they pass the next step
                without moving and are observed there.

        Raises:
            ValueError: for a bad mask; nothing has changed then.
            RuntimeError: if no room was found for a start or an obstacle; nothing has changed then.
        """
        which = self._which(mask)
        self._begin(which, None, StartOptions(), resting=outcome is None)
        if outcome is not None:
            outcome.contact[which], outcome.active[which] = False, True
            outcome.status[which] = RUNNING
            self._observe_blocks(np.unique(which // LANES), outcome.results)

    def _begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None,
        given: StartOptions,
        resting: bool,
    ) -> None:
        before: _Before = []
        self._assign_seeds(which, seeds, before)
        rules = self._take_given(which, given, before)
        with _quiet_integers():
            status = FRESH if resting else RUNNING
            failed = reset_teams(which, status, rules, self._seed, self._episode, self._teams)
        if failed >= 0:
            for array, index, old in reversed(before):
                array[index] = old
            raise RuntimeError(
                f"no room for the start of team {failed}: {self.scenario.n_robots} robots, "
                f"neighbours at least 2 merge_radius = {2 * self.scenario.merge_radius} m apart "
                f"and clear of obstacles, in a spawn_size of {self.scenario.spawn_size} m; "
                "enlarge it or thin out the obstacles"
            )
        self._all_running = self._none_rests()
        self._ready = True

    def step(self, actions: ArrayLike) -> Outcome:
        """Advance every running team by one step τ with the inputs held.

        Args:
            actions: (B, n, a) in the robots' own frames, m/s and rad/s; what finished teams and
                merged-away robots are given is ignored.

        Returns:
            What the step gives out, in freshly allocated arrays.

        Raises:
            ValueError: for a wrong shape or a number that is not finite, naming the robot; nothing
                has changed then.
            RuntimeError: before the first reset.
        """
        if not self._ready:
            raise RuntimeError("call reset() before step()")
        table = np.ascontiguousarray(actions, dtype=np.float32)
        if table.shape != self._acted:
            raise ValueError(
                f"actions have shape {table.shape}; they must be (B, n, a) = {self._acted}"
            )
        wrong = first_not_finite(table.reshape(-1))
        if wrong >= 0:
            team, robot, _ = (int(k) for k in np.unravel_index(wrong, self._acted))
            raise ValueError(
                f"action of robot_{robot} in team {team} is {table[team, robot].tolist()}; "
                "it must be finite"
            )
        results = self._new_results()
        written = tuple(results)
        threads.share(
            lambda part: self._step_blocks(part, table, written),
            len(self._teams.positions),
            self._width,
        )
        self._all_running = not np.count_nonzero(results.status)  # RUNNING is 0
        return Outcome(results, self._observed)

    def _step_blocks(
        self, part: Part, table: NDArray[np.float32], results: tuple[Any, ...]
    ) -> bool:
        given = (part, self._physics, self._axes, self._span, tuple(self._teams))
        if self._run is None:
            self._run = entry_point(step_blocks, (*given, np.empty_like(table), results))
        return self._run(*given, table, results)

    def observe(self) -> NDArray[np.float32]:
        """Observations of all teams as they are, (B, n, rows, d) float32."""
        return self._observed_results().observations.reshape(self._observed)

    def _observed_results(self) -> Results:
        results = self._new_results()
        self._observe_blocks(np.arange(len(self._teams.positions)), results)
        return results

    def _observe_blocks(self, blocks: NDArray[np.int64], results: Results) -> None:
        observe_blocks(blocks, self._physics, self._axes, tuple(self._teams), tuple(results))

    def _new_results(self) -> Results:
        batch, n, rows, d = self._observed
        return Results(
            np.empty((batch, n * rows * d), np.float32),
            np.empty((5, batch)),
            np.empty((batch, n), np.bool_),
            np.empty((batch, n)),
            np.empty((batch, n), np.bool_),
            np.empty(batch, np.int64),
            np.empty((batch, n)),
        )

    # ---- state --------------------------------------------------------------------------------

    @property
    def positions(self) -> NDArray[np.float64]:
        """p_i, (B, n, d), m; a merged-away robot is where the robot is that it became part of."""
        places = from_lanes(self._teams.positions, self.num_envs)
        return np.take_along_axis(places, self._teams.merged_into[..., None], axis=1)

    @property
    def headings(self) -> NDArray[np.float64]:
        """Yaw, or yaw and pitch, (B, n, 1 or 2), rad; (B, n, 0) for single integrators."""
        return self._teams.angles.copy()

    @property
    def frames(self) -> NDArray[np.float64]:
        """R_i, local → global, (B, n, d, d)."""
        d = self.scenario.dim
        frames = from_lanes(self._teams.frames, self.num_envs)
        return frames.reshape(*frames.shape[:2], d, d).copy()

    @property
    def weights(self) -> NDArray[np.float64]:
        """a_ij, (B, n, n), m/s, as merging has left them."""
        n = self.scenario.n_robots
        pairs = from_lanes(self._teams.weights, self.num_envs)[..., 0]
        weights = np.zeros((self.num_envs, n, n))
        rows, columns = np.triu_indices(n, 1)
        weights[:, rows, columns] = weights[:, columns, rows] = pairs
        return weights

    @property
    def obstacles(self) -> NDArray[np.float64]:
        """Packed obstacles, (B, M, width), as obstacles.py says."""
        return self._teams.obstacles.copy()

    @property
    def merged_into(self) -> NDArray[np.int64]:
        """(B, n), index of the robot that each one is now part of; its own while it is active."""
        return self._teams.merged_into.copy()

    @property
    def active(self) -> NDArray[np.bool_]:
        """(B, n), whether the robot still exists on its own."""
        return self._teams.merged_into == self._themselves

    @property
    def status(self) -> NDArray[np.int64]:
        """(B,), RUNNING, RENDEZVOUS, TIME_OUT or FRESH of teams.py."""
        return self._entry(STATUS).astype(np.int64)

    @property
    def all_running(self) -> bool:
        """Whether every team is in the midst of an episode; quicker than ``ended``."""
        return self._all_running

    def _none_rests(self) -> bool:
        return bool((self._entry(STATUS) == RUNNING).all())

    @property
    def ended(self) -> NDArray[np.bool_]:
        """(B,), whether the episode is over."""
        status = self._entry(STATUS)
        return (status == RENDEZVOUS) | (status == TIME_OUT)

    @property
    def steps(self) -> NDArray[np.int64]:
        """(B,), steps done in this episode."""
        return self._entry(STEPS).astype(np.int64)

    @property
    def time(self) -> NDArray[np.float64]:
        """(B,), s since the start of the episode."""
        return self._entry(STEPS) * self.scenario.tau

    @property
    def seeds(self) -> NDArray[np.uint64]:
        """(B,), seed of each team."""
        return self._seed.copy()

    @property
    def initial_lyapunov(self) -> NDArray[np.float64]:
        """(B,), V at the start of the episode, m²/s."""
        return self._entry(INITIAL_LYAPUNOV)

    @property
    def path_length(self) -> NDArray[np.float64]:
        """(B,), way of all robots together in this episode, m."""
        return self._entry(PATH_LENGTH)

    @property
    def contacts(self) -> NDArray[np.int64]:
        """(B,), contacts in this episode, one for each robot and step."""
        return self._entry(CONTACTS).astype(np.int64)

    @property
    def min_clearance(self) -> NDArray[np.float64]:
        """(B,), least distance of a robot to an obstacle in this episode, m; inf without
        obstacles.
        """
        return self._entry(MIN_CLEARANCE)

    @property
    def clearance(self) -> NDArray[np.float64]:
        """(B, n), distance of each robot to the nearest obstacle now, m; inf without obstacles."""
        return self._observed_results().clearance

    def lyapunov(self) -> NDArray[np.float64]:
        """V, (B,), m²/s."""
        return self._entry(LYAPUNOV)

    def _entry(self, entry: int) -> NDArray[np.float64]:
        """One entry of every team's book, (B,), as a copy."""
        return from_book(self._teams.book, entry, self.num_envs)

    @property
    def nbytes(self) -> int:
        """Bytes of the state of all teams."""
        return sum(array.nbytes for array in (*self._teams, self._seed, self._episode))

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the teams depends on, as copies with leading axis B."""
        teams = self._teams
        state = {
            "positions": from_lanes(teams.positions, self.num_envs).copy(),
            "angles": teams.angles.copy(),
            "weights": from_lanes(teams.weights, self.num_envs).copy(),
            "obstacles": teams.obstacles.copy(),
            "merged_into": teams.merged_into.copy(),
            "seed": self._seed.copy(),
            "episode": self._episode.copy(),
        }
        if not self.scenario.model.nonholonomic:
            state["frames"] = from_lanes(teams.frames, self.num_envs).copy()
        kept = {name: self._entry(k).astype(kind) for name, (k, kind) in _KEPT.items()}
        return state | kept

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put a state back that ``get_state`` took out of a simulator of the same scenario and
        batch.

        Raises:
            ValueError: naming a missing or unknown entry, or one of another shape or type; nothing
                has changed then.
        """
        own = self.get_state()
        if wrong := sorted(set(own) ^ set(state)):
            raise ValueError(f"state: entry {wrong[0]!r} is missing or unknown")
        for name, array in own.items():
            value = np.asarray(state[name])
            if value.shape != array.shape or value.dtype != array.dtype:
                raise ValueError(
                    f"state: {name} is {value.dtype} of shape {value.shape}; "
                    f"it must be {array.dtype} of shape {array.shape}"
                )
        teams = self._teams
        for name in state:
            if name in _KEPT:
                to_book(state[name], _KEPT[name][0], teams.book)
            elif name in ("seed", "episode"):
                getattr(self, f"_{name}")[...] = state[name]
            elif name in ("positions", "weights", "frames"):
                to_lanes(state[name], getattr(teams, name))
            else:
                getattr(teams, name)[...] = state[name]
        to_book(self.active.sum(axis=1), ACTIVE, teams.book)
        self._seeded[:] = True
        self._all_running = self._none_rests()
        self._ready = True
        self.observe()

    def set_max_steps(self, max_steps: int) -> None:
        """Change the time limit to a number of steps.

        Raises:
            ValueError: if it is not a positive whole number.
        """
        if (
            not isinstance(max_steps, int | np.integer)
            or isinstance(max_steps, bool)
            or max_steps < 1
        ):
            raise ValueError(f"max_cycles is {max_steps!r}; it must be a whole number, 1 or more")
        self.max_steps = int(max_steps)
        self._physics = physics(self.scenario, self.max_steps)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and deepcopy keep the running episodes and leave the working memory behind."""
        return {
            "scenario": self.scenario,
            "num_envs": self.num_envs,
            "num_threads": self.num_threads,
            "max_steps": self.max_steps,
            "_teams": tuple(array.copy() for array in self._teams),
            "_seed": self._seed.copy(),
            "_episode": self._episode.copy(),
            "_seeded": self._seeded.copy(),
            "_ready": self._ready,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take up the episodes where they were."""
        self.__dict__.update(state)
        self._teams = Teams(*state["_teams"])
        self._prepare()

    # ---- parts of reset -----------------------------------------------------------------------

    def _which(self, mask: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        if mask is None:
            return np.arange(self.num_envs)
        array = np.asarray(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_:
            raise ValueError(
                f"mask is {array.dtype} of shape {array.shape}; it must be bool, one for each of "
                f"{self.num_envs} teams"
            )
        return np.flatnonzero(array)

    def _new_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None] | None:
        """A seed for each team, None where it keeps its own; None if all do."""
        listed: Sequence[Any]
        if seed is None:
            return None
        if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
            listed = [int(seed) + i for i in range(self.num_envs)]
        else:
            listed = list(seed) if isinstance(seed, Sequence | np.ndarray) else [seed]
        if len(listed) != self.num_envs:
            raise ValueError(
                f"seed has {len(listed)} entries; it must be one number, or {self.num_envs}"
            )
        for value in listed:
            if value is None:
                continue
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not whole or not 0 <= value < 2**63:
                raise ValueError(f"seed {value!r} must be a whole number, 0 or more")
        return [None if value is None else int(value) for value in listed]

    def _assign_seeds(
        self, which: NDArray[np.int64], seeds: list[int | None] | None, before: _Before
    ) -> None:
        """Seed teams anew, or send them on to the next episode of their seed."""
        _put(self._episode[which] + 1, self._episode, which, before)
        if seeds is not None:
            given = [team for team in which.tolist() if seeds[team] is not None]
            _put([seeds[team] for team in given], self._seed, given, before)
            _put(0, self._episode, given, before)
            _put(True, self._seeded, given, before)
        if not self._seeded[which].all():
            unseeded = which[~self._seeded[which]]
            entropy = np.random.SeedSequence().generate_state(len(unseeded), np.uint64)
            _put(entropy >> np.uint64(1), self._seed, unseeded, before)
            _put(True, self._seeded, unseeded, before)

    def _take_given(
        self, which: NDArray[np.int64], given: StartOptions, before: _Before
    ) -> StartRules:
        """Write the given parts of a start into the state; the rules say to draw the others."""
        scenario, teams = self.scenario, self._teams
        n, d = scenario.n_robots, scenario.dim
        starts, headings = scenario.start_positions, scenario.start_headings
        positions = given.positions if starts is None else _or(given.positions, [starts])
        angles = given.angles if headings is None else _or(given.angles, [headings])
        frames, weights, obstacles = given.frames, given.weights, given.obstacles
        if frames is None and scenario.local_frames == "global":
            frames = np.broadcast_to(np.eye(d), (1, n, d, d))
        if obstacles is None:
            obstacles = self._fixed_obstacles
        lanes = (which // LANES, slice(None), slice(None), which % LANES)
        if positions is not None:
            _put(_for_each(positions, which), _by_lane(teams.positions), lanes, before)
        if angles is not None:
            _put(_for_each(angles, which), teams.angles, which, before)
        if frames is not None and not scenario.model.nonholonomic:
            flat = frames.reshape(len(frames), n, d * d)
            _put(_for_each(flat, which), _by_lane(teams.frames), lanes, before)
        if weights is not None:
            rows, columns = np.triu_indices(n, 1)
            listed = weights[:, rows, columns, None]
            _put(_for_each(listed, which), _by_lane(teams.weights), lanes, before)
        if obstacles is not None and obstacles.size:
            _put(_for_each(obstacles, which), teams.obstacles, which, before)
        return self._rules._replace(
            draw_positions=positions is None,
            draw_angles=angles is None,
            draw_frames=frames is None,
            draw_weights=weights is None,
            draw_obstacles=obstacles is None,
        )


_Before = list[tuple[NDArray[Any], Any, Any]]
"""What was overwritten: arrays, indices and old values, in the order in which that happened."""


def _put(values: ArrayLike, array: NDArray[Any], index: Any, before: _Before) -> None:
    """Write into the state, and keep what was there."""
    before.append((array, index, array[index]))
    array[index] = values


def _or(value: NDArray[np.float64] | None, default: Any) -> NDArray[np.float64]:
    return np.array(default, dtype=np.float64) if value is None else value


def _for_each(values: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.float64]:
    """One entry for each of these teams, from one for all or one for every team of the batch."""
    return values if len(values) == 1 else values[which]


def _by_lane(blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """A view (blocks, m, c, LANES) of lane blocks."""
    return blocks.reshape(*blocks.shape[:2], -1, LANES)


def _width(scenario: Scenario, batch: int, num_threads: int | None) -> int:
    """As many threads as are worth their cost."""
    work = batch * scenario.n_robots * max(scenario.n_robots, scenario.observation_layout.rows)
    most = threads.available_cores() if num_threads is None else num_threads
    return max(1, min(most, work // _WORK_PER_THREAD, -(-batch // LANES)))


def _quiet_integers() -> Any:
    """Without compilation NumPy would warn of every product of 64-bit numbers that wraps around."""
    return nullcontext() if compiled() else np.errstate(over="ignore")
