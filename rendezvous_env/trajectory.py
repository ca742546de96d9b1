"""Rollouts: simulate a policy for one episode and record the trajectory."""

import os
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from . import trajectory_formats, trajectory_views
from .checks import floats, raise_invalid, raise_other_scenario, short_repr
from .engine.memory import RENDEZVOUS, RUNNING
from .field_checks import known_arguments
from .field_docs import lists_fields
from .outcome import StepOutput
from .scenario.scenario import Scenario
from .scenario.scenarios import resolve
from .simulator import Simulator

Policy = Callable[[NDArray[np.float32], NDArray[np.float64]], NDArray[Any]]
ON_REQUEST = ("observations", "actions")
"""Quantities recorded only on request; observations dominate the memory."""
_MUCH = 1e9  # bytes above which a rollout warns before it starts


class Merge(NamedTuple):
    """Step in which robots of an environment merged."""

    env: int  # index of the environment
    time: float  # end of the step, s
    robots: tuple[int, ...]  # robots that merged into others
    lyapunov_before: float  # V just before the first merge of the step, m²/s
    lyapunov_after: float  # V just after the last merge of the step, m²/s


@lists_fields
@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """Recorded trajectory of B environments over T steps; ended ones keep their final state.

    found = rollout("ring-12", policy, num_envs=4)
    print(found, found.summary())    # one line; a table
    found.plot(), found.to_report("replay.html"), found.save("ring.npz")
    """

    scenario: Scenario
    """Scenario of all environments."""
    times: NDArray[np.float64]
    """Times of the states, (T + 1,), s."""
    positions: NDArray[np.float64]
    """Positions, (T + 1, B, n, d), m; a merged robot has its survivor's position."""
    headings: NDArray[np.float64]
    """Headings, (T + 1, B, n, k), rad: none for single integrators, yaw, or yaw and pitch."""
    active: NDArray[np.bool_]
    """Active (not merged) robots, (T + 1, B, n)."""
    lyapunov: NDArray[np.float64]
    """V, (T + 1, B), m²/s."""
    lyapunov_before_merge: NDArray[np.float64]
    """V just before the first merge of a step, or at its end without a merge, (T, B), m²/s."""
    lyapunov_after_merge: NDArray[np.float64]
    """V just after the last merge of a step, or at its end without a merge, (T, B), m²/s."""
    rewards: NDArray[np.float64]
    """Team reward of each step, (T, B)."""
    contacts: NDArray[np.bool_]
    """Robots in contact with an obstacle in the step, (T, B, n)."""
    success: NDArray[np.bool_]
    """Environments with rendezvous, (B,)."""
    rendezvous_time: NDArray[np.float64]
    """Rendezvous time, (B,), s; inf without rendezvous."""
    obstacles: NDArray[np.float64]
    """Obstacles, (B, M, width), as tables of ``obstacles.obstacle_set``."""
    recorded: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """Quantities recorded on request, by name."""
    conditions: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Conditions of robots in each step, (T, B, n), with asynchronous activation or events; see
    ``Simulator.conditions``."""
    start: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """State after the reset, from which to repeat the rollout; see ``Simulator.get_state``."""
    policy: str = ""
    """Name of the policy: of its function or class."""
    played_by: Any = None
    """Policy object; None in a pickled or loaded copy."""
    obstacle_offsets: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0, 0, 0)))
    """Displacements of obstacles from ``obstacles``, (T + 1, B, M, d), m; empty if none moves."""

    @property
    def num_envs(self) -> int:
        """Number of environments B."""
        return int(self.positions.shape[1])

    @property
    def collision_free(self) -> NDArray[np.bool_]:
        """Environments without contact, (B,), whether or not the robots met."""
        return np.asarray(~self.contacts.any(axis=(0, 2)))

    @property
    def collision_free_success(self) -> NDArray[np.bool_]:
        """Environments in which all robots met without contact, (B,), the metric of all tables."""
        return self.success & self.collision_free

    @property
    def observations(self) -> NDArray[np.float32]:
        """Observations, (T + 1, B, n, rows, d); AttributeError if not recorded."""
        return self._kept("observations")

    @property
    def actions(self) -> NDArray[np.float32]:
        """Actions of the policy, (T, B, n, a); AttributeError if not recorded."""
        return self._kept("actions")

    def _kept(self, name: str) -> NDArray[np.float32]:
        if name not in self.recorded:
            remedy = f'request them: rollout(…, record="{name}")'
            raise AttributeError(f"{name} were not recorded; {remedy}")
        return self.recorded[name]

    @property
    def running(self) -> NDArray[np.bool_]:
        """Environments that took part in the step, (T, B)."""
        begun = self.times[:-1, np.newaxis] + 0.5 * self.scenario.tau
        return np.asarray(begun < self.rendezvous_time)

    @property
    def merges(self) -> list[Merge]:
        """All merges in order of time."""
        gone = self.active[:-1] & ~self.active[1:]
        return [
            Merge(
                env=int(b),
                time=float(self.times[t + 1]),
                robots=tuple(np.flatnonzero(gone[t, b]).tolist()),
                lyapunov_before=float(self.lyapunov_before_merge[t, b]),
                lyapunov_after=float(self.lyapunov_after_merge[t, b]),
            )
            for t, b in np.argwhere(gone.any(axis=-1))
        ]

    @property
    def largest_rise_between_merges(self) -> NDArray[np.float64]:
        """Largest increase of V in a step before any merge, (B,), m²/s; may be negative."""
        rises = self.lyapunov_before_merge - self.lyapunov[:-1]
        return np.max(rises, axis=0, where=self.running, initial=-np.inf)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file written by ``save``.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: for another file, or a scenario that cannot be created, for example without
                a registered reward term.
        """
        own, arrays = trajectory_views.read(path)
        try:
            return cls(**own, **arrays)
        except TypeError as error:
            raise ValueError(f"{path} is not a trajectory of this version: {error}") from error

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"played_by": None}  # may not be picklable

    __repr__ = trajectory_views.one_line
    summary = trajectory_views.summary
    plot = trajectory_views.plot
    plot_lyapunov = trajectory_views.plot_lyapunov
    to_report = trajectory_views.to_report
    save = trajectory_views.save
    to_dataframe = trajectory_formats.pandas_dataframe
    to_xarray = trajectory_formats.xarray_dataset
    to_minari = trajectory_formats.minari_dataset


class Step(NamedTuple):
    """One step of an episode, as yielded by ``run``."""

    running: NDArray[np.bool_]  # (B,), environments that took part
    observations: NDArray[np.float32]  # (B, n, rows, d), input of the policy
    actions: NDArray[np.float32]  # (B, n, a)
    lyapunov: NDArray[np.float64]  # (B,), V before the step, m²/s
    outcome: StepOutput


def begin(policy: Policy, simulator: Simulator) -> None:
    """Notify a policy of new episodes in environments that were just reset.

    Calls its ``reset(mask=None)`` and ``watch(simulator)``, if present. Only privileged policies,
    which read positions, have ``watch``.

    Raises:
        ValueError: for a policy made for other robots or other observation rows.
    """
    _check_made_for(policy, simulator.scenario)
    for method, arguments in (("reset", ()), ("watch", (simulator,))):
        if callable(found := getattr(policy, method, None)):
            found(*arguments)


def _check_made_for(policy: Policy, scenario: Scenario) -> None:
    """Raise an error for a policy of a scenario with other robots or observations."""
    made_for = getattr(policy, "scenario", None)
    if not isinstance(made_for, Scenario):
        return
    names = ("robot_model", "dim", "neighbour_slots", "obstacle_slots")
    own, here = (
        (one.robot_model, one.dim, layout.neighbour_slots, layout.obstacle_slots)
        for one in (made_for, scenario)
        for layout in [one.observation_layout]
    )
    differing = {name: (a, b) for name, a, b in zip(names, own, here, strict=True) if a != b}
    if differing:
        raise_other_scenario(type(policy).__name__, made_for.name, scenario.name, differing)


def run(simulator: Simulator, policy: Policy, observations: NDArray[np.float32]) -> Iterator[Step]:
    """Step until every environment has ended, yielding after each step.

    The simulator may be read between steps.

    Args:
        simulator: the environments, just reset.
        policy: maps observations (B, n, rows, d) and times (B,) in s to actions (B, n, a).
            ValueError for actions of another shape or not finite. See ``begin``.
        observations: result of the reset.
    """
    begin(policy, simulator)
    while (running := simulator.status == RUNNING).any():
        chosen = policy(observations.copy(), simulator.time)  # a writable copy
        actions = floats("actions", chosen, np.float32)
        before = simulator.lyapunov()
        outcome = simulator.step(actions)
        yield Step(running, observations, actions, before, outcome)
        observations = outcome.observations


@known_arguments
def rollout(
    scenario: Scenario | str | os.PathLike[str],
    policy: Policy,
    seed: int | None = 0,
    num_envs: int = 1,
    options: Mapping[str, Any] | None = None,
    record: str | Sequence[str] = (),
) -> Trajectory:
    """Simulate one episode in each of ``num_envs`` environments and record the trajectory.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        policy: any callable (observations, time) → actions, see ``run``.
        seed: environment b has the seed ``seed`` + b.
        num_envs: B, number of environments.
        options: given parts of the initial condition, see ``Simulator.reset``.
        record: further quantities: "observations", "actions", both, or "all". A warning precedes a
            rollout that may record more than 1 GB.

    Raises:
        ValueError, TypeError: for an invalid argument or action; the message gives its name.
    """
    if not callable(policy):
        raise TypeError(
            f"policy is {short_repr(policy)}; it must be callable: baselines.make makes one"
        )
    asked = _requested(record)
    simulator = Simulator(resolve(scenario), num_envs)
    kept: defaultdict[str, list[NDArray[Any]]] = defaultdict(list)
    told: defaultdict[str, list[NDArray[np.bool_]]] = defaultdict(list)

    def keep(**arrays: NDArray[Any]) -> None:
        for name, array in arrays.items():
            if name not in ON_REQUEST or name in asked:
                kept[name].append(array)

    def keep_state(observations: NDArray[np.float32]) -> None:
        keep(
            positions=simulator.positions,
            headings=simulator.headings,
            active=simulator.active,
            lyapunov=simulator.lyapunov(),
            observations=observations,
        )
        if simulator.obstacle_offsets.size:
            keep(obstacle_offsets=simulator.obstacle_offsets)

    observations = simulator.reset(seed, options)
    start, obstacles = simulator.get_state(), simulator.obstacles.copy()
    keep_state(observations)
    _warn_of_size(simulator, sum(arrays[0].nbytes for arrays in kept.values()), asked)
    finished_at = np.full(simulator.num_envs, np.inf)
    for step in run(simulator, policy, observations):
        outcome = step.outcome
        keep(  # copies, since views would keep the whole table alive
            lyapunov_before_merge=outcome.lyapunov_before_merge.copy(),
            lyapunov_after_merge=outcome.lyapunov_after_merge.copy(),
            rewards=outcome.rewards.copy(),
            contacts=outcome.contact,
            actions=step.actions.copy(),  # a policy may reuse its array
        )
        for name, values in simulator.conditions.items():
            told[name].append(values)
        keep_state(outcome.observations)
        met = step.running & (simulator.status == RENDEZVOUS)
        finished_at[met] = simulator.time[met]
    # each list is freed once its array exists, which halves the peak memory
    arrays = {name: np.stack(kept.pop(name)) for name in list(kept)}
    return Trajectory(
        scenario=simulator.scenario,
        times=np.arange(len(arrays["positions"]), dtype=np.float64) * simulator.scenario.tau,
        success=simulator.status == RENDEZVOUS,
        rendezvous_time=finished_at,
        obstacles=obstacles,
        recorded={name: arrays.pop(name) for name in asked},
        conditions={name: np.stack(values) for name, values in told.items()},
        start=start,
        policy=str(getattr(policy, "__name__", None) or type(policy).__name__.lstrip("_")),
        played_by=policy,
        **arrays,
    )


def _requested(record: Any) -> tuple[str, ...]:
    if isinstance(record, str) and record == "all":
        return ON_REQUEST
    names = (record,) if isinstance(record, str) else record
    if not isinstance(names, Sequence) or not all(name in ON_REQUEST for name in names):
        raise_invalid("record", record, f'of {", ".join(map(repr, ON_REQUEST))}, or "all"')
    return tuple(name for name in ON_REQUEST if name in names)


def _warn_of_size(simulator: Simulator, a_state: int, asked: tuple[str, ...]) -> None:
    """Warn if an episode of maximum length, given the bytes per state, exceeds _MUCH."""
    n, size = simulator.scenario.n_robots, simulator.scenario.action_size
    actions = 4 * n * size if "actions" in asked else 0
    a_step = a_state + simulator.num_envs * (3 * 8 + n + actions)  # V twice, reward, contacts
    if (total := a_step * (simulator.max_steps + 1)) > _MUCH:
        advice = "use fewer environments or steps" + (", or record less" if asked else "")
        warnings.warn(
            f"this rollout may record {total / 1e9:.1f} GB, {a_step / 1e6:.3g} MB a step for up to "
            f"{simulator.max_steps} steps; {advice}",
            stacklevel=4,  # of the caller of ``rollout``, which is decorated
        )
