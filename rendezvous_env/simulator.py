"""Simulator: many teams at once. Every environment of this project is one of these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compilation import compiled, entry_point
from .engine import threads
from .engine.footprint import check_memory
from .engine.memory import (
    AWAITING_RESET,
    CONTACTS,
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
)
from .engine.preparation import (
    Arrangement,
    constants,
    drafts,
    fixed_links,
    fixed_obstacles,
    hands_of_threads,
    lanes_of_threads,
    layout,
    robot,
    start_rules,
    whole_rows,
)
from .engine.sharing import example_part
from .engine.starts import TOO_MANY_LINKS, StartRules, reset_teams
from .engine.state import Overwritten, State, overwrite, undo
from .engine.state_checks import check_entries, check_results, check_teams
from .engine.step import first_not_finite, step_blocks
from .engine.worlds import empty_worlds
from .equations.size import size
from .experiment.checks import bools, floats, refuse, shown, whole
from .experiment.limits import MOST_STEPS, MOST_TEAMS
from .experiment.scenario import Scenario
from .experiment.seeding import seeds_of_teams
from .experiment.start_options import StartOptions, parse_options
from .outcome import Outcome

_FLOAT32 = np.dtype(np.float32)
_WORK_PER_THREAD = 4096
"""Robot pairs below which another thread costs more than it saves."""


class Simulator:
    """B teams of one scenario, advanced together.

    A batch of one and a batch of many give bit-equal trajectories for equal seeds, with any number
    of threads.

    Args:
        scenario: the experiment.
        num_envs: B, number of teams, at least 1.
        num_threads: most threads a step may use; None is one for each core.

    Raises:
        ValueError: if ``num_envs`` or ``num_threads`` is not a positive whole number, or memory
            does not hold so many teams.
    """

    def __init__(
        self, scenario: Scenario, num_envs: int = 1, *, num_threads: int | None = None
    ) -> None:
        if not isinstance(scenario, Scenario):
            refuse("scenario", scenario, "a Scenario; scenarios.resolve() takes names and files")
        self.scenario = scenario
        self.num_envs = whole("num_envs", num_envs, 1, MOST_TEAMS)
        self.num_threads = num_threads
        if num_threads is not None:
            self.num_threads = whole("num_threads", num_threads, 1, MOST_TEAMS)
        check_memory(scenario, self.num_envs)
        self.max_steps = scenario.max_steps
        self._state = State(scenario, self.num_envs)
        self._seed = np.zeros(self.num_envs, dtype=np.uint64)
        self._episode = np.full(self.num_envs, -1)
        self._seeded = np.zeros(self.num_envs, dtype=np.bool_)
        self._ready = False
        self._prepare()

    def _prepare(self) -> None:
        """Make what follows from the scenario: constants and working memory."""
        scenario = self.scenario
        self._acted = (self.num_envs, scenario.n_robots, scenario.action_size)
        self._observed = (self.num_envs, scenario.n_robots, *scenario.observation_layout.shape)
        self._width = _width(scenario, self.num_envs, self.num_threads)
        self._layout, self._robot = layout(scenario, self.num_envs), robot(scenario)
        self._constants = constants(scenario, self.max_steps)
        self._lanes = tuple(lanes_of_threads(scenario, self.num_envs, self._width))
        self._hands = tuple(hands_of_threads(scenario, self.num_envs, self._width))
        self._blocks = np.arange(self._state.blocks)
        self._no_actions = np.zeros(self._acted, np.float32)
        self._run: Callable[..., Any] | None = None
        self._rules = start_rules(scenario)
        self._fixed_links = fixed_links(scenario)
        self._fixed_obstacles = fixed_obstacles(scenario)
        self._all_running = self._none_rests()
        self._given_out = tuple((array.shape, array.dtype) for array in self._new_results())
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
                Or if the graph drawn gives a robot more neighbours than the observation has rows.
        """
        given = parse_options(self.scenario, self.num_envs, options)
        self._check_room_for_links(given)
        self._begin(self._which(mask), seeds_of_teams(seed, self.num_envs), given, resting)
        return self.observe()

    def restart(self, mask: NDArray[np.bool_], outcome: Outcome | None = None) -> None:
        """Send some teams on to the next episode of their seed, at little cost to the others.

        Args:
            mask: (B,), which teams.
            outcome: what the last step gave out; in place of these teams' last observation, contact
                and clearance it takes those of their start. If None, they pass the next step
                without moving and are observed there.

        Raises:
            ValueError: for a bad mask, or an outcome of other teams; nothing has changed then.
            RuntimeError: if no room was found for a start or an obstacle; nothing has changed then.
                Or if the graph drawn gives a robot more neighbours than the observation has rows.
        """
        which = self._which(mask)
        if outcome is not None:
            check_results(outcome.results, self._given_out)
        self._begin(which, None, StartOptions(), resting=outcome is None)
        if outcome is not None:
            results = outcome.results
            results.contact[which], results.active[which] = False, True
            results.status[which] = RUNNING
            self._observe_blocks(np.unique(which // self._state.lanes), results)
            self._refuse_crowds(results)

    def _begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None,
        given: StartOptions,
        resting: bool,
    ) -> None:
        log: list[Overwritten] = []
        self._assign_seeds(which, seeds, log)
        rules = self._take_given(which, given, log)
        state = self._state
        with _quiet_integers():
            failed, why = reset_teams(
                which,
                AWAITING_RESET if resting else RUNNING,
                rules,
                self._seed,
                self._episode,
                self._layout,
                self._robot,
                tuple(state.teams),
                state.links,
                state.obstacles,
                tuple(array[0] for array in self._hands),
                tuple(drafts(self.scenario, self.num_envs, len(which))),
                empty_worlds(state.obstacles, len(which)),
            )
        if failed >= 0:
            undo(log)
            raise RuntimeError(self._no_room(failed, why))
        self._all_running = self._none_rests()
        self._ready = True

    def _no_room(self, team: int, why: int) -> str:
        scenario = self.scenario
        if why == TOO_MANY_LINKS:
            return (
                f"the graph drawn for team {team} has more links than expected; choose another seed"
            )
        return (
            f"no room for the start of team {team}: {scenario.n_robots} robots, "
            f"neighbours at least 2 merge_radius = {2 * scenario.merge_radius} m apart "
            f"and clear of obstacles, in a spawn_size of {scenario.spawn_size} m; "
            "enlarge it or thin out the obstacles"
        )

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
        table = self.check_actions(actions)
        results = self._new_results()
        self._all_running = False  # not known, should an interrupt leave from here
        self._share(True, self._blocks, table, results, self._width)
        self._all_running = not np.count_nonzero(results.status)  # RUNNING is 0
        self._refuse_crowds(results)
        return Outcome(results, self._observed)

    def check_actions(self, actions: ArrayLike) -> NDArray[np.float32]:
        """Actions as an array that ``step`` takes as it is.

        Args:
            actions: see ``step``.

        Raises:
            ValueError: for a wrong shape, what is no number, or a number that is not finite, naming
                the robot.
        """
        given = (
            actions
            if getattr(actions, "dtype", None) is _FLOAT32
            else floats("actions", actions, np.float32)
        )
        table = np.ascontiguousarray(given)
        if table.shape != self._acted:
            raise ValueError(
                f"actions have shape {table.shape}; they must be (B, n, a) = {self._acted}"
            )
        wrong = first_not_finite(table.reshape(-1))
        if wrong >= 0:
            team, robot, _ = (int(k) for k in np.unravel_index(wrong, self._acted))
            raise ValueError(
                f"action of robot_{robot} in team {team} is "
                f"{shown(np.asarray(actions)[team, robot].tolist())}; it must be finite, in float32"
            )
        return table

    def _share(
        self,
        moves: bool,
        blocks: NDArray[np.int64],
        table: NDArray[np.float32],
        results: Results,
        width: int,
    ) -> None:
        """Let up to ``width`` threads step or observe some blocks."""
        state, written = self._state, tuple(results)
        table = table.reshape(self.num_envs, -1)
        fixed = (moves, blocks, self._layout, self._constants, self._robot, tuple(state.teams))
        given = (state.links, state.obstacles, table, written, self._lanes, self._hands)
        if (run := self._run) is None:  # before threads share it: compiling may be interrupted
            writable = (*given[:2], np.empty_like(table), *given[3:])
            run = self._run = entry_point(step_blocks, (example_part(), *fixed, *writable))
        threads.share(lambda part: run(part, *fixed, *given), len(blocks), width)

    def _refuse_crowds(self, results: Results) -> None:
        """Name a robot that has come to have more neighbours than the observation has rows."""
        slots = self.scenario.observation_layout.neighbour_slots
        if slots == self.scenario.n_robots - 1 or not (results.crowded >= 0).any():
            return
        team = int(np.argmax(results.crowded >= 0))
        raise RuntimeError(
            f"robot_{results.crowded[team]} of team {team} has more than neighbour_slots = {slots} "
            f"neighbours after step {self.steps[team]}; give the scenario more neighbour_slots"
        )

    def observe(self) -> NDArray[np.float32]:
        """Observations of all teams as they are, (B, n, rows, d) float32.

        Raises:
            RuntimeError: if a robot has more neighbours than the observation has rows.
        """
        results = self._observed_results()
        self._refuse_crowds(results)
        return results.observations.reshape(self._observed)

    def _observed_results(self) -> Results:
        results = self._new_results()
        self._observe_blocks(self._blocks, results)
        return results

    def _observe_blocks(self, blocks: NDArray[np.int64], results: Results) -> None:
        self._share(False, blocks, self._no_actions, results, 1)

    def _new_results(self) -> Results:
        batch, n, rows, d = self._observed
        observations = np.empty((batch, n * rows * d), np.float32)
        return Results(
            observations,
            whole_rows(observations, d),
            np.empty((5, batch)),
            np.empty((batch, n), np.bool_),
            np.empty((batch, n)),
            np.empty((batch, n), np.bool_),
            np.empty(batch, np.int64),
            np.empty((batch, n)),
            np.empty(batch, np.int64),
        )

    # ---- state --------------------------------------------------------------------------------

    @property
    def positions(self) -> NDArray[np.float64]:
        """p_i, (B, n, d), m; a merged-away robot is where the robot is that it became part of."""
        places, into = self._state.positions(), self._state.teams.merged_into
        return np.take_along_axis(places, into[..., None], axis=1)

    @property
    def headings(self) -> NDArray[np.float64]:
        """Yaw, or yaw and pitch, (B, n, 1 or 2), rad; (B, n, 0) for robots without a heading."""
        return self._state.memory()[..., : self.scenario.model.n_angles].copy()

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities in the global frame, (B, n, d), m/s, of robots with inertia; (B, n, 0) for
        models that keep none.
        """
        model = self.scenario.model
        kept = self._state.memory()
        return kept[..., model.n_angles if model.keeps_velocity else kept.shape[-1] :].copy()

    @property
    def frames(self) -> NDArray[np.float64]:
        """R_i, local → global, (B, n, d, d)."""
        d, frames = self.scenario.dim, self._state.frames()
        return frames.reshape(*frames.shape[:2], d, d).copy()

    @property
    def weights(self) -> NDArray[np.float64]:
        """a_ij, (B, n, n), m/s, as merging has left them."""
        return self._state.weights()

    @property
    def obstacles(self) -> NDArray[np.float64]:
        """Obstacles as tables, (B, M, width), see ``experiment.packing``."""
        return self._state.obstacle_table()

    @property
    def merged_into(self) -> NDArray[np.int64]:
        """(B, n), index of the robot that each one is now part of; its own while it is active."""
        return self._state.teams.merged_into.copy()

    @property
    def active(self) -> NDArray[np.bool_]:
        """(B, n), whether the robot still exists on its own."""
        return self._state.teams.merged_into == self._themselves

    @property
    def status(self) -> NDArray[np.int64]:
        """(B,), RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET of engine.memory."""
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

    def size(self) -> NDArray[np.float64]:
        """L, (B,), m, of the robots that are left: hull perimeter, in 3-D 2π × mean width."""
        teams = zip(self._state.positions(), self.active, strict=True)
        return np.array([size(places[active]) for places, active in teams])

    def _entry(self, entry: int) -> NDArray[np.float64]:
        """One entry of every team's statistics, (B,), as a copy."""
        return self._state.statistic(entry)

    @property
    def nbytes(self) -> int:
        """Bytes of the state of all teams."""
        return self._state.nbytes + self._seed.nbytes + self._episode.nbytes

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the teams depends on, as copies with leading axis B."""
        drawn = {"seed": self._seed.copy(), "episode": self._episode.copy()}
        return self._state.as_dict() | drawn

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put a state back that ``get_state`` took out of a simulator of the same scenario and
        batch.

        Raises:
            ValueError: naming an entry and what would be right, see ``check_state``; nothing has
                changed then.
        """
        self._put_state(self.check_state(state))

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """The arrays of a state that ``set_state`` would put back.

        Raises:
            ValueError: naming an entry that is missing, unknown, of another shape or type, or that
                no episode can have, its value and what would be right.
        """
        entries = check_entries(self.get_state(), state, exactly=True)
        check_teams(self.scenario, entries)
        return entries

    def _put_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        entries = dict(state)
        self._seed[...], self._episode[...] = entries.pop("seed"), entries.pop("episode")
        self._state.put(entries)
        self._seeded[:] = self._episode >= 0
        self._all_running = self._none_rests()
        self._ready = bool(self._seeded.any())
        self.observe()

    def set_max_steps(self, max_steps: int) -> None:
        """Change the time limit to a number of steps.

        Raises:
            ValueError: if it is not a positive whole number.
        """
        self.max_steps = whole("max_cycles", max_steps, 1, MOST_STEPS)
        self._constants = constants(self.scenario, self.max_steps)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and deepcopy keep the running episodes and leave the working memory behind."""
        return {
            "scenario": self.scenario,
            "num_envs": self.num_envs,
            "num_threads": self.num_threads,
            "max_steps": self.max_steps,
            "_state": self._state.as_dict(),
            "_seed": self._seed.copy(),
            "_episode": self._episode.copy(),
            "_seeded": self._seeded.copy(),
            "_ready": self._ready,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take up the episodes where they were."""
        kept = state.pop("_state")
        self.__dict__.update(state)
        self._state = State(self.scenario, self.num_envs)
        self._state.put(kept)
        self._prepare()
        if self._ready:
            self.observe()

    # ---- parts of reset -----------------------------------------------------------------------

    def _which(self, mask: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        if mask is None:
            return np.arange(self.num_envs)
        return np.flatnonzero(bools("mask", mask, (self.num_envs,), "teams"))

    def _assign_seeds(
        self, which: NDArray[np.int64], seeds: list[int | None] | None, log: list[Overwritten]
    ) -> None:
        """Seed teams anew, or send them on to the next episode of their seed."""
        overwrite(self._episode, which, self._episode[which] + 1, log)
        if seeds is not None:
            given = [team for team in which.tolist() if seeds[team] is not None]
            overwrite(self._seed, given, [seeds[team] for team in given], log)
            overwrite(self._episode, given, 0, log)
            overwrite(self._seeded, given, True, log)
        if not self._seeded[which].all():
            unseeded = which[~self._seeded[which]]
            entropy = np.random.SeedSequence().generate_state(len(unseeded), np.uint64)
            overwrite(self._seed, unseeded, entropy >> np.uint64(1), log)
            overwrite(self._seeded, unseeded, True, log)

    def _check_room_for_links(self, given: StartOptions) -> None:
        """Refuse given weights with more links than a team of this graph can keep."""
        room = self._state.room_for_links
        for weights in () if given.weights is None else given.weights:
            if (found := np.count_nonzero(np.triu(weights))) > room:
                raise ValueError(
                    f"weights have {found} links; teams of this scenario's graph have room for "
                    f"{room}; give the scenario a graph with as many"
                )

    def _take_given(
        self, which: NDArray[np.int64], given: StartOptions, log: list[Overwritten]
    ) -> StartRules:
        """Write the given parts of a start into the state; the rules say to draw the others."""
        scenario, state = self.scenario, self._state
        n, d, rules = scenario.n_robots, scenario.dim, self._rules
        starts, headings = scenario.start_positions, scenario.start_headings
        positions = given.positions if starts is None else _or(given.positions, [starts])
        angles = given.angles if headings is None else _or(given.angles, [headings])
        frames, obstacles = given.frames, given.obstacles
        if frames is None and not scenario.model.nonholonomic and scenario.local_frames == "global":
            frames = np.broadcast_to(np.eye(d), (1, n, d, d))
        if obstacles is None:
            obstacles = self._fixed_obstacles
        if positions is not None:
            state.give("positions", _for_each(positions, which), which, log)
        if angles is not None:
            kept = np.zeros((*angles.shape[:-1], scenario.model.memory_size(d)))
            kept[..., : angles.shape[-1]] = angles  # whatever else it keeps begins at zero
            state.give("memory", _for_each(kept, which), which, log)
        if frames is not None:
            flat = frames.reshape(len(frames), n, d * d)
            state.give("frames", _for_each(flat, which), which, log)
        if given.weights is not None:
            listed = [_listed(matrix) for matrix in _for_each(given.weights, which)]
            state.give_links(listed, which, log)
        elif self._fixed_links is not None:
            state.give_links([self._fixed_links], which, log)
        if obstacles is not None and obstacles.size:
            state.give_obstacles(_for_each(obstacles, which), which, log)
        return rules._replace(
            draw_positions=positions is None,
            draw_memory=angles is None,
            draw_frames=rules.draw_frames and frames is None,
            draw_weights=given.weights is None,
            draw_obstacles=rules.draw_obstacles and given.obstacles is None,
        )


def _or(value: NDArray[np.float64] | None, default: Any) -> NDArray[np.float64]:
    return np.array(default, dtype=np.float64) if value is None else value


def _for_each(values: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.float64]:
    """One entry for each of these teams, from one for all or one for every team of the batch."""
    return values if len(values) == 1 else values[which]


def _listed(
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """The links of a matrix of weights, in the order of their robots."""
    first, second = np.nonzero(np.triu(weights))
    return first, second, weights[first, second]


def _width(scenario: Scenario, batch: int, num_threads: int | None) -> int:
    """As many threads as are worth their cost."""
    work = batch * _work_of_team(scenario, batch)
    most = threads.most_threads(num_threads)
    return max(1, min(most, work // _WORK_PER_THREAD, Arrangement(scenario, batch).blocks))


def _work_of_team(scenario: Scenario, batch: int) -> int:
    """Rows that a step of one team computes."""
    n, layout = scenario.n_robots, scenario.observation_layout
    neighbours = layout.neighbour_slots if Arrangement(scenario, batch).sparse else n - 1
    return n * (neighbours + 1 + layout.rows - layout.neighbour_slots)


def _quiet_integers() -> Any:
    """Without compilation NumPy would warn of every product of 64-bit numbers that wraps around."""
    return nullcontext() if compiled() else np.errstate(over="ignore")
