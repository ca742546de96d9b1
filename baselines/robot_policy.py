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
from .observation_builder import ObservationBuilder
from .policy import Policy, RealTimePolicy
from .steering import check_steerable

_KINDS = ("law", "rule", "learned")
"""Kinds whose policies are independent of robot indices and of the number of calls."""


_BELOW = 1.0 - 1e-15  # fraction of a limit in use, so that rounding does not exceed it


def _within_limits(action: NDArray[np.float64], scenario: Scenario) -> NDArray[np.float64]:
    """Action, (a,), reduced to the limits, which rounding to float32 may have exceeded."""
    most = _BELOW * scenario.action_bounds
    if scenario.model.nonholonomic:
        return np.clip(action, -most, most)
    speed = float(np.linalg.norm(action))
    return action * (most[0] / speed) if speed > most[0] else action


class OneRobot:
    """Single-robot interface of a policy.

    Args:
        scenario: scenario of the robot.
        policy: policy of this scenario, or of one of as many robots.
        gain: default edge weight a_ij of every neighbour, m/s.
        team: scenario of the policy, if it is another one.
        robot: index of the robot among those of the policy.
    """

    def __init__(
        self,
        scenario: Scenario,
        policy: Policy,
        gain: float = 1.0,
        team: Scenario | None = None,
        robot: int = 0,
    ) -> None:
        self.scenario, self.policy = scenario, policy
        layout, team = scenario.observation_layout, team or scenario
        self._builder = ObservationBuilder(layout, scenario.max_degree, gain)
        self._time = -1.0  # before the first tick
        shape = team.observation_layout.shape
        self._team = np.zeros((1, team.n_robots, *shape), dtype=np.float32)
        self._robot = robot
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
        rows = self._builder.rows(bearings, obstacles, weights, gravity)
        self._team[0, self._robot, : len(rows)] = rows
        self._time = self._time + elapsed if self._time >= 0.0 else 0.0
        if isinstance(self.policy, RealTimePolicy):
            actions = self.policy.after(elapsed, self._team, self._time)
        else:
            actions = self.policy(self._team, self._time)
        own = np.asarray(actions[0, self._robot], dtype=np.float64)
        return _within_limits(own[: self.scenario.action_size], self.scenario)

    def reset(self) -> None:
        """Reset all memory; the next tick is the first."""
        self._time = -1.0
        self._builder.forget()
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
            policy of the whole team or of ``scenario.of_robot(robot)``, by its ``scenario``.
        robot: index of the robot if models or limits of robots differ. The robot gets the actions
            of the policy for this index. In mixed teams, named policies are those of its model, and
            "by-model" is the law of that model.
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
        given = resolve(scenario)
        own, team, name = of_one_robot(given, name, robot)
        check_one_robot(own)
        if isinstance(policy, str):
            policy = registry.make(name, team, **options)
            check_kind(name)
        elif not callable(policy):
            raise_invalid(
                "policy", policy, "a name, a Path, or a function of observations and time"
            )
        else:
            team = _team_of(policy, given)
            _check_controls(team, own, robot)
        super().__init__(own, policy, common_gain(own), team, robot or 0)


def _team_of(policy: Policy, scenario: Scenario) -> Scenario:
    """Scenario of a policy; that of the robots if it has none."""
    team = getattr(policy, "scenario", None)
    return team if isinstance(team, Scenario) else scenario


def _check_controls(team: Scenario, own: Scenario, robot: int | None) -> None:
    """Raise a ValueError if a policy of ``team`` does not control a robot of the scenario ``own``.

    ``robot`` is its index; None is any, if all robots of the policy are equal.
    """
    remedy = "make the policy for the scenario given here, or for scenario.of_robot(i)"
    if robot is None and team.per_robot:
        raise ValueError(
            f"policy controls robots with a list of {team.per_robot[0]}; pass the scenario of the "
            "policy, and robot=i"
        )
    its_sizes, own_sizes = _sizes_of(team), _sizes_of(own)
    if its_sizes != own_sizes:
        names = "robots, dimension, neighbour slots and obstacle slots"
        raise ValueError(f"policy is for {its_sizes} {names}, the robot for {own_sizes}; {remedy}")
    its = team.of_robot(robot or 0)
    if its.robot_model != own.robot_model:
        raise ValueError(
            f"policy controls a {its.robot_model}, the robot is a {own.robot_model}; {remedy}"
        )
    if robot is not None and (its.action_bounds > own.action_bounds).any():
        limits = its.action_bounds.tolist(), own.action_bounds.tolist()
        raise ValueError(f"policy has the limits {limits[0]}, the robot {limits[1]}; {remedy}")


def _sizes_of(scenario: Scenario) -> tuple[int, int, int, int]:
    """Numbers of robots, dimensions, neighbour slots and obstacle slots."""
    layout = scenario.observation_layout
    return scenario.n_robots, scenario.dim, layout.neighbour_slots, layout.obstacle_slots


def check_one_robot(scenario: Scenario) -> None:
    """Raise a ValueError for robots that cannot be steered, or whose limits or models differ."""
    if not scenario.mixes_models:
        check_steerable(scenario, "a RobotPolicy steers")
    if scenario.per_robot:
        raise ValueError(
            f"scenario has a list of {scenario.per_robot[0]}; a RobotPolicy needs the index of one "
            "robot: pass robot=i (--robot i to export)"
        )


def of_one_robot(
    scenario: Scenario, policy: str, robot: int | None
) -> tuple[Scenario, Scenario, str]:
    """Scenario of a robot, that of its policy, and the policy's name.

    None stands for any robot, if all are equal. The policy controls the whole team if all robots
    have the same model, with the limits of the team. In mixed teams it controls robots of this
    robot's model, and "by-model" is their law. A ValueError for an index out of range.
    """
    if robot is None:
        return scenario, scenario, policy
    own = scenario.of_robot(check_int("robot", robot, 0, scenario.n_robots - 1))
    if not scenario.mixes_models:
        return own, scenario, policy
    if policy == "by-model":
        policy = LAW_OF_MODEL.get(str(own.robot_model), policy)
    return own, own, policy


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
