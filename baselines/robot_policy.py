"""Policy on board one robot: from its measurements since the last tick to a velocity command."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_int, positive, raise_invalid
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from . import policy as registry
from .laws.paper_laws import LAW_OF_MODEL
from .policy import Policy, RealTimePolicy
from .robot_sight import RobotSight
from .steering import check_steerable

_KINDS = ("law", "rule", "learned")
"""Kinds whose policies are independent of robot indices and of the number of calls."""


_BELOW = 1.0 - 1e-15  # fraction of a limit, so that rounding exceeds none


def _within_limits(action: NDArray[np.float64], scenario: Scenario) -> NDArray[np.float64]:
    """Action, (a,), reduced to the limits, which rounding to float32 may have exceeded."""
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
        """Velocity command until the next tick; zeros if no neighbour is visible.

        The command is the velocity, (d,), m/s; for a unicycle (v, ω), for a 3-D nonholonomic robot
        (v, ω_α, ω_β), m/s and rad/s. It is float64, as in robot messages.

        Args:
            bearings: unit vectors to the neighbours visible now, (k, d), in any order, in the
                robot's own frame. The frame does not turn for a single integrator; it is the body
                frame for nonholonomic robots. Commands are in the same frame.
            obstacles: both edges of each sensed obstacle, (m, 2, 2), unit vectors in the same
                frame, obstacles and edges in any order. In 3-D eight boundary rays of its cone, (m,
                8, 3), every 45° about its axis, consecutive in either direction. Each angular
                extent is below π.
            dt: time since the previous tick, s, ignored in the first; None is the scenario's time
                step.
            weights: edge weights a_ij of the neighbours, (k,), m/s; None is the common weight of
                the scenario, or 1 if weights differ.
            gravity: unit direction of gravity in the same frame, (3,), of a 3-D nonholonomic robot.

        Raises:
            ValueError: naming the argument, its value and the remedy; the state is then unchanged.
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
    """Policy of one robot, called at its own rate with its own measurements.

    If every tick comes one time step after the previous one, the robot behaves as one of a batch.
    The scenario describes the team: number of robots, edge weights and merge radius. Its
    ``time_step`` is the longest hold of a velocity. Ensure that the next tick, or a watchdog that
    stops the robot, comes by then (docs/robot.md).

    Args:
        scenario: scenario of the robot, with any robot model but the double integrator; a Scenario,
            a name or a file.
        policy: a name of ``baselines.names(scenario)`` of the kinds law, rule or learned; the path
            of a run, a checkpoint or an exported network, as a Path or as "learned:PATH"; or a
            policy, which controls ``scenario.of_robot(robot)``.
        robot: index of the robot if models or limits of robots differ. It then runs policies for
            its own model, and "by-model" is the law of that model.
        options: options of a named policy. Errors are those of ``act``.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        policy: str | Path | Policy = "learned",
        *,
        robot: int | None = None,
        **options: Any,
    ) -> None:
        if isinstance(policy, Path):
            policy = f"{registry.AT_PATH}{policy}"
        name = policy if isinstance(policy, str) else ""
        scenario, name = of_one_robot(resolve(scenario), name, robot)
        check_one_robot(scenario)
        if isinstance(policy, str):
            policy = name
            name, policy = policy, registry.make(policy, scenario, **options)
            check_kind(name)
        elif not callable(policy):
            raise_invalid(
                "policy", policy, "a name, a Path, or a function of observations and time"
            )
        super().__init__(scenario, policy, common_gain(scenario))


def check_one_robot(scenario: Scenario) -> None:
    """Raise a ValueError for robots that cannot be steered, or whose limits or models differ."""
    if not scenario.mixes_models:
        check_steerable(scenario, "a RobotPolicy steers")
    if scenario.per_robot:
        raise ValueError(
            f"scenario has a list of {scenario.per_robot[0]}; a RobotPolicy needs the index of one "
            "robot: pass robot=i (--robot i to export)"
        )


def of_one_robot(scenario: Scenario, policy: str, robot: int | None) -> tuple[Scenario, str]:
    """Scenario and policy, by name, of a robot; None is any, as all are equal.

    "by-model" in a mixed team is the law of the robot's model. A ValueError for an index out of
    range.
    """
    if robot is None:
        return scenario, policy
    own = scenario.of_robot(check_int("robot", robot, 0, scenario.n_robots - 1))
    if policy == "by-model" and scenario.mixes_models:
        policy = LAW_OF_MODEL.get(str(own.robot_model), policy)
    return own, policy


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
