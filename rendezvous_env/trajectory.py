"""Rollouts: run a policy for one episode and keep what happened."""

import os
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import trajectory_formats
from .checks import floats, raise_invalid, short_repr
from .engine.memory import RENDEZVOUS, RUNNING
from .field_docs import lists_fields
from .outcome import StepOutput
from .scenario.scenario import Scenario
from .scenario.scenarios import resolve
from .simulator import Simulator
from .trajectory_views import TrajectoryViews

Policy = Callable[[NDArray[np.float32], NDArray[np.float64]], NDArray[Any]]
ON_REQUEST = ("observations", "actions")
"""What a rollout keeps only on request: observations are by far the largest part."""
_MUCH = 1e9  # bytes above which a rollout warns before it starts


class Merge(NamedTuple):
    """A step in which robots of a team merged."""

    env: int  # index of the team
    time: float  # end of the step, s
    robots: tuple[int, ...]  # that were absorbed
    lyapunov_before: float  # V just before the first merge of the step, m²/s
    lyapunov_after: float  # V just after the last, m²/s


@lists_fields
@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(TrajectoryViews):
    """What B environments did over T steps; one that has finished stays as it is to the end.

    found = rollout("ring-12", policy, num_envs=4)
    print(found, found.summary())    # one line; a table
    found.plot(), found.to_report("replay.html"), found.save("ring.npz")
    """

    scenario: Scenario
    """Scenario of all environments."""
    times: NDArray[np.float64]
    """Times of the states, (T + 1,), s."""
    positions: NDArray[np.float64]
    """(T + 1, B, n, d), m; a merged-away robot is where its survivor is."""
    headings: NDArray[np.float64]
    """(T + 1, B, n, k), rad: none for single integrators, yaw, or yaw and pitch."""
    active: NDArray[np.bool_]
    """(T + 1, B, n), whether the robot still exists on its own."""
    lyapunov: NDArray[np.float64]
    """V, (T + 1, B), m²/s."""
    lyapunov_before_merge: NDArray[np.float64]
    """(T, B), V just before the first merge of a step; V at its end if there was none."""
    lyapunov_after_merge: NDArray[np.float64]
    """(T, B), V just after the last merge of a step; V at its end if there was none."""
    rewards: NDArray[np.float64]
    """Rewards of the team in each step, (T, B)."""
    contacts: NDArray[np.bool_]
    """(T, B, n), whether a robot touched an obstacle in the step."""
    success: NDArray[np.bool_]
    """(B,), whether all robots met."""
    rendezvous_time: NDArray[np.float64]
    """(B,), s; inf without rendezvous."""
    obstacles: NDArray[np.float64]
    """(B, M, width), tables of ``obstacles.obstacle_set``."""
    recorded: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """What was kept on request, by name."""
    start: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """State after the reset, see ``Simulator.get_state``, from which to repeat the rollout."""
    policy: str = ""
    """Name of the policy: of its function or class."""
    played_by: Any = None
    """The policy itself; None in a copy that was pickled or loaded."""

    @property
    def observations(self) -> NDArray[np.float32]:
        """(T + 1, B, n, rows, d), as the robots saw them; an AttributeError if not kept."""
        return self._kept("observations")

    @property
    def actions(self) -> NDArray[np.float32]:
        """(T, B, n, a), as the policy chose them; an AttributeError if not kept."""
        return self._kept("actions")

    def _kept(self, name: str) -> NDArray[np.float32]:
        if name not in self.recorded:
            raise AttributeError(f'{name} were not kept; ask for them: rollout(…, record="{name}")')
        return self.recorded[name]

    @property
    def running(self) -> NDArray[np.bool_]:
        """(T, B), whether the team took part in the step."""
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
        """Largest rise of V in a step before any merge, (B,), m²/s; negative: V fell in each."""
        rises = self.lyapunov_before_merge - self.lyapunov[:-1]
        return np.max(rises, axis=0, where=self.running, initial=-np.inf)

    to_dataframe = trajectory_formats.pandas_dataframe
    to_xarray = trajectory_formats.xarray_dataset
    to_minari = trajectory_formats.minari_dataset


class Step(NamedTuple):
    """One step of an episode as ``run`` yields it."""

    running: NDArray[np.bool_]  # (B,), which teams took part
    observations: NDArray[np.float32]  # (B, n, rows, d), what the actions were chosen from
    actions: NDArray[np.float32]  # (B, n, a)
    lyapunov: NDArray[np.float64]  # (B,), V before the step, m²/s
    outcome: StepOutput


def begin(policy: Policy, simulator: Simulator) -> None:
    """Tell a policy that episodes begin in teams that were just reset: call its
    ``reset(mask=None)`` and ``watch(simulator)``, if it has them. Only privileged policies, which
    read positions, watch.
    """
    for method, arguments in (("reset", ()), ("watch", (simulator,))):
        if callable(found := getattr(policy, method, None)):
            found(*arguments)


def run(simulator: Simulator, policy: Policy, observations: NDArray[np.float32]) -> Iterator[Step]:
    """Step until every team has finished; after each step the caller may look at the simulator.

    Args:
        simulator: the teams, freshly reset.
        policy: (B, n, rows, d) observations and (B,) times in s → (B, n, a) actions, refused in a
            ValueError if they have another shape or are not finite; see ``begin``.
        observations: what the reset returned.
    """
    begin(policy, simulator)
    while (running := simulator.status == RUNNING).any():
        chosen = policy(observations.copy(), simulator.time)  # its own, to write to
        actions = floats("actions", chosen, np.float32)
        before = simulator.lyapunov()
        outcome = simulator.step(actions)
        yield Step(running, observations, actions, before, outcome)
        observations = outcome.observations


def rollout(
    scenario: Scenario | str | os.PathLike[str],
    policy: Policy,
    seed: int | None = 0,
    num_envs: int = 1,
    options: Mapping[str, Any] | None = None,
    record: str | Sequence[str] = (),
) -> Trajectory:
    """Run one episode in each of ``num_envs`` teams and keep what happened.

    Args:
        scenario: a Scenario, the name of one or the path of a TOML file.
        policy: any callable (observations, time) → actions, see ``run``.
        seed: team b starts from seed + b.
        num_envs: B.
        options: given parts of the start, see ``Simulator.reset``.
        record: what to keep besides: "observations", "actions", both, or "all". A warning precedes
            a rollout that may keep more than 1 GB.

    A ValueError or TypeError names the argument, or the action, that is wrong.
    """
    if not callable(policy):
        raise TypeError(
            f"policy is {short_repr(policy)}; it must be callable: baselines.make makes one"
        )
    asked = _requested(record)
    simulator = Simulator(resolve(scenario), num_envs)
    kept: defaultdict[str, list[NDArray[Any]]] = defaultdict(list)

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

    observations = simulator.reset(seed, options)
    start = simulator.get_state()
    keep_state(observations)
    _warn_of_size(simulator, sum(arrays[0].nbytes for arrays in kept.values()), asked)
    finished_at = np.full(simulator.num_envs, np.inf)
    for step in run(simulator, policy, observations):
        outcome = step.outcome
        keep(  # copies of rows, which would keep the whole table alive
            lyapunov_before_merge=outcome.lyapunov_before_merge.copy(),
            lyapunov_after_merge=outcome.lyapunov_after_merge.copy(),
            rewards=outcome.rewards.copy(),
            contacts=outcome.contact,
            actions=step.actions.copy(),  # a policy may give the same array again
        )
        keep_state(outcome.observations)
        met = step.running & (simulator.status == RENDEZVOUS)
        finished_at[met] = simulator.time[met]
    # each list is dropped once its array is there, which halves the memory needed
    arrays = {name: np.stack(kept.pop(name)) for name in list(kept)}
    return Trajectory(
        scenario=simulator.scenario,
        times=np.arange(len(arrays["positions"]), dtype=np.float64) * simulator.scenario.tau,
        success=simulator.status == RENDEZVOUS,
        rendezvous_time=finished_at,
        obstacles=simulator.obstacles.copy(),
        recorded={name: arrays.pop(name) for name in asked},
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
    """Warn if an episode up to the time limit, of so many bytes a state, fills more than _MUCH."""
    n, size = simulator.scenario.n_robots, simulator.scenario.action_size
    actions = 4 * n * size if "actions" in asked else 0
    a_step = a_state + simulator.num_envs * (3 * 8 + n + actions)  # V twice, reward, contacts
    if (total := a_step * (simulator.max_steps + 1)) > _MUCH:
        advice = "take fewer teams or steps" + (", or record less" if asked else "")
        warnings.warn(
            f"this rollout may keep {total / 1e9:.1f} GB, {a_step / 1e6:.3g} MB a step for up to "
            f"{simulator.max_steps} steps; {advice}",
            stacklevel=3,
        )
