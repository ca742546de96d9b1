"""Teams to train in, made from a scenario, a guarantee and a few options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from ...experiment.checks import choice, flag, number, refuse
from ...experiment.rewards import RewardWeights
from ...experiment.scenarios import ScenarioLike, resolve
from ...gymnasium_env import make_vec
from ..overrides import sorted_overrides
from ..vector_env import RendezvousVectorEnv
from ..vector_filter_wrapper import VectorFilterWrapper
from ..vector_wrappers import (
    EnergyTankWrapper,
    GainWrapper,
    HeadingVectorWrapper,
    LinkKeepingWrapper,
)
from .teams import TrainingTeams

WRAPPERS: dict[str, Any] = {
    "heading": HeadingVectorWrapper,
    "tank": EnergyTankWrapper,
    "gains": GainWrapper,
    "links": LinkKeepingWrapper,
}
"""By guarantee: theorems C, D, G and R."""
PERCEIVED = ("heading", "tank")
"""Guarantees that a shipped policy keeps."""


def training_env(
    scenario: ScenarioLike = "clutter-8",
    num_envs: int = 1,
    *,
    guarantee: str | None = "heading",
    learning_preset: bool = True,
    flatten: bool = True,
    discrete: bool = False,
    render_mode: str | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    num_threads: int | None = None,
    max_cycles: int | None = None,
    touch_penalty: float | None = None,
    **overrides: Any,
) -> TrainingTeams:
    """B teams as a generic learner wants them: a vector environment of Gymnasium.

    Robots that merge stay to the end with zero observations, without effect, earning with their
    team (``on_merge="follow"``): to a learner that takes termination for the end of all reward,
    an early meeting would look like a loss. Infos have the same keys in every step.

    With ``learning_preset`` teams earn what the shipped policies were trained with: the reward of
    ``baselines.learned.preset``, and the first touch of an obstacle costs the robot 1. Single
    integrators in the plane under "heading" or "tank" also see and do what the shipped policy
    does, and decide as often (every 0.6 s):

    | | |
    |---|---|
    | observations | what ``Perception`` shows, (B, n, size); ``env.layout.split`` takes it apart |
    | actions | (B, n, 2) in [−1, 1]: f turned to this direction, seen with x along f |
    | actions, ``discrete`` | (B, n): index of an angle φ in ``baselines.learned.guide``; 0: φ = 0 |

    An action says where f is imagined to point; from there the joined rule leads round obstacles,
    and the guarantee's filter makes of that what keeps its promise. The length does not count; no
    direction at all is straight ahead, the rule itself. Other robots and guarantees have no shipped
    policy: they see and do what the guarantee's wrapper says (for "tank" with the budget of the
    shipped policy and ``observe_level``), and a choice is held as long, 0.6 s.

    Args:
        scenario: a Scenario, the name of one (``scenarios.names()``) or the path of a TOML file.
        num_envs: B, number of teams.
        guarantee: "heading" (theorem C), "tank" (D), "gains" (G), "links" (R), or None: bare
            actions.
        learning_preset: see above; False leaves the plain wrapper and the scenario's reward.
        flatten: whether tables of observations are (B, n, rows·d), row by row, or (B, n, rows, d).
            What ``Perception`` shows is flat.
        discrete: whether robots choose among the angles of the shipped policy.
        render_mode: "human" for a window, "rgb_array" for pictures, None for neither.
        autoreset_mode: when a team that has ended begins anew; see ``RendezvousVectorEnv``.
        num_threads: most threads a step may use; None is one for each core.
        max_cycles: time limit in base steps, instead of the scenario's.
        touch_penalty: what a robot pays at its first touch in an episode; None is 1 with the
            preset, else 0.
        **overrides: arguments of the guarantee's wrapper, and fields of the scenario. ``reward``,
            here or in the scenario, holds against the preset's.

    Raises:
        TypeError: for an unknown argument or field, with the nearest known one.
        ValueError: naming an argument, its value and what would be right.
    """
    wrapper = None if guarantee is None else WRAPPERS[choice("guarantee", guarantee, WRAPPERS)]
    arguments, changes = sorted_overrides(training_env, wrapper, overrides)
    if changes.setdefault("on_merge", "follow") != "follow":
        refuse("on_merge", changes["on_merge"], "'follow' in a training environment")
    chosen = resolve(scenario, **changes)
    perceived, price = False, 0.0
    if flag("learning_preset", learning_preset):
        from baselines.learned.preset import held_arguments, preset
        from baselines.learned.robots import can_steer

        if "reward" not in changes and chosen.reward == RewardWeights():
            chosen = chosen.replace(reward=preset(guarantee).reward)
        price = preset(guarantee).touch_penalty
        perceived = guarantee in PERCEIVED and can_steer(chosen)
        if guarantee is not None and not perceived:
            arguments = held_arguments(chosen, guarantee) | arguments
    _check_form(perceived, flag("flatten", flatten), flag("discrete", discrete))
    teams: Any = make_vec(
        chosen, num_envs, autoreset_mode, num_threads, max_cycles, render_mode, flatten
    )
    if perceived and guarantee is not None:
        teams = _perceiving(teams, guarantee, discrete, arguments)
    elif wrapper is not None:
        teams = wrapper(teams, **arguments)
    if touch_penalty is not None:
        price = number("touch_penalty", touch_penalty)
    return TrainingTeams(teams, price)


def _check_form(perceived: bool, flatten: bool, discrete: bool) -> None:
    """Refuse what the robots of this environment cannot see or choose."""
    if perceived and not flatten:
        refuse("flatten", flatten, "True, or learning_preset False: what Perception shows is flat")
    if discrete and not perceived:
        refuse(
            "discrete",
            discrete,
            "False: the shipped policy's choices are for single integrators in the plane with "
            "learning_preset True and guarantee 'heading' or 'tank'",
        )


def _perceiving(
    env: RendezvousVectorEnv, guarantee: str, discrete: bool, arguments: Mapping[str, Any]
) -> VectorFilterWrapper:
    """Teams that see and do what the shipped policy of a guarantee does."""
    from baselines.learned.perceiving import PerceivingTeams
    from baselines.learned.preset import settings_for

    settings = settings_for(env.scenario, guarantee, arguments)
    return PerceivingTeams(env, settings, discrete=discrete)
