"""PettingZoo: ``parallel_env``, ``env`` and ``raw_env`` of one environment."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pettingzoo.utils import wrappers
from pettingzoo.utils.env import AECEnv

from .envs.agents import RendezvousAECEnv
from .envs.overrides import check_overrides
from .envs.parallel_env import RendezvousParallelEnv
from .envs.vector_env import check_single_env
from .scenario.scenarios import ScenarioLike, resolve, with_versions

__all__ = ["RendezvousParallelEnv", "env", "parallel_env", "raw_env"]


def parallel_env(
    scenario: ScenarioLike = "fig3",
    render_mode: str | None = None,
    max_cycles: int | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> RendezvousParallelEnv:
    """Create the parallel environment, in which all robots act simultaneously.

    Args:
        scenario: a Scenario, the name of one (``scenarios.names()``), the path of a TOML file, or
            plain data (``Scenario.to_plain``).
        render_mode: "human" for a window, "rgb_array" for images, None for neither.
        max_cycles: time limit in steps, in place of the scenario's.
        flatten: whether observations are vectors (rows·d,), row by row, for libraries without
            matrix observations; ``scenario.observation_layout.split`` reads both.
        **overrides: fields of the scenario to change.

    Raises:
        TypeError: for an unknown argument or field; the message gives the closest known one.
        ValueError: for an unknown scenario or render mode, or an invalid value.
    """
    check_single_env(overrides, "rendezvous_env.make_vec")
    check_overrides(parallel_env, overrides)
    return RendezvousParallelEnv(resolve(scenario, **overrides), render_mode, max_cycles, flatten)


def env(
    *arguments: Any, **options: Any
) -> AECEnv[str, NDArray[np.float32], NDArray[np.float32] | None]:
    """Create PettingZoo's AEC environment; arguments and errors as ``parallel_env``."""
    return wrappers.OrderEnforcingWrapper(RendezvousAECEnv(parallel_env(*arguments, **options)))


raw_env = env
"""PettingZoo's unwrapped AEC environment; this one also validates the order of calls."""


def register() -> None:
    """Register ``rendezvous/rendezvous-v0`` and scenarios, ``rendezvous/clutter-16-v1``, once."""
    try:
        from pettingzoo.env_registry import registration
    except ImportError:  # PettingZoo before 1.27 has no registry
        return
    ids: dict[str, dict[str, str]] = {"rendezvous/rendezvous-v0": {}}
    ids |= {versioned: {"scenario": name} for name, versioned in with_versions().items()}
    for name, given in ids.items():
        if name not in registration.parallel_registry:
            make = f"{__name__}:parallel_env"
            registration.register("parallel", name, entry_point=make, kwargs=given)
        if name not in registration.aec_registry:
            registration.register("aec", name, entry_point=f"{__name__}:env", kwargs=given)
