"""Policy on board one robot: from its measurements since the last tick to a velocity command."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import positive, raise_invalid
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from . import policy as registry
from .policy import Policy, RealTimePolicy
from .robot_sight import RobotSight
from .steering import check_steerable

_KINDS = ("law", "rule", "learned")
"""Kinds whose policies are independent of robot indices and of the number of calls."""


_BELOW = 1.0 - 1e-15  # of a limit, so that rounding exceeds none


def _within_limits(action: NDArray[np.float64], scenario: Scenario) -> NDArray[np.float64]:
    """An action, (a,), that no limit is exceeded by: rounded to float32 it may have been."""
    most = _BELOW * scenario.action_bounds
    if scenario.model.nonholonomic:
        return np.clip(action, -most, most)
    speed = float(np.linalg.norm(action))
    return action * (most[0] / speed) if speed > most[0] else action


class OneRobot:
    """Single-robot interface of a policy.

    ``gain`` is the default edge weight a_ij of every neighbour, m/s.
    """

    def __init__(self, scenario: Scenario, policy: Policy, gain: float = 1.0) -> None:
        self.scenario, self.policy = scenario, policy
        layout = scenario.observation_layout
        self._sight = RobotSight(layout, scenario.max_degree, gain)
        self._time = -1.0  # before the first tick
        self._team = np.zeros((1, scenario.n_robots, *layout.shape), dtype=np.float32)
        self.reset()

    @property
    def time(self) -> float:
        """Time of the last tick since the first, s."""
        return max(self._time, 0.0)

    def act(
        self,
        bearings: ArrayLike,
        obstacles: ArrayLike = (),
        dt: float | None = None,
        *,
        weights: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """What to do until the next tick: the velocity, (d,), m/s; of a unicycle (v, ω), of a
        nonholonomic robot of space (v, ω_α, ω_β), m/s and rad/s; float64, as messages of robots
        have it. Zeros if no neighbour is seen.

        Args:
            bearings: unit vectors to the neighbours that are seen now, (k, d), in any order, in the
                robot's own frame: one that does not turn, for a single integrator; the body's, for
                robots that turn. Velocities are in the same one.
            obstacles: both edges of each obstacle that is near, (m, 2, 2), unit vectors in the same
                frame, obstacles and edges in any order; in space eight boundary rays of its cone,
                (m, 8, 3), every 45° about its middle, one after another, either way round. Each
                silhouette is narrower than π.
            dt: s since the previous tick, ignored in the first; None is the scenario's time step.
            weights: gains a_ij of the neighbours, (k,), m/s; None is what all links of the
                scenario weigh, or 1 where they differ.
            gravity: its unit direction in the same frame, (3,), of a nonholonomic robot of space.

        Raises:
            ValueError: naming the argument, its value and what would be right; nothing has changed.
        """
        elapsed = self.scenario.tau if dt is None else positive("dt", dt, "s")
        self._team[0, 0] = self._sight.rows(bearings, obstacles, weights, gravity)
        self._time = self._time + elapsed if self._time >= 0.0 else 0.0
        if isinstance(self.policy, RealTimePolicy):
            actions = self.policy.after(elapsed, self._team, self._time)
        else:
            actions = self.policy(self._team, self._time)
        return _within_limits(np.asarray(actions[0, 0], dtype=np.float64), self.scenario)

    def reset(self) -> None:
        """Reset all memory; the next tick is the first."""
        self._time = -1.0
        self._sight.forget()
        if hasattr(self.policy, "reset"):
            self.policy.reset()


class RobotPolicy(OneRobot):
    """One robot that ticks in its own time, and knows nothing but its own bearings.

    Where every tick comes one time step after the previous one, it does what a robot of a batch
    does. The scenario describes the team: how many robots, which gains, which merge radius. Its
    ``time_step`` is the longest that a velocity may be held; see to it that the next tick, or a
    watchdog that stops the robot, comes by then (docs/robot.md).

    Args:
        scenario: whose robot this is, any but a double integrator; a Scenario, a name or a file.
        policy: a name of ``baselines.names(scenario)`` of the kinds law, rule or learned; the path
            of a run, of a checkpoint or of an exported network, as a Path or as "learned:PATH"; or
            a policy.
        options: of a policy that is named. Errors are as of ``act``.
    """

    def __init__(
        self, scenario: ScenarioLike, policy: str | Path | Policy = "learned", **options: Any
    ) -> None:
        scenario = resolve(scenario)
        check_steerable(scenario, "a RobotPolicy steers")
        if isinstance(policy, Path):
            policy = f"{registry.AT_PATH}{policy}"
        if isinstance(policy, str):
            name, policy = policy, registry.make(policy, scenario, **options)
            check_kind(name)
        elif not callable(policy):
            raise_invalid(
                "policy", policy, "a name, a Path, or a function of observations and time"
            )
        super().__init__(scenario, policy, common_gain(scenario))


def common_gain(scenario: Scenario) -> float:
    """Common edge weight, m/s; 1 if weights differ."""
    least, most = scenario.sensing_graph.extreme_weights(scenario.n_robots)
    return float(least) if least == most else 1.0


def check_kind(policy: str) -> None:
    """Raise a ValueError for the name of a policy that a single robot cannot run."""
    if (kind := registry.kind_of(policy)) not in _KINDS:
        raise ValueError(
            f"policy {policy!r} is one of the {registry.KINDS[kind]}; by name a RobotPolicy takes "
            "laws, rules and learned policies"
        )
