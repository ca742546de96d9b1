"""A policy on board of one robot: what it measured since the last tick in, its velocity out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import positive, shown
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.experiment.scenarios import ScenarioLike, resolve

from . import policy as registry
from .policy import Policy
from .robot_sight import RobotSight

_KINDS = ("law", "rule", "learned")
"""Kinds whose policies ask neither which robot is which nor how often they were called."""
_MODELS = ("single_integrator", "unicycle")


class RobotPolicy:
    """One robot that ticks in its own time, and knows nothing but its own bearings.

    Where every tick comes one time step after the last one, it does what a robot of a batch does.
    The scenario tells what team this is: how many, which gains, how close is met. Its ``time_step``
    is the longest that a velocity may be held; see to it that the next tick, or a watchdog that
    stops the robot, comes by then (docs/robot.md).

    Args:
        scenario: whose robot this is; a Scenario, the name of one or a TOML file. Single
            integrators or unicycles in the plane.
        policy: a name of ``baselines.names(scenario)`` of the kinds law, rule or learned; the path
            of a run, of a checkpoint or of an exported network; or a policy.
        options: of a policy that is named.

    Raises:
        ValueError: naming the argument, its value and what would be right.
    """

    def __init__(
        self, scenario: ScenarioLike, policy: str | Path | Policy = "learned", **options: Any
    ) -> None:
        self.scenario = resolve(scenario)
        if self.scenario.dim != 2 or self.scenario.robot_model not in _MODELS:
            raise ValueError(
                f"scenario {self.scenario.name!r} has {self.scenario.robot_model} robots in "
                f"{self.scenario.dim}-D; a RobotPolicy steers {' and '.join(_MODELS)} robots in 2-D"
            )
        self.policy = _made(policy, self.scenario, options)
        layout = self.scenario.observation_layout
        self._sight = RobotSight(layout, self.scenario.max_degree)
        self._time = -1.0  # before the first tick
        self._team = np.zeros((1, self.scenario.n_robots, *layout.shape), dtype=np.float32)
        self.reset()

    @property
    def time(self) -> float:
        """Of the last tick since the first one, s."""
        return max(self._time, 0.0)

    def act(
        self,
        bearings: ArrayLike,
        obstacles: ArrayLike = (),
        *,
        dt: float | None = None,
        weights: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """What to do until the next tick.

        Args:
            bearings: unit vectors to the neighbours that are seen now, (k, 2), in any order, in the
                robot's own frame: one that does not turn, for a single integrator; the body's, for
                a unicycle.
            obstacles: both edges of each obstacle that is near, (m, 2, 2), unit vectors in the same
                frame, obstacles and edges in any order. Each silhouette is narrower than π.
            dt: s since the tick before; None is the scenario's time step. Of no account in the
                first tick.
            weights: gains a_ij of the neighbours, (k,), m/s; None is 1 for all.

        Returns:
            The velocity, (2,), m/s, in the same frame; of a unicycle (v, ω), m/s and rad/s. Zeros
            if no neighbour is seen.

        Raises:
            ValueError: naming the argument, its value and what would be right; nothing has changed
                then.
        """
        elapsed = self.scenario.tau if dt is None else positive("dt", dt, "s")
        self._team[0, 0] = self._sight.rows(bearings, obstacles, weights)
        self._time = self._time + elapsed if self._time >= 0.0 else 0.0
        after: Callable[..., NDArray[np.float32]] | None = getattr(self.policy, "after", None)
        if after is None:
            return self.policy(self._team, self._time)[0, 0]
        return after(elapsed, self._team, self._time)[0, 0]

    def reset(self) -> None:
        """Forget everything: the next tick is the first."""
        self._time = -1.0
        self._sight.forget()
        self.policy.reset()


def _made(policy: Any, scenario: Scenario, options: dict[str, Any]) -> Policy:
    """The policy that is meant."""
    if isinstance(policy, Path):
        from .learned.learned_policy import load

        return load(policy, scenario)
    if not isinstance(policy, str):
        if not callable(policy) or not hasattr(policy, "reset"):
            raise ValueError(
                f"policy is {shown(policy)}; it must be a name, a Path, or a policy with reset()"
            )
        made: Policy = policy
        return made
    found = registry.make(policy, scenario, **options)
    if (kind := registry.kind_of(policy)) not in _KINDS:
        raise ValueError(
            f"policy {policy!r} is one of the {registry.KINDS[kind]}, which count calls, tell "
            "robots apart or see nothing; a RobotPolicy takes laws, rules and learned policies"
        )
    return found
