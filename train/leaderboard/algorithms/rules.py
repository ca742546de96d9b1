"""Analytic laws and rules, without training."""

from functools import partial
from typing import Any, Literal

from gymnasium.vector import AutoresetMode

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.scenario.scenario import Scenario

from ... import policies
from ..environments import COSTS
from ..playing import EvaluationSetup
from ..registry import Algorithm, Budget


def _player(name: str, field: Scenario, num_envs: int) -> EvaluationSetup:
    scenario = field.replace(costs=COSTS)
    env = rv.make_vec(scenario, num_envs, AutoresetMode.DISABLED, num_threads=1)
    return EvaluationSetup(env, baselines.make(name, scenario))


def _rule(name: str, word: str, guarantee: Literal["none", "heading", "tank"]) -> Algorithm:
    """Named policy, as evaluated by ``compare``."""

    def made(field: Scenario, seed: int, budget: Budget) -> Any:
        return partial(_player, name, field), {"policy": name}

    def fits(field: Scenario) -> bool:
        # rules for unicycles have no gate, so V may increase
        is_kept = guarantee != "heading" or not field.model.nonholonomic
        return is_kept and name in baselines.names(field)

    about = policies.about(name).rstrip(".")
    return Algorithm(about, word, guarantee, "bearings", made, fits, learns=False)


ALGORITHMS = {
    "bearing-only": _rule("bearing-only", "law (1)", "heading"),
    "tangent-merged-tuned": _rule("tangent-merged-tuned", "rule", "heading"),
    "tank-merged": _rule("tank-merged", "rule", "tank"),
}
