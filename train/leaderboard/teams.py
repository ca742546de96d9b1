"""Teams that learners are compared in: all see, decide and are paid alike, under another safety."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.shipped import preset
from rendezvous_env.baselines.learned.training_environment import FeatureVectorEnv, ShippedPreset
from rendezvous_env.baselines.steering import can_steer

import rendezvous_env as rv
from rendezvous_env.envs.training import TrainingTeams
from rendezvous_env.rewards.custom_terms import RewardStep, reward_term
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

BOTTOMLESS = 1e6
"""Level of a tank, r D̄, that no episode drains: nothing is ever refused, nothing is promised."""
_ROUNDING = 1e-12
COSTS = ("contact", "rise", "leaderboard_risen", "leaderboard_steps")
"""Counted of every robot: touches, by how much V rose, steps in which it did, steps."""


@reward_term("leaderboard_risen")
def _risen(step: RewardStep) -> NDArray[np.bool_]:
    """(B,), whether V rose between merges while nobody touched anything: ruled out by theorem C."""
    risen: NDArray[np.bool_] = (step.rise > _ROUNDING) & ~step.contact.any(axis=1)
    return risen


@reward_term("leaderboard_steps")
def _steps(step: RewardStep) -> NDArray[np.float64]:
    return np.ones(step.contact.shape)


def can_learn(field: Scenario) -> bool:
    """Whether the learners here are for a field: one of the plane."""
    return field.dim == 2 and can_steer(field)


def guarded(field: Scenario, safety: str) -> dict[str, Any]:
    """Arguments of ``vector.training_env`` for a way of being safe; without a guarantee a tank that
    is never empty. All robots have the budget of points.
    """
    if safety == "heading":
        return {"guarantee": safety}
    level = preset("tank").settings.budget if safety == "tank" else BOTTOMLESS
    return {"guarantee": "tank", "budget": level * unit_of_tanks(field)}


class Unled(FeatureVectorEnv):
    """Robots go where they choose: no rule leads them round the obstacles that they see."""

    _pilot = None

    def _act(self) -> NDArray[np.float32]:
        seen, base = self._observed.copy(), self._base
        seen[..., base.scenario.observation_layout.obstacles, :] = 0.0
        return self.guided.apply(seen)


def unled(teams: TrainingTeams) -> TrainingTeams:
    """The same teams without the rule under their choices."""
    led: Any = teams.env
    return TrainingTeams(Unled(led.env, led.settings), teams.touch_penalty)


def teams_to_learn_in(
    field: Scenario,
    num_envs: int,
    *,
    safety: str,
    anew: bool,
    touch_penalty: float | None = None,
    wrap: Callable[[Any], Any] = lambda teams: teams,
) -> TrainingTeams:
    """B teams that see, decide (an angle every 0.6 s) and are paid as the shipped policies.

    Args:
        field: single integrators in the plane.
        num_envs: B.
        safety: "heading" (theorem C), "tank" (D, with a budget), "rule": the same over
            a tank that is never empty, or "none": without the rule, too.
        anew: whether teams begin anew in the step in which they end; else they rest.
        touch_penalty: None is that of the shipped policies.
        wrap: a wrapper between the robots and what decides, as a filter of actions.
    """
    learnt, how = ShippedPreset(), guarded(field, safety)
    guarantee = how.pop("guarantee")
    reward, price = learnt.earnings(guarantee)
    scenario = field.replace(on_merge="follow", reward=reward, costs=COSTS)
    mode = AutoresetMode.SAME_STEP if anew else AutoresetMode.DISABLED
    base = wrap(rv.make_vec(scenario, num_envs, mode, num_threads=1))
    chosen = learnt.wrap(base, guarantee, True, how)
    teams = TrainingTeams(chosen, price if touch_penalty is None else touch_penalty)
    return unled(teams) if safety == "none" else teams
