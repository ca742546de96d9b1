"""Gymnasium vector environment of one scenario, and the base of single environments."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from ..checks import bools, flag, is_int, short_repr
from ..deprecation import renamed_attribute
from ..engine.batch_runner import BatchController, ObservationCallback, RolloutResult
from ..engine.memory import TIME_OUT
from ..outcome import StepOutput
from ..render.renderer import Renderer, render_metadata
from ..rewards.costs import no_costs
from ..scenario.scenario import Scenario
from ..scenario.start_options import as_options
from ..simulator import Simulator
from ..state_view import STANDING
from .overrides import PlainSpec
from .spaces import (
    batched_space,
    maybe_flatten,
    observation_box,
    state_box,
    team_action_box,
    team_box,
    team_state,
)

Info = dict[str, Any]
Transition = tuple[
    NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info
]
"""Observations, rewards, terminations, truncations and infos of B environments."""
_DISABLED = AutoresetMode.DISABLED
_IN_SUMMARY = (*STANDING, *(f"_{key}" for key in STANDING))
_of_summary = itemgetter(*_IN_SUMMARY)
SINGLE_ENV: dict[str, Any] = {"num_envs": 1, "autoreset_mode": _DISABLED}
"""Arguments of a vector environment that ``SingleEnvMixin`` holds."""


class RendezvousVectorEnv(
    PlainSpec, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]
):
    """Vectorised environment: B environments (``num_envs``) of n robots that observe bearings only.

    Observations, actions and rewards are specified in ``RendezvousParallelEnv``. Here they are
    arrays, newly allocated in every step.

    | array | shape | |
    |---|---|---|
    | observations | (B, n, rows, d) float32, or (B, n, rows·d) | zero for inactive robots |
    | actions | (B, n, a) float32 | ignored for inactive robots and ended environments |
    | rewards | (B,) float64 | team reward; bounds as in ``RendezvousParallelEnv`` |
    | terminations | (B,) bool | rendezvous: all robots have met |
    | truncations | (B,) bool | time limit |

    Infos are those of ``RendezvousParallelEnv`` as arrays: (B,) per environment, (B, n) per robot,
    each with a mask ``_key``, (B,). ``summary`` is a dict of arrays. Two further keys:

    | key | shape | |
    |---|---|---|
    | robot_rewards | (B, n) float64 | team reward of robots alive before the step, else 0 |
    | active | (B, n) bool | the robot is active (not merged) |

    After the end of an episode, ``autoreset_mode`` determines the next steps:

    * NEXT_STEP: the next step resets the environment, ignores its action and returns reward 0;
    * SAME_STEP: the same step resets it; the end is in ``final_obs`` and ``final_info``;
    * DISABLED: robots do not move and the reward is 0 until ``reset(options={"reset_mask": (B,)
      bool})``.

    Each end is reported once: in later steps of an ended environment ``terminations`` and
    ``truncations`` are False. ``simulator.ended`` and ``infos["success"]`` keep the final values.

    ``reset(seed=s)`` gives environment i the seed s + i; a list gives one seed per environment.
    Without a seed, every environment continues with its next episode. Options are those of
    ``RendezvousParallelEnv``, for all environments or with a leading axis B; "obstacles" apply to
    all. ``simulator`` holds the global state for analysis.

    ``render()`` in "rgb_array" mode returns one image per environment, as Gymnasium's
    ``RecordVideo`` for vector environments expects. These are tiles of one image, (600, 600, 3)
    uint8, of the first 16 environments, which ``renderer.render()`` returns. Further environments
    share one blank tile.

    ``flatten`` concatenates the rows of a robot into one vector.
    """

    observation_space: Space[Any] = batched_space("single_observation_space")
    action_space: Space[Any] = batched_space("single_action_space")
    closed = True  # if the constructor fails, so that Gymnasium 1.2 does not close it

    def __init__(
        self,
        simulator: Simulator,
        autoreset_mode: AutoresetMode,
        render_mode: str | None = None,
        flatten: bool = False,
    ) -> None:
        self.simulator, self.autoreset_mode = simulator, autoreset_mode
        self.scenario, self.num_envs = simulator.scenario, simulator.num_envs
        self.renderer, self.render_mode = Renderer(simulator, render_mode), render_mode
        self.metadata = render_metadata(simulator) | {"autoreset_mode": autoreset_mode}
        self.autoresets = True
        """True if this environment performs autoresets itself, not a wrapper (``autoreset``)."""
        self.outcome: StepOutput | None = None
        """Output of the last step; None before the first."""
        self.records_passage = False
        """True if ``passage`` is recorded, for guarantee wrappers with wrappers beneath."""
        self.passage: tuple[NDArray[np.float32] | None, NDArray[np.float32]] | None = None
        """Copies of the last actions (None after a reset) and observations."""
        self.flatten, n = flag("flatten", flatten), self.scenario.n_robots
        self.single_observation_space = team_box(observation_box(self.scenario, flatten), n)
        self.single_action_space = team_action_box(self.scenario)
        self.single_state_space = state_box(self.scenario)
        self.closed = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Start a new episode in all environments, or in those of ``options["reset_mask"]``, (B,).

        Returns the observations of all environments, and infos masked to those that were reset.

        Raises:
            ValueError: for an invalid option, seed or mask; the state is unchanged.
        """
        simulator, start = self.simulator, as_options(options)
        mask = start.pop("reset_mask", None)
        if mask is not None:
            mask = bools("reset_mask", mask, (self.num_envs,), "environments")
        observations = simulator.reset(seed, start, mask=mask)
        if seed is not None:
            self._np_random, self._np_random_seed = np_random(int(simulator.seeds[0]))
        self.renderer.reset()
        active = simulator.active.copy()
        infos = simulator.episode_statistics() | no_costs(self.scenario.costs, active.shape)
        infos |= {
            "robot_rewards": np.zeros(active.shape),
            "active": active,
            "merged_into": simulator.merged_into.copy(),
            "contact": np.zeros(active.shape, dtype=np.bool_),
            "clearance": simulator.clearance.copy(),
            **simulator.conditions,
        }
        which = np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask
        if self.records_passage:
            self.passage = None, observations.copy()
        infos = masked(infos, which)
        add_summary(infos)
        return maybe_flatten(observations, self.flatten), infos

    def step(self, actions: NDArray[np.float32]) -> Transition:
        """Advance every environment by one step τ with actions (B, n, a); see the class.

        Raises:
            ValueError: for another shape, or naming the robot whose action is not finite; the state
                is unchanged.
            RuntimeError: before every environment has been reset.
        """
        simulator, mode = self.simulator, self.autoreset_mode if self.autoresets else _DISABLED
        if mode is AutoresetMode.NEXT_STEP and not simulator.all_running:
            actions = simulator.check_actions(actions)  # before any environment is reset
            simulator.restart(simulator.ended)
        reported = None if simulator.all_running else simulator.ended
        self.advance(actions)
        observations, rewards, terminations, truncations, infos = self.tell()
        if reported is not None:
            terminations, truncations = terminations & ~reported, truncations & ~reported
        if not simulator.all_running:
            ended = terminations | truncations
            if add_final_info(observations, ended, infos, mode):
                self.autoreset(ended, infos)
        add_summary(infos)
        return observations, rewards, terminations, truncations, infos

    def advance(self, actions: NDArray[np.float32]) -> StepOutput:
        """Step without autoreset; ``tell`` returns its observations, rewards and infos."""
        outcome = self.outcome = self.simulator.step(actions)
        if self.records_passage:
            self.passage = np.array(actions, np.float32), outcome.observations.copy()
        self.renderer.see(outcome.contact)
        return outcome

    @property
    def can_drive(self) -> bool:
        """True if ``drive`` is available: no render mode, and ``Simulator.supports_step_n``."""
        return self.render_mode is None and self.simulator.supports_step_n

    def drive(
        self,
        controller: BatchController,
        observations: NDArray[np.float32],
        count: int,
        callback: ObservationCallback | None = None,
    ) -> RolloutResult:
        """Repeat ``advance`` ``count`` times under a controller, see ``Simulator.step_n``."""
        result = self.simulator.step_n(controller, observations, count, callback)
        self.outcome = result.output
        return result

    def tell(self, **more: NDArray[Any]) -> Transition:
        """Return value of ``step`` for the last step, without autoreset and ``summary``.

        Infos of a wrapper, (B, ...), are added.
        """
        simulator, outcome = self.simulator, self.outcome
        assert outcome is not None  # there has been a step
        infos = simulator.episode_statistics(outcome) | {
            "robot_rewards": outcome.robot_rewards,
            "active": outcome.active,
            "merged_into": simulator.copy_of_merged(),
            "contact": outcome.contact,
            "clearance": outcome.clearance,
            **simulator.costs,
            **simulator.conditions,
            **more,
        }
        terminations, truncations = infos["success"].copy(), outcome.status == TIME_OUT
        observations = maybe_flatten(outcome.observations, self.flatten)
        infos = _with_masks(infos, _all_masks(len(infos), self.num_envs).copy())
        return observations, outcome.rewards, terminations, truncations, infos

    def autoreset(self, which: NDArray[np.bool_], infos: Info) -> NDArray[np.float32]:
        """Reset the given environments (B,) and update arrays and infos of the last step in place.

        Returns its observations.
        """
        outcome = self.outcome
        assert outcome is not None  # there has been a step
        self.simulator.restart(which, outcome)
        infos |= self.simulator.episode_statistics(outcome)
        infos["merged_into"] = self.simulator.copy_of_merged()
        infos["contact"][which] = False
        infos |= self.simulator.conditions
        return maybe_flatten(outcome.observations, self.flatten)

    def state(self) -> NDArray[np.float32]:
        """Global state of every environment, (B, …) float32, see ``SingleEnvMixin.state``.

        It is privileged; each row is in ``single_state_space``.
        """
        return team_state(self.simulator)

    @property
    def np_random_seed(self) -> Any:
        """Seed of each environment, as in Gymnasium's ``SyncVectorEnv``."""
        return tuple(self.simulator.seeds.tolist()) if self.simulator.begun else None

    def __getstate__(self) -> dict[str, Any]:
        """State for pickle, without the output of the last step."""
        return vars(self) | {"outcome": None}

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copies of everything that determines the future of the environments."""
        return self.simulator.get_state()

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """As ``Simulator.set_state``."""
        self.simulator.set_state(state)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One image per environment, see the class; in "human" mode they are shown.

        Errors as ``Renderer.render``.
        """
        return self.renderer.pictures()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


def check_single_env(arguments: Mapping[str, Any], vector_form: str) -> None:
    """Raise a ValueError for several environments, with the name of the vector form."""
    count = arguments.get("num_envs", 1)
    if not (is_int(count) and count == 1):
        raise ValueError(
            f"num_envs is {short_repr(count)}; it must be 1, with {_DISABLED}; for more, use "
            f"{vector_form}"
        )


class SingleEnvMixin:
    """Mixin that exposes a vector environment with B = 1, wrapped or not, as one environment."""

    vector_env: Any
    teams = renamed_attribute("teams", "vector_env")
    simulator: Simulator
    """The global state, B = 1, for analysis."""
    scenario: Scenario
    renderer: Renderer
    render_mode: str | None
    metadata: dict[str, Any]
    _np_random: np.random.Generator | None = None
    _np_random_seed: int | None = None

    def _hold(self, vector_env: Any) -> None:
        mode = vector_env.metadata.get("autoreset_mode")
        if vector_env.num_envs != 1 or mode is not _DISABLED:
            raise ValueError(
                f"num_envs is {vector_env.num_envs} and autoreset_mode {mode}; they must be 1 and "
                f"{_DISABLED}"
            )
        self.vector_env, base = vector_env, vector_env.unwrapped
        self.simulator, self.scenario = base.simulator, base.scenario
        self.renderer, self.render_mode = base.renderer, base.render_mode
        own = {key: value for key, value in vector_env.metadata.items() if key != "autoreset_mode"}
        self.metadata = self.metadata | own

    def _reset(self, seed: Any, options: Any) -> tuple[NDArray[np.float32], Info]:
        """Start an episode; a reset mask is not an option here."""
        start = as_options(options)
        start.pop("reset_mask", None)
        begun = self.vector_env.reset(seed=seed, options=start)
        self._note_seed(anew=seed is not None)
        return begun

    def _note_seed(self, *, anew: bool) -> None:
        """Seed ``np_random`` with the seed in use, if it has changed or was given ``anew``."""
        seed = int(self.simulator.seeds[0])
        if anew or seed != self._np_random_seed:
            self._np_random, self._np_random_seed = np_random(seed)

    def state(self) -> NDArray[np.float32]:
        """Global state as one float32 vector.

        Positions (n·d, m), frames (n·d·d), weights (n·n, m/s), active (n, 0 or 1), packed obstacles
        (M·width), and the elapsed fraction of the time limit.
        """
        return self.vector_env.state()[0]

    def get_state(self) -> dict[str, Any]:
        """Copies of the running episode and all memory, for ``set_state``."""
        return self.vector_env.get_state()

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state of ``get_state``.

        Raises:
            ValueError: naming an entry that does not fit; the state is unchanged.
        """
        self.vector_env.set_state(state)
        if self.simulator.begun:
            self._note_seed(anew=False)

    def render(self) -> NDArray[np.uint8] | None:
        """Image, (600, 600, 3) uint8, in "rgb_array" mode; in "human" mode it is shown.

        Errors as ``Renderer.render``.
        """
        return self.renderer.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


def add_final_info(
    observations: NDArray[np.float32], ended: NDArray[np.bool_], infos: Info, mode: AutoresetMode
) -> bool:
    """Add ``final_obs`` and ``final_info`` to infos if ended environments are reset in this step.

    Returns True if they are.
    """
    if mode is not AutoresetMode.SAME_STEP or not ended.any():
        return False
    summary = masked({key: infos[key].copy() for key in STANDING}, ended)
    final_obs = np.full(len(ended), None, dtype=object)
    for env in np.flatnonzero(ended).tolist():
        final_obs[env] = observations[env].copy()
    kept = {key: value.copy() for key, value in infos.items() if key[0] != "_"}
    final_info = masked(kept | {"summary": summary}, ended)
    infos |= masked({"final_obs": final_obs, "final_info": final_info}, ended)
    return True


def final_value(infos: Info, over: NDArray[np.bool_], key: str) -> NDArray[Any]:
    """Info (B, ...) at the end of a step, before the autoreset of ended environments, (B,)."""
    if "final_info" not in infos:
        values: NDArray[Any] = infos[key]
        return values
    rows = over.reshape(-1, *[1] * (infos[key].ndim - 1))
    return np.where(rows, infos["final_info"][key], infos[key])


def add_summary(infos: Info) -> None:
    """Add ``summary``: the arrays of STANDING and their masks.

    They are not copied, which would take a tenth of a step of one environment.
    """
    summary = dict(zip(_IN_SUMMARY, _of_summary(infos), strict=False))
    infos["summary"], infos["_summary"] = summary, infos["_success"]


def drop_summary(infos: Info) -> None:
    """Remove ``summary``, which repeats other infos."""
    infos.pop("summary", None)
    infos.pop("_summary", None)


def masked(infos: Info, mask: NDArray[np.bool_]) -> Info:
    """Infos for a mask (B,), with ``_key`` for every key."""
    return _with_masks(infos, np.full((len(infos), len(mask)), mask))


@lru_cache(4)
def _all_masks(keys: int, num_envs: int) -> NDArray[np.bool_]:
    """Masks of all environments, (keys, B), to copy, which is faster than filling."""
    return np.ones((keys, num_envs), np.bool_)


def _with_masks(infos: Info, masks: NDArray[np.bool_]) -> Info:
    """Infos with ``_key`` for every key, from masks (keys, B)."""
    with_masks = infos.copy()
    # ``strict`` would double the time
    with_masks.update(zip(_names_of_masks(tuple(infos)), masks, strict=False))
    return with_masks


@lru_cache
def _names_of_masks(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Cached names of masks."""
    return tuple(f"_{key}" for key in keys)


def of_first_env(infos: Any) -> Any:
    """Infos of environment 0 without the batch axis and masks."""
    if isinstance(infos, dict):
        return {key: of_first_env(values) for key, values in infos.items() if key[0] != "_"}
    return infos[0] if infos.ndim > 1 else infos[0].item()
