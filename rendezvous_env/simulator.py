"""Simulator: many teams at once. Every environment of this project is one of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .engine.allocation import Arrangement
from .engine.beginning.episodes import Episodes
from .engine.footprint import check_memory
from .engine.memory import ELAPSED, LYAPUNOV_NOW, RUNNING, Results
from .engine.state import State
from .engine.state_checks import check_entries, check_results, check_teams
from .engine.step import first_not_finite
from .engine.stepper import Stepper
from .experiment.checks import bools, floats, refuse, shown, whole
from .experiment.limits import MOST_STEPS, MOST_TEAMS
from .experiment.scenario import Scenario
from .experiment.seeding import seeds_of_teams
from .experiment.start_options import StartOptions, parse_options
from .outcome import Outcome
from .team_readings import TeamReadings

_FLOAT32 = np.dtype(np.float32)


class Simulator(TeamReadings):
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
        self._make()

    def _make(self) -> None:
        """Make what follows from the arguments: state, constants and working memory."""
        scenario = self.scenario
        self._acted = (self.num_envs, scenario.n_robots, scenario.action_size)
        self._observed = (self.num_envs, scenario.n_robots, *scenario.observation_layout.shape)
        self._state = State(Arrangement(scenario, self.num_envs))
        self._stepper = stepper = Stepper(self._state, self.num_threads, self.max_steps)
        self._episodes = Episodes(self._state, stepper.layout, stepper.robot, stepper.hands)
        self._given_out = tuple((a.shape, a.dtype) for a in stepper.forms.new())
        self._all_running = self._none_rests()
        self._ready = False

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
        self._begin(self._which(mask), seeds_of_teams(seed, self.num_envs), given, resting)
        return self.observe()

    def restart(self, mask: NDArray[np.bool_], outcome: Outcome | None = None) -> None:
        """Send some teams on to the next episode of their seed, at little cost to the others.

        Args:
            mask: (B,), which teams.
            outcome: what the last step gave out; in place of these teams' last observation,
                contact, clearance and standing it takes those of their start. If None, they pass
                the next step without moving and are observed there.

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
            results.status[which], results.contacts[which] = RUNNING, 0
            self._stepper.observe_again(which, results)
            results.scores[ELAPSED:, which] = 0.0
            results.scores[LYAPUNOV_NOW, which] = self.lyapunov()[which]
            self._refuse_crowds(results)

    def _begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None,
        given: StartOptions,
        resting: bool,
    ) -> None:
        self._all_running = False  # not known, should an interrupt leave from here
        self._episodes.begin(which, seeds, given, resting)
        self._all_running = not (resting and len(which)) and self._none_rests()
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
        table = self.check_actions(actions)
        self._all_running = False  # not known, should an interrupt leave from here
        results = self._stepper.step(table)
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
        results = self._stepper.observe()
        self._refuse_crowds(results)
        return results.observations.reshape(self._observed)

    def _which(self, mask: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        if mask is None:
            return np.arange(self.num_envs)
        return np.flatnonzero(bools("mask", mask, (self.num_envs,), "teams"))

    # ---- state --------------------------------------------------------------------------------

    @property
    def clearance(self) -> NDArray[np.float64]:
        """(B, n), distance of each robot to the nearest obstacle now, m; inf without obstacles."""
        return self._stepper.observe().clearance

    @property
    def all_running(self) -> bool:
        """Whether every team is in the midst of an episode; quicker than ``ended``."""
        return self._all_running

    def _none_rests(self) -> bool:
        return bool((self.status == RUNNING).all())

    @property
    def nbytes(self) -> int:
        """Bytes of the state of all teams."""
        return self._state.nbytes + self._episodes.seed.nbytes + self._episodes.number.nbytes

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Everything that the future of the teams depends on, as copies with leading axis B."""
        drawn = {"seed": self._episodes.seed.copy(), "episode": self._episodes.number.copy()}
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
        self._episodes.seed[...] = entries.pop("seed")
        self._episodes.number[...] = entries.pop("episode")
        self._state.put(entries)
        self._all_running = self._none_rests()
        self._ready = bool((self._episodes.number >= 0).any())
        if self._ready:
            self.observe()

    def set_max_steps(self, max_steps: int) -> None:
        """Change the time limit to a number of steps.

        Raises:
            ValueError: if it is not a positive whole number.
        """
        self.max_steps = whole("max_cycles", max_steps, 1, MOST_STEPS)
        self._stepper.limit(self.max_steps)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and deepcopy keep the running episodes and leave the working memory behind."""
        arguments = ("scenario", "num_envs", "num_threads", "max_steps")
        return {name: getattr(self, name) for name in arguments} | {"_state": self.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take up the episodes where they were."""
        kept = state.pop("_state")
        self.__dict__.update(state)
        self._make()
        self._put_state(kept)
