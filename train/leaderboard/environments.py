"""Training environments of the leaderboard: equal observations, actions and rewards per filter."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.shipped import preset
from rendezvous_env.baselines.learned.training_environment import FeatureVectorEnv, ShippedPreset
from rendezvous_env.baselines.steering import can_steer

import rendezvous_env as rv
from rendezvous_env.envs.training import TrainingVectorEnv
from rendezvous_env.rewards.custom_terms import RewardStep, reward_term
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

BOTTOMLESS = 1e6
"""Stored energy, r D̄, that no episode exhausts: nothing is refused and nothing guaranteed."""
_ROUNDING = 1e-12
COSTS = ("contact", "rise", "leaderboard_risen", "leaderboard_steps")
"""Costs per robot: contacts, increase of V, steps with an increase, steps."""


@reward_term("leaderboard_risen")
def _risen(step: RewardStep) -> NDArray[np.bool_]:
    """(B,), whether V increased between merges without any contact, which theorem C excludes."""
    risen: NDArray[np.bool_] = (step.rise > _ROUNDING) & ~step.contact.any(axis=1)
    return risen


@reward_term("leaderboard_steps")
def _steps(step: RewardStep) -> NDArray[np.float64]:
    return np.ones(step.contact.shape)


def can_learn(field: Scenario) -> bool:
    """True if the learners support a scenario: planar ones only."""
    return field.dim == 2 and can_steer(field)


def filter_arguments(field: Scenario, safety: str) -> dict[str, Any]:
    """Arguments of ``vector.training_env`` for a safety filter.

    Without a guarantee it is a tank that is never empty. All robots get the energy of single
    integrators.
    """
    if safety == "heading":
        return {"guarantee": safety}
    level = preset("tank").settings.budget if safety == "tank" else BOTTOMLESS
    return {"guarantee": "tank", "budget": level * unit_of_tanks(field)}


class WithoutBaseController(FeatureVectorEnv):
    """Environments without the base controller: robots move in the chosen direction."""

    _controller = None

    def _act(self) -> NDArray[np.float32]:
        seen, base = self._observed.copy(), self._base
        seen[..., base.scenario.observation_layout.obstacles, :] = 0.0
        return self.controller.apply(seen)


def without_base_controller(env: TrainingVectorEnv) -> TrainingVectorEnv:
    """The same environments without the base controller."""
    inner: Any = env.env
    return TrainingVectorEnv(WithoutBaseController(inner.env, inner.settings), env.contact_penalty)


def make_training_envs(
    field: Scenario,
    num_envs: int,
    *,
    safety: str,
    anew: bool,
    contact_penalty: float | None = None,
    wrap: Callable[[Any], Any] = lambda env: env,
) -> TrainingVectorEnv:
    """Create B environments with observations, decisions and rewards of the shipped policies.

    A decision is an angle every 0.6 s.

    Args:
        field: scenario with single integrators in the plane.
        num_envs: B.
        safety: "heading" (theorem C); "tank" (theorem D, with a budget); "rule": the base
            controller with a tank that is never empty; "none": without base controller.
        anew: whether an environment resets in the step in which it ends (autoreset).
        contact_penalty: cost of a first contact; None is that of the shipped policies.
        wrap: wrapper between robots and policy, such as an action filter.
    """
    learnt, how = ShippedPreset(), filter_arguments(field, safety)
    guarantee = how.pop("guarantee")
    reward, price = learnt.earnings(guarantee)
    scenario = field.replace(on_merge="follow", reward=reward, costs=COSTS)
    mode = AutoresetMode.SAME_STEP if anew else AutoresetMode.DISABLED
    base = wrap(rv.make_vec(scenario, num_envs, mode, num_threads=1))
    chosen = learnt.wrap(base, guarantee, True, how)
    env = TrainingVectorEnv(chosen, price if contact_penalty is None else contact_penalty)
    return without_base_controller(env) if safety == "none" else env
