"""Gymnasium factories: vector environments, and one agent that controls all robots."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from ..checks import choice, floats
from ..deprecation import renamed_arguments
from ..engine.memory import RENDEZVOUS
from ..render.renderer import RENDER_MODES
from ..scenario.scenario import Scenario
from ..scenario.scenarios import ScenarioLike, resolve, with_versions
from ..scenario.start_options import seeds_of_environments
from ..simulator import Simulator
from .overrides import PlainSpec, arguments_of, check_overrides, sorted_overrides
from .vector_env import (
    SINGLE_ENV,
    Info,
    RendezvousVectorEnv,
    SingleEnvMixin,
    check_single_env,
    of_first_env,
)
from .vector_wrappers import HeadingVectorWrapper

__all__ = [
    "RendezvousEnv", "RendezvousVectorEnv", "make_env", "make_heading_env", "make_heading_vec",
    "make_vec",
]  # fmt: skip


class RendezvousEnv(SingleEnvMixin, PlainSpec, gymnasium.Env[Any, Any]):
    """Gymnasium environment of n robots controlled by a single agent.

    Observations (n, rows, d), actions (n, a), the team reward and infos are those of
    ``RendezvousVectorEnv`` without the batch axis and masks.

    Args:
        vector_env: a vector environment with B = 1 and ``AutoresetMode.DISABLED``, wrapped or not.

    Raises:
        ValueError: for another environment.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": RENDER_MODES
    }

    @renamed_arguments(teams="vector_env")
    def __init__(self, vector_env: VectorEnv[Any, Any, Any]) -> None:
        self._hold(vector_env)
        self.observation_space = vector_env.single_observation_space
        self.action_space = vector_env.single_action_space

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Start a new episode; without a seed the next one of the last seed.

        Raises:
            ValueError: for an invalid option or seed; the state is unchanged.
        """
        observations, infos = self._reset(seeds_of_environments(seed, 1), options)
        return observations[0], of_first_env(infos)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Advance by one step τ; errors as ``RendezvousVectorEnv.step``."""
        table, simulator = floats("action", action, np.float32)[None], self.simulator
        over = not simulator.all_running and bool(simulator.ended[0])
        observations, rewards, ends, cuts, infos = self.vector_env.step(table)
        ended = bool(ends[0]), bool(cuts[0])
        if over:  # an environment that has ended stays so
            met = simulator.status[0] == RENDEZVOUS
            ended = bool(met), not met
        return observations[0], float(rewards[0]), *ended, of_first_env(infos)


def make_vec(
    scenario: ScenarioLike = "fig3",
    num_envs: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    num_threads: int | None = None,
    max_cycles: int | None = None,
    render_mode: str | None = None,
    flatten: bool = False,
    **overrides: Any,
) -> RendezvousVectorEnv:
    """Vector environment of ``num_envs`` environments of one scenario.

    ``autoreset_mode`` is documented in ``RendezvousVectorEnv``. ``num_threads`` limits the threads
    of a step; None is one per core. Other arguments and errors are those of
    ``rendezvous_env.parallel_env``; with ``flatten`` observations are (B, n, rows·d).
    """
    check_overrides(make_vec, overrides)
    mode = _autoreset_mode(autoreset_mode)
    simulator = Simulator(resolve(scenario, **overrides), num_envs, num_threads=num_threads)
    if max_cycles is not None:
        simulator.set_max_steps(max_cycles)
    return RendezvousVectorEnv(simulator, mode, render_mode, flatten)


def _autoreset_mode(given: AutoresetMode | str) -> AutoresetMode:
    """Autoreset mode from any spelling of Gymnasium: "SAME_STEP", "same_step", "SameStep"."""
    if isinstance(given, AutoresetMode):
        return given
    modes = {mode.value.lower(): mode for mode in AutoresetMode}
    spelled = given.replace("_", "").lower() if isinstance(given, str) else ""
    if spelled not in modes:
        choice("autoreset_mode", given, [mode.value for mode in AutoresetMode])
    return modes[spelled]


def make_heading_vec(
    scenario: ScenarioLike = "fig3", num_envs: int = 1, **arguments: Any
) -> HeadingVectorWrapper:
    """``make_vec`` in the vector HeadingVectorWrapper, with the arguments and errors of both.

    ``max_turn_rate`` is the wrapper's.
    """
    own = arguments_of(HeadingVectorWrapper)[1:]
    of_wrapper, of_teams = sorted_overrides(make_vec, own, arguments)
    return HeadingVectorWrapper(make_vec(scenario, num_envs, **of_teams), **of_wrapper)


def make_env(scenario: ScenarioLike = "fig3", **arguments: Any) -> RendezvousEnv:
    """Single-agent environment; arguments and errors as ``make_vec``."""
    check_single_env(arguments, "gymnasium.make_vec or rendezvous_env.make_vec")
    return RendezvousEnv(make_vec(scenario, **SINGLE_ENV | arguments))


def make_heading_env(scenario: ScenarioLike = "fig3", **arguments: Any) -> RendezvousEnv:
    """Single-agent environment with heading vectors as actions, as ``make_heading_vec``."""
    check_single_env(arguments, "gymnasium.make_vec or rendezvous_env.vector.HeadingVectorWrapper")
    return RendezvousEnv(make_heading_vec(scenario, **SINGLE_ENV | arguments))


def env_from_plain(scenario: Mapping[str, Any], render_mode: str | None = None) -> RendezvousEnv:
    """Single-agent environment of a scenario in plain data (``Scenario.to_plain``), for specs."""
    return make_env(Scenario.from_plain(scenario), render_mode=render_mode)


def register() -> None:
    """Register the Gymnasium ids, once.

    ``rendezvous/Rendezvous-v0``, ``rendezvous/RendezvousHeading-v0`` (certified headings), and
    named scenarios such as ``rendezvous/clutter-16-v1``. There is no ``max_episode_steps``, since
    the environment has its own time limit.
    """
    ids: dict[str, tuple[str, dict[str, str]]] = {
        "rendezvous/Rendezvous-v0": ("", {}),
        "rendezvous/RendezvousHeading-v0": ("heading_", {}),
    }
    ids |= {versioned: ("", {"scenario": name}) for name, versioned in with_versions().items()}
    for name, (kind, given) in ids.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"{__name__}:make_{kind}env",
                vector_entry_point=f"{__name__}:make_{kind}vec",
                kwargs=given,
            )
