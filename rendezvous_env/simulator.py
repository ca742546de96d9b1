"""Simulator: batched environments of one scenario, on which all interfaces build."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import check_int, format_limit
from .engine.batch_runner import (
    BatchController,
    BatchRunner,
    ObservationCallback,
    RolloutResult,
)
from .engine.episodes import EpisodeReset
from .engine.memory import RENDEZVOUS, RUNNING
from .engine.memory_layout import MemoryLayout, check_memory
from .engine.preparation import speed_limits_of
from .engine.state import BatchState
from .engine.state_checks import (
    check_actions,
    check_entries,
    check_mask,
    check_output,
    check_teams,
)
from .limits import MAX_STEPS, MAX_TEAMS
from .observation_fit import ObservationFit
from .obstacles.moving import max_speed
from .outcome import ELAPSED, LYAPUNOV, StepOutput
from .rewards.costs import costs_of, no_costs
from .rewards.custom_terms import RewardStep, add_custom_terms
from .robots.robot_models import is_custom
from .scenario.scenarios import ScenarioLike, resolve
from .scenario.start_options import StartOptions, parse_options, seeds_of_environments
from .sensors.custom_sensors import ObservationBatch, apply_custom
from .state_view import StateView, read_only


class Simulator(StateView):
    """B environments of one scenario, advanced together.

    For equal seeds, trajectories are bitwise equal for any batch size and number of threads. The
    simulator manages its own threads: do not use it from several threads at a time.

    Args:
        scenario: a Scenario, the name of one, or the path of a TOML file.
        num_envs: B, number of environments, at least 1.
        num_threads: maximum number of threads of a step; None is one per core.

    Raises:
        ValueError: if ``num_envs`` or ``num_threads`` is not a positive integer, or memory is
            insufficient.
    """

    def __init__(
        self, scenario: ScenarioLike, num_envs: int = 1, *, num_threads: int | None = None
    ) -> None:
        self.scenario = scenario = resolve(scenario)
        self.num_envs = check_int("num_envs", num_envs, 1, MAX_TEAMS)
        given = num_threads is not None
        self.num_threads = check_int("num_threads", num_threads, 1, MAX_TEAMS) if given else None
        check_memory(scenario, self.num_envs)
        self.max_steps = scenario.max_steps
        self.changes = 0
        """Counter of state changes; a step alone adds 1. Wrappers use it to detect other
        changes."""
        self._make()

    def _make(self) -> None:
        """Derive everything that depends on the arguments."""
        scenario = self.scenario
        self._sensed = sensed = scenario.with_all_rows
        """Scenario of the engine, with a row for every neighbour and obstacle."""
        self._fit = None if sensed is scenario else ObservationFit(scenario)
        self._acted = (self.num_envs, scenario.n_robots, scenario.action_size)
        self._state = BatchState(MemoryLayout(sensed, self.num_envs))
        self._runner = runner = BatchRunner(self._state, self.num_threads, self.max_steps)
        self._episodes = EpisodeReset(self._state, runner.robot, runner.scratch)
        given = self._acted[:2] + scenario.observation_layout.shape, np.dtype(np.float32)
        self._given_out = (given, *((a.shape, a.dtype) for a in runner.new_output()[1:]))
        self._all_running = True
        self._custom = bool(scenario.reward.custom or scenario.sensing.custom or scenario.costs)
        self.costs = no_costs(scenario.costs, self._acted[:2])
        """Costs of the last step, (B, n) each, by infos key; empty if the scenario has none."""
        custom = list(dict(scenario.reward.custom))
        self._earned = {name: np.zeros(self.num_envs) for name in custom}
        self.earned_before = {name: np.zeros(self.num_envs) for name in custom}
        """Sum of each custom reward term over the last episode that a reset ended, (B,)."""
        self._own_model = any(map(is_custom, scenario.models))
        self._ready = self._observed = False

    def reset(
        self,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
        *,
        mask: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Start a new episode in all environments, or in those of a mask.

        Args:
            seed: s gives environment i the seed s + i. A list gives one seed per environment; a
                None in it keeps that environment's seed. None continues with the next episode of
                every seed, or samples a seed if there is none.
            options: "positions" (n, d) m, "headings" (n,) rad or (n, 2) yaw and pitch, "frames" (n,
                d, d) rotations, "weights" (n, n) m/s. Each has a leading axis B if environments
                differ. "obstacles" apply to all environments. None counts as absent.
            mask: (B,), environments to reset; None is all.

        Returns:
            Observations of all environments, (B, n, rows, d) float32.

        Raises:
            ValueError: for an invalid option, seed or mask; the state is unchanged. Also for an
                invalid result of a custom imperfection; the episodes have then started.
            RuntimeError: if there is no space for a robot or an obstacle; the state is unchanged.
                Also if the sampled graph exceeds the neighbour rows of a robot.
        """
        given = parse_options(self._sensed, self.num_envs, options)
        self._begin(self._which(mask), seeds_of_environments(seed, self.num_envs), given)
        return self.observe()

    def restart(self, mask: NDArray[np.bool_], outcome: StepOutput | None = None) -> None:
        """Start the next episode in environments of a mask (B,), at low cost to the others.

        Args:
            mask: environments to restart.
            outcome: output of the last step, updated in place: last observation, contact, clearance
                and statistics become those of the initial condition. If None, these environments
                pass the next step without moving and are then observed.

        Raises:
            ValueError: for an invalid mask, or an outcome of other environments; the state is
                unchanged.
            RuntimeError: as ``reset``.
        """
        which = self._which(mask)
        if outcome is not None:
            check_output(outcome, self._given_out)
        self._begin(which, resting=outcome is None)
        if outcome is not None:
            outcome.contact[which], outcome.active[which] = False, True
            outcome.status[which], outcome.contacts[which] = RUNNING, 0
            self._observe_again(which, outcome)
            outcome.scores[ELAPSED:, which] = 0.0
            outcome.scores[LYAPUNOV, which] = self.lyapunov()[which]
            self._refuse_crowds(outcome)

    def _observe_again(self, which: NDArray[np.int64], outcome: StepOutput) -> None:
        """Update the observations of some environments in an outcome."""
        if self._fit is None:
            self._sense_custom(outcome, self._runner.observe_again(which, outcome))
            return
        found = outcome._replace(observations=self._runner.new_output().observations)
        teams = self._runner.observe_again(which, found)
        self._sense_custom(found, teams)
        outcome.observations[teams] = self._fitted(found.observations, teams)

    def _fitted(self, observations: NDArray[np.float32], which: Any) -> NDArray[np.float32]:
        """Observations of some environments, in the scenario's rows."""
        assert self._fit is not None
        world = self._state.obstacles
        obstacles = type(world)(*(array[which] for array in world))
        return self._fit(observations[which], self.positions[which], obstacles)

    def _begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None = None,
        given: StartOptions = StartOptions(),  # noqa: B008 - immutable
        resting: bool = False,
    ) -> None:
        self._all_running = False  # unknown after an interrupt
        self._episodes.begin(which, seeds, given, resting)
        self.changes += 2  # a step alone adds 1
        for name, earned in self._earned.items():
            self.earned_before[name][which], earned[which] = earned[which], 0.0
        self._all_running = not (resting and len(which)) and not self.status.any()
        self._ready = self._observed and not (self._state.number < 0).any()

    def step(self, actions: ArrayLike) -> StepOutput:
        """Advance every running environment by one step τ with zero-order hold.

        Args:
            actions: (B, n, a) in the robots' local frames, m/s and rad/s; ignored for ended
                environments and merged robots.

        Raises:
            ValueError: for a wrong shape or a non-finite number, with the robot; the state is
                unchanged. Also for an invalid result of a custom reward term or imperfection; the
                step has then been made.
            RuntimeError: before the first reset of an environment. Also if a custom robot model
                exceeds its speed limit, with the robot; these environments then need a reset.
        """
        self._check_ready()
        table = self.check_actions(actions)
        before = (self.positions, self.active) if self._own_model else None
        self.changes += 1
        self._all_running = False  # unknown after an interrupt
        output = self._custom_step(table) if self._custom else self._runner.step(table)
        self._all_running = not np.count_nonzero(output.status)  # RUNNING is 0
        if before is not None:
            self._refuse_leaps(*before)
        if self._fit is not None:
            output = output._replace(observations=self._fitted(output.observations, slice(None)))
        self._refuse_crowds(output)
        return output

    def compile(self) -> None:
        """Compile all stages of a step.

        Small batches otherwise compile contacts and merges when one is first possible.
        """
        self._runner.compile()

    def _check_ready(self) -> None:
        if not self._ready:
            never = np.flatnonzero(self._state.number < 0)
            which = (
                f": environment {never[0]} was not reset" if 0 < len(never) < self.num_envs else ""
            )
            raise RuntimeError(f"call reset() before step(){which}")

    @property
    def supports_step_n(self) -> bool:
        """True if ``step_n`` is available.

        It requires steps without user code and observations of the engine. No robot may exceed its
        neighbour rows.
        """
        slots = self.scenario.observation_layout.neighbour_slots
        crowds = slots < self.scenario.n_robots - 1
        return not (self._custom or self._own_model or crowds or self._fit is not None)

    can_drive = supports_step_n  # its name in version 0.2

    def step_n(
        self,
        controller: BatchController,
        observations: NDArray[np.float32],
        count: int,
        callback: ObservationCallback | None = None,
    ) -> RolloutResult:
        """Advance every running environment by ``count`` ≥ 1 steps under a controller.

        The result equals that of ``step``, but the actions are not validated. Requires
        ``supports_step_n``.

        Args:
            controller: maps observations to actions.
            observations: current observations of all environments, (B, n, rows, d).
            count: number of steps.
            callback: called with slices of the batch and the observations after the last step, by
                the thread of the slice.
        """
        self._check_ready()
        resting = np.zeros(self.num_envs, np.bool_) if self._all_running else self.status != RUNNING
        self.changes += 1
        self._all_running = False  # unknown after an interrupt
        result = self._runner.step_n(controller, observations, resting, count, callback)
        self._all_running = not np.count_nonzero(result.output.status)
        return result

    drive = step_n  # its name in version 0.2

    def _refuse_leaps(self, before: NDArray[np.float64], active: NDArray[np.bool_]) -> None:
        """Reject motion beyond the speed limit, on which contact and merging rely."""
        scenario = self.scenario
        limits = speed_limits_of(self._runner.robot)
        # each merge may move a robot by half a merge radius
        merged = (self.active != active).sum(axis=1, keepdims=True)
        rounding = 4.0 * np.spacing(np.abs(before).max())
        pushed = max_speed(scenario.obstacles)
        most = (
            1.000001 * (limits + pushed) * scenario.tau + merged * scenario.merge_radius + rounding
        )
        moved = np.linalg.norm(self.positions - before, axis=-1)
        wrong = np.argwhere(~(moved <= most))  # NaN is also invalid
        if len(wrong):
            team, robot = (int(index) for index in wrong[0])
            limit = float(np.broadcast_to(limits, moved.shape[1:])[robot])
            self._ready = self._observed = False
            raise RuntimeError(
                f"robot model {scenario.robot_model!r} moved robot {robot} of environment {team} "
                f"by {moved[team, robot]:.6g} m in a step of {format_limit(scenario.tau)} s; "
                f"its speed_limit is {format_limit(limit)} m/s"
            )

    def _custom_step(self, actions: NDArray[np.float32]) -> StepOutput:
        """Step with custom reward terms and imperfections."""
        before, took_part, running = self.positions, self.active, self.status == RUNNING
        lyapunov, start = self.lyapunov(), self.initial_lyapunov
        moving = self.scenario.sensing_graph.kind == "proximity"
        linked = self.weights > 0.0 if moving else None
        output = self._runner.step(actions)
        rise = np.maximum(output.lyapunov_before_merge - lyapunov, 0.0)
        lost = np.zeros(took_part.shape, dtype=np.int64)
        if linked is not None:
            both = output.active[:, :, None] & output.active[:, None, :]
            lost = (linked & both & ~(self.weights > 0.0)).sum(axis=2)
        step = RewardStep(
            scenario=self.scenario,
            actions=actions,
            positions_before=before,
            positions=self.positions,
            took_part=took_part,
            active=output.active,
            contact=output.contact,
            clearance=output.clearance,
            time=output.scores[ELAPSED],
            met=running & (output.status == RENDEZVOUS),
            rise=np.divide(rise, start, out=np.zeros_like(rise), where=start > 0.0),
            links_lost=lost,
        ).read_only()
        if self.scenario.costs:
            self.costs = costs_of(self.scenario.costs, step, running)
        added = add_custom_terms(step, running, output.rewards, output.robot_rewards)
        for name, earned in added.items():
            self._earned[name] += earned
        self._sense_custom(output, np.arange(self.num_envs))
        return output

    def _sense_custom(self, output: StepOutput, which: NDArray[np.int64]) -> None:
        """Apply custom imperfections to the latest observations of some environments."""
        if self.scenario.sensing.custom:
            rows, steps = output.observations[which], self.steps[which]
            seeds, numbers = self._state.seed[which], self._state.number[which]
            seen = ObservationBatch(
                self._sensed, rows, steps, seeds, numbers, self.positions[which]
            )
            apply_custom(seen)
            output.observations[which] = rows

    def check_actions(self, actions: ArrayLike) -> NDArray[np.float32]:
        """Return actions as an array for ``step``.

        Raises:
            ValueError: for a wrong shape, non-numeric input, or a non-finite number, with the
                robot.
        """
        return check_actions(actions, self._acted, "(B, n, a)")

    def _refuse_crowds(self, output: StepOutput) -> None:
        """Raise an error for a robot with more neighbours than observation rows."""
        slots = self._sensed.observation_layout.neighbour_slots
        if slots == self.scenario.n_robots - 1 or not (output.neighbour_overflow >= 0).any():
            return
        team = int(np.argmax(output.neighbour_overflow >= 0))
        raise RuntimeError(
            f"robot_{output.neighbour_overflow[team]} of environment {team} has more than "
            f"neighbour_slots = {slots} neighbours after step {self.steps[team]}; "
            "give the scenario more neighbour_slots"
        )

    def observe(self) -> NDArray[np.float32]:
        """Current observations of all environments, (B, n, rows, d) float32.

        Raises:
            RuntimeError: if a robot has more neighbours than the observation has rows.
        """
        output = self._runner.observe()
        self._observed = True  # steps rely on it
        self._ready = not (self._state.number < 0).any()
        self._sense_custom(output, np.arange(self.num_envs))
        self._refuse_crowds(output)
        if self._fit is not None:
            return self._fitted(output.observations, slice(None))
        return output.observations

    def _which(self, mask: NDArray[np.bool_] | None) -> NDArray[np.int64]:
        if mask is None:
            return np.arange(self.num_envs)
        return np.flatnonzero(check_mask(mask, self.num_envs))

    @property
    def clearance(self) -> NDArray[np.float64]:
        """Current distance of each robot to the nearest obstacle, (B, n), m; or inf."""
        return read_only(self._runner.observe().clearance)

    @property
    def begun(self) -> bool:
        """True if a reset has taken place."""
        return self._ready or bool((self._state.number >= 0).any())

    @property
    def all_running(self) -> bool:
        """True if the episodes of all environments are running; faster than ``ended``."""
        return self._all_running

    @property
    def nbytes(self) -> int:
        """Size of the state of all environments, bytes."""
        return self._state.nbytes

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copies of the complete state, with leading axis B."""
        return self._state.as_dict()

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state from ``get_state`` of a simulator of equal scenario and batch.

        An error of ``check_state`` leaves the state unchanged.
        """
        checked = self.check_state(state)
        self.changes += 2
        self._put_state(checked)

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """Validate a state and return its arrays.

        Raises:
            ValueError: for an entry that is missing, unknown, of wrong shape or type, or invalid
                for the engine; the message gives its value and a remedy.
        """
        entries = check_entries(self.get_state(), state, exactly=True)
        check_teams(self._sensed, entries)
        return entries

    def _put_state(self, state: dict[str, NDArray[Any]]) -> None:
        self._ready = self._observed = False  # in case of an interrupt
        self._state.put(state)
        self._all_running = not self.status.any()
        if self.begun:
            self.observe()

    def set_max_steps(self, max_steps: int) -> None:
        """Change the time limit, in steps.

        Raises:
            ValueError: if it is not a positive integer.
        """
        self.max_steps = check_int("max_cycles", max_steps, 1, MAX_STEPS)
        self._runner.limit(self.max_steps)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and deepcopy keep the running episodes, without working memory."""
        arguments = ("scenario", "num_envs", "num_threads", "max_steps", "changes")
        return {name: getattr(self, name) for name in arguments} | {"_state": self.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the running episodes."""
        kept = state.pop("_state")
        self.__dict__.update(state)
        self._make()
        self._put_state(kept)
