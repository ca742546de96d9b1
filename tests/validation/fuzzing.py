"""Fuzzing of public interfaces: inputs are rejected with a message or give finite numbers.

Every case asserts the same rule. A rejection is an exception of the documented kinds, raised by a
``raise`` of this project, with a message of readable length, and leaves the state unchanged. An
accepted input runs with finite numbers. Neither takes longer than a few seconds, except for
compilation. A few cases run by default, hundreds under the ``slow`` marker.
"""

import time
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import actions_shape
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numba.core.event import install_recorder

import baselines
import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, TimeStepWarning, vector
from rendezvous_env.envs.gymnasium_env import make_env

MANY = pytest.param(8, id="many", marks=pytest.mark.nightly)
LONGEST = 5.0
"""Maximum processor time of one call's thread, s."""
OURS = tuple(str(Path(module.__file__).parent) for module in (rv, baselines))
TEAMS = {
    "plane": Scenario(
        n_robots=3,
        obstacles=[{"centre": [1.0, 2.0], "radius": 0.5}],
        time_limit=5.0,
        graph={"kind": "random_tree", "weight_range": [0.5, 2.0]},
    ),
    "space": Scenario(n_robots=2, dim=3, obstacle_slots=1, time_limit=5.0),
    "unicycle": Scenario(n_robots=3, robot_model="unicycle", time_limit=5.0),
    "flyer": Scenario(n_robots=2, dim=3, robot_model="nonholonomic_3d", time_limit=5.0),
}
teams = st.sampled_from(sorted(TEAMS))


def guaranteed(name: str, scenario: Scenario, num_envs: int | None = None) -> Any:
    """A PettingZoo environment with a guarantee, or a batch."""
    if num_envs is None:
        return rv.GuaranteeWrapper(rv.parallel_env(scenario), name, **GUARANTEES[name])
    env = rv.make_vec(scenario, num_envs, max_cycles=3)
    return vector.GuaranteeWrapper(env, name, **GUARANTEES[name])


GUARANTEES = {
    "heading": {"decision_period": 2},
    "tank": {"decision_period": 2, "budget": 1.0, "observe_level": True},
    "gains": {},
    "links": {},
}
DOORS: dict[str, tuple[int, Callable[[Scenario, int], Any]]] = {
    "simulator": (3, Simulator),
    "pettingzoo": (1, lambda scenario, _: rv.parallel_env(scenario)),
    "aec": (1, lambda scenario, _: rv.rendezvous_v0.env(scenario)),
    "gymnasium": (1, lambda scenario, _: make_env(scenario)),
    "vector": (3, lambda scenario, b: rv.make_vec(scenario, b, max_cycles=2)),
    "same step": (2, lambda scenario, b: rv.make_vec(scenario, b, "SameStep", max_cycles=2)),
    "disabled": (2, lambda scenario, b: rv.make_vec(scenario, b, "Disabled", max_cycles=2)),
    **{name: (1, lambda scenario, _, n=name: guaranteed(n, scenario)) for name in GUARANTEES},
    **{f"vector {name}": (2, partial(guaranteed, name)) for name in GUARANTEES},
}
"""Number of environments of each kind, and their factory."""


def fuzzed(
    count: int, *values: st.SearchStrategy, kernels: bool = False, fast: bool = True
) -> Callable[[Callable[..., None]], Any]:
    """Decorator: run a check on a number of reproducible cases per effort.

    Args:
        count: cases for an effort of one.
        values: strategies of the arguments of the check.
        kernels: whether the few cases carry the marker ``kernels``.
        fast: whether the test of few cases is fast.
    """
    marks = [pytest.mark.kernels] * kernels + [pytest.mark.slow] * (not fast)
    efforts = [pytest.param(1, id="few", marks=marks), MANY]

    def decorate(check: Callable[..., None]) -> Any:
        @pytest.mark.parametrize("effort", efforts)
        def test(effort: int) -> None:
            health = list(HealthCheck)
            limits = {"max_examples": count * effort, "suppress_health_check": health}
            settings(**limits, database=None, deadline=None)(given(*values)(check))()

        test.__name__ = test.__qualname__ = check.__name__
        return test

    return decorate


def attempt(call: Callable[[], Any], *kinds: type[Exception]) -> Any:
    """Result of a call, or its rejection; any other outcome is a failure."""
    begun, refusals = time.thread_time(), kinds or (ValueError,)
    try:
        with warnings.catch_warnings(), install_recorder("numba:compile") as compiling:
            warnings.simplefilter("ignore", TimeStepWarning)
            return call()
    except refusals as error:
        assert len(str(error)) < 2000
        if isinstance(error, OSError):  # as the system puts it
            return error
        last = traceback.extract_tb(error.__traceback__)[-1]
        assert last.filename.startswith(OURS), f"refused by {last.filename}: {error!r}"
        assert (last.line or "").startswith("raise"), f"refused by {last.line}: {error!r}"
        return error
    finally:
        # what has to be compiled on the way hangs on what other tests have left on the disk
        assert compiling.buffer or time.thread_time() - begun < LONGEST


def assert_finite(*arrays: Any) -> None:
    for array in arrays:
        assert np.isfinite(array).all(), array


def play(simulator: Simulator, steps: int, seed: int = 0) -> None:
    """Steps under extreme actions; every number must be finite."""
    random, shape = np.random.default_rng(seed), actions_shape(simulator)
    largest = np.finfo(np.float32).max
    for k in range(steps):
        scale = (0.0, 1.0, largest)[k % 3]
        actions = (scale * random.uniform(-1, 1, shape)).astype(np.float32)
        outcome = simulator.step(actions)
        assert_finite(
            simulator.positions, simulator.headings, simulator.frames, simulator.lyapunov(),
            simulator.path_length, simulator.initial_lyapunov, outcome.observations,
            outcome.rewards, outcome.robot_rewards, outcome.lyapunov_before_merge,
            outcome.lyapunov_after_merge, outcome.merge_rise, outcome.merge_excess,
        )  # fmt: skip
        assert not np.isnan(outcome.clearance).any()


def start_and_play(simulator: Simulator, steps: int = 6) -> None:
    """An episode, if the initial positions fit, which may fail."""
    begun = attempt(lambda: simulator.reset(0), ValueError, RuntimeError)
    if not isinstance(begun, Exception):
        assert_finite(begun, simulator.positions, simulator.lyapunov())
        play(simulator, steps)
