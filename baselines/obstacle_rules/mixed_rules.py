"""Rules for obstacles in mixed teams: each robot follows the rule of a team of its model."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask, TeamPolicy, register
from ..steering import STEERED
from .obstacle_avoidance import TunedMergedPolicy, can_pass_obstacles
from .tank_policies import TankMergedPolicy


class MixedRulePolicy(TeamPolicy):
    """Rule of each robot of a mixed team, with the memory and steering of its model.

    Robots keep their own limits, but a tank uses the lowest of the team. The tanks bound V as in
    other teams (theorem D); certified headings of robots that turn have no guarantee.

    Args:
        scenario: the experiment, a mixed team.
        rules: policy of each robot model, for the scenario of ``member_of``.
    """

    def __init__(self, scenario: Scenario, rules: dict[str, TeamPolicy]) -> None:
        self.scenario, self._rules = scenario, rules

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: that of the rules if all have the same."""
        first, *others = (rule.guarantee for rule in self._rules.values())
        return first if all(other == first for other in others) else None

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        shape = *observations.shape[:-2], self.scenario.action_size
        actions: Float32 = np.zeros(shape, np.float32)
        for model, rule in self._rules.items():
            own = np.array([name == model for name in self.scenario.robot_model])
            seen = observations[..., : rule.scenario.observation_layout.rows, :]
            actions[..., own, :] = rule.act(seen, time)[..., own, :]
        return actions

    def reset(self, mask: Mask | None = None) -> None:
        """As ``Policy.reset``."""
        for rule in self._rules.values():
            rule.reset(mask)


def member_of(scenario: Scenario, model: str) -> Scenario:
    """Scenario in which all robots of a mixed team have one model, with their own limits.

    Initial conditions are sampled.
    """
    return scenario.replace(
        robot_model=model,
        max_speed=scenario.speed_limit if scenario.max_speed is None else scenario.max_speed,
        time_step=scenario.tau,
        allow_long_step=True,
        start_positions=None,
        start_headings=None,
    )


def can_pass_obstacles_by_model(scenario: Scenario) -> bool:
    """``can_pass_obstacles`` of every robot of a team, mixed or not."""
    if not scenario.mixes_models:
        return can_pass_obstacles(scenario)
    senses = scenario.observation_layout.obstacle_slots > 0
    return senses and {*scenario.robot_model} <= {*STEERED}


def by_model(build: Callable[..., TeamPolicy]) -> Callable[..., TeamPolicy]:
    """Builder of a policy that also makes a ``MixedRulePolicy`` for a mixed team."""

    @wraps(build)
    def built(scenario: Scenario, **options: Any) -> TeamPolicy:
        if not scenario.mixes_models:
            return build(scenario, **options)
        models = sorted({*scenario.robot_model})
        rules = {name: build(member_of(scenario, name), **options) for name in models}
        return MixedRulePolicy(scenario, rules)

    return built


register("tangent-merged-tuned", fits=can_pass_obstacles_by_model, kind="rule")(
    by_model(TunedMergedPolicy)
)
register("tank-merged", fits=can_pass_obstacles_by_model, kind="tank")(by_model(TankMergedPolicy))
