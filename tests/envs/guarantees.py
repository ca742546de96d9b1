"""Common parts of environment tests: the four guarantees, both APIs, comparisons."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import MODELS, five
from gymnasium.spaces import Discrete
from parameters import slow

import rendezvous_env as rv
from rendezvous_env import vector


class Guarantee(NamedTuple):
    """Guarantee of a wrapper, one of four."""

    name: str
    """Arguments of its wrappers."""
    options: dict[str, Any]
    """Settings other than the defaults."""
    told: set[str]
    """Infos in addition to those of the base environment."""
    anywhere: bool
    """Whether it supports all robot models, or single integrators only."""

    def around(self, env, **options):
        """PettingZoo environment with the guarantee."""
        return getattr(rv, self.name)(env, **options)

    def around_teams(self, venv, **options):
        """Vector environment with the guarantee."""
        return getattr(vector, self.name)(venv, **options)

    @property
    def both(self):
        """Both kinds of environment."""
        return self.around, self.around_teams


RATES = {"alignment", "lyapunov_rate"}
GUARANTEES = {
    "heading": Guarantee("HeadingVectorWrapper", {"min_alignment": 0.2}, RATES, True),
    "tank": Guarantee(
        "EnergyTankWrapper",
        {"budget": 0.3, "observe_level": True},
        RATES | {"tank", "carried_out"},
        True,
    ),
    "gains": Guarantee("GainWrapper", {"min_gain": 0.3, "max_gain": 2.0}, RATES | {"gain"}, False),
    "links": Guarantee("LinkKeepingWrapper", {"share": 0.2, "bearing_error": 0.05}, RATES, False),
}
TURNING = [("heading", "unicycle"), ("tank", "nonholonomic_3d")]
"""Guarantees of nonholonomic robots in fast tests."""
NAMES = [each.name for each in GUARANTEES.values()]
WHICH_AND_KIND = [
    (which, kind)
    for which, guarantee in GUARANTEES.items()
    for kind in MODELS
    if guarantee.anywhere or kind.startswith("single")
]
which_and_kind = pytest.mark.parametrize(
    ("which", "kind"),
    [
        pair if pair[1] == "single_integrator-2d" or pair in TURNING else slow(*pair)
        for pair in WHICH_AND_KIND
    ],
)


def make(which, kind="single_integrator-2d", *, changes=None, **options):
    """PettingZoo environment of five robots, with or without a guarantee."""
    scenario = five(kind, **{"spawn_size": 4.0, "time_limit": 8.0, **(changes or {})})
    env = rv.parallel_env(scenario)
    return GUARANTEES[which].around(env, **options) if which else env


def draw(env, random):
    """Random choices of all active robots, or of all environments."""
    if hasattr(env, "agents"):
        spaces = {name: env.action_space(name) for name in env.agents}
        return {name: _drawn(space, random) for name, space in spaces.items()}
    return _drawn(env.action_space, random)


def _drawn(space, random):
    if isinstance(space, Discrete):
        return random.integers(space.n)
    if space.dtype.kind == "i":
        return random.integers(space.low, space.high + 1)
    return random.uniform(space.low, space.high).astype(np.float32)


def constant(env, vector):
    """The same choice for all active robots."""
    return {name: np.array(vector, np.float32) for name in env.agents}


def tape(venv, length, seed=0):
    """Choices of all environments for a number of steps."""
    random = np.random.default_rng(seed)
    return np.stack([draw(venv, random) for _ in range(length)])


def same(a, b):
    """Whether two nested dicts and tuples of arrays are bitwise equal."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray):
        if a.dtype == object:
            return a.shape == b.shape and all(map(same, a, b))
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return a == b or (a != a and b != b)
