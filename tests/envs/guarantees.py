"""What the tests of guarantee wrappers share: the four of them, and how they are driven."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import MODELS, five

import rendezvous_env as rv
from rendezvous_env import vector

# the two messages that a table of directions must provoke, by their exact text
SHAPE = (
    "ignore:^The observation contains negative numbers and is in the shape of a graphical "
    r"observation\. This might be a bad thing\.$:UserWarning"
)
ZEROS = r"ignore:^Observation numpy array is all zeros\.$:UserWarning"
api_suite = pytest.mark.filterwarnings(SHAPE, ZEROS)


class Guarantee(NamedTuple):
    """One of the four theorems that wrappers keep."""

    name: str
    """Of its wrappers."""
    options: dict[str, Any]
    """Settings that are not the defaults."""
    told: set[str]
    """What infos hold besides those of the base environment."""
    anywhere: bool
    """Whether it is for all robot models, or for single integrators only."""

    def around(self, env, **options):
        """A PettingZoo environment under it."""
        return getattr(rv, self.name)(env, **options)

    def around_teams(self, venv, **options):
        """A vector environment under it."""
        return getattr(vector, self.name)(venv, **options)


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
NAMES = [each.name for each in GUARANTEES.values()]
which_and_kind = pytest.mark.parametrize(
    ("which", "kind"),
    [
        (which, kind)
        for which, guarantee in GUARANTEES.items()
        for kind in MODELS
        if guarantee.anywhere or kind.startswith("single")
    ],
)


def make(which, kind="single_integrator-2d", *, changes=None, **options):
    """Five robots of a kind in PettingZoo under a guarantee."""
    scenario = five(kind, **{"spawn_size": 4.0, "time_limit": 8.0, **(changes or {})})
    return GUARANTEES[which].around(rv.parallel_env(scenario), **options)


def draw(env, random):
    """Choices of all robots alive."""
    drawn = {}
    for name in env.agents:
        space = env.action_space(name)
        drawn[name] = random.uniform(space.low, space.high).astype(np.float32)
    return drawn


def constant(env, vector):
    """The same choice for all robots alive."""
    return {name: np.array(vector, np.float32) for name in env.agents}


def tape(venv, length, seed=0):
    """Choices of all teams for so many steps."""
    space, random = venv.action_space, np.random.default_rng(seed)
    return random.uniform(space.low, space.high, (length, *space.shape)).astype(np.float32)


def same(a, b):
    """Whether two nested dicts of arrays are equal, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return a == b or (a != a and b != b)
