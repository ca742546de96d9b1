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
    """B environments of n robots that measure only directions and must all meet.

    What a robot does, sees and earns is specified in ``RendezvousParallelEnv``; here it stands in
    arrays, freshly allocated in every step.

    | array | shape | |
    |---|---|---|
    | observations | (B, n, rows, d) float32, or (B, n, rows·d) | zero for robots that are gone |
    | actions | (B, n, a) float32 | ignored for inactive robots and ended environments |
    | rewards | (B,) float64 | of the team; bounds as in ``rendezvous_v0`` |
    | terminations | (B,) bool | all robots have met |
    | truncations | (B,) bool | the time limit |

    Infos are those of ``RendezvousParallelEnv`` as arrays, (B,) of environments, (B, n) of robots,
    each with its mask ``_key`` (B,); ``summary`` is a dict of arrays. Two more:

    | key | shape | |
    |---|---|---|
    | robot_rewards | (B, n) float64 | team reward of robots alive before the step, else 0 |
    | active | (B, n) bool | the robot still exists on its own |

    A team that has ended, by ``autoreset_mode``:

    * NEXT_STEP: is reset in the next step, which ignores its action and earns nothing;
    * SAME_STEP: is reset at once; ``final_obs`` and ``final_info`` keep how it ended;
    * DISABLED: stands still and earns nothing until ``reset(options={"reset_mask": (B,) bool})``.

    Every end is reported once, in the step that brings it: in later steps of an ended environment
    ``terminations`` and ``truncations`` are False, so that recorders of episodes count it once.
    ``simulator.ended`` and ``infos["success"]`` give its final state.

    ``reset(seed=s)`` gives environment i the seed s + i, a list gives each its own; without a seed
    every environment continues with its next episode. Options as in ``RendezvousParallelEnv``, one
    for all environments or, but for obstacles, with a leading axis B. ``simulator`` holds the
    global state for analysis.

    ``render()`` in "rgb_array" mode returns one image per environment, as Gymnasium's
    ``RecordVideo`` for vector environments expects. They are tiles of one image (600, 600, 3) uint8
    of the first 16 environments, which ``renderer.render()`` returns as a whole; further
    environments share one blank tile.

    ``flatten`` concatenates the rows of a robot to one vector.
    """

    observation_space: Space[Any] = batched_space("single_observation_space")
    action_space: Space[Any] = batched_space("single_action_space")
    closed = True  # One that is refused is not there to be closed, as Gymnasium 1.2 does at its end

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
        """True if ``passage`` is kept, for guarantees with wrappers beneath them."""
        self.passage: tuple[NDArray[np.float32] | None, NDArray[np.float32]] | None = None
        """Copies of the actions (None at a reset) and observations that passed here last."""
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
            actions = simulator.check_actions(actions)  # before any team is reset
            simulator.restart(simulator.ended)
        told_before = None if simulator.all_running else simulator.ended
        self.advance(actions)
        observations, rewards, terminations, truncations, infos = self.tell()
        if told_before is not None:
            terminations, truncations = terminations & ~told_before, truncations & ~told_before
        if not simulator.all_running:
            ended = terminations | truncations
            if add_final_info(observations, ended, infos, mode):
                self.autoreset(ended, infos)
        add_summary(infos)
        return observations, rewards, terminations, truncations, infos

    def advance(self, actions: NDArray[np.float32]) -> StepOutput:
        """Step without autoreset and without infos, which ``tell`` returns."""
        outcome = self.outcome = self.simulator.step(actions)
        if self.records_passage:
            self.passage = np.array(actions, np.float32), outcome.observations.copy()
        self.renderer.see(outcome.contact)
        return outcome

    @property
    def can_drive(self) -> bool:
        """True if no renderer sees every step, and ``Simulator.supports_step_n``."""
        return self.render_mode is None and self.simulator.supports_step_n

    def drive(
        self,
        pilot: BatchController,
        observations: NDArray[np.float32],
        count: int,
        show: ObservationCallback | None = None,
    ) -> RolloutResult:
        """As ``advance``, ``count`` times; arguments as ``Simulator.step_n``."""
        driven = self.simulator.step_n(pilot, observations, count, show)
        self.outcome = driven.output
        return driven

    def tell(self, **more: NDArray[Any]) -> Transition:
        """Return value of ``step`` for the last step without autoreset and ``summary``.

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
        """The privileged global state of every team, (B, …) float32, see ``OneTeam.state``; a row
        is in ``single_state_space``.
        """
        return team_state(self.simulator)

    @property
    def np_random_seed(self) -> Any:
        """The seeds in use, one for each team, as Gymnasium's ``SyncVectorEnv`` has them."""
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
        """Image per environment, see the class; in "human" mode they are shown side by side.

        Errors as ``Renderer.render``.
        """
        return self.renderer.pictures()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        self.renderer.close()


def check_single_env(arguments: Mapping[str, Any], vector_form: str) -> None:
    """Refuse several environments with a ValueError that names the vector form."""
    count = arguments.get("num_envs", 1)
    if not (is_int(count) and count == 1):
        raise ValueError(
            f"num_envs is {short_repr(count)}; it must be 1, with {_DISABLED}: for more take "
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
        """Seed ``np_random`` with the seed in use, where that is another one or given ``anew``."""
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
    seen: NDArray[np.float32], ended: NDArray[np.bool_], infos: Info, mode: AutoresetMode
) -> bool:
    """Add to infos how environments ended, if they are reset at once: their last observations and
    infos, ``final_obs`` and ``final_info``; whether they are.
    """
    if mode is not AutoresetMode.SAME_STEP or not ended.any():
        return False
    summary = masked({key: infos[key].copy() for key in STANDING}, ended)
    final_obs = np.full(len(ended), None, dtype=object)
    for team in np.flatnonzero(ended).tolist():
        final_obs[team] = seen[team].copy()
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
    """Add ``summary``: the arrays of STANDING once more, and their masks; not copied, which would
    take a tenth of the step of one team.
    """
    summary = dict(zip(_IN_SUMMARY, _of_summary(infos), strict=False))
    infos["summary"], infos["_summary"] = summary, infos["_success"]


def drop_summary(infos: Info) -> None:
    """Drop it: its numbers stand among the others."""
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
    told = infos.copy()
    # to see whether a mask is left over, as ``strict`` would, takes as long as to hand all out
    told.update(zip(_names_of_masks(tuple(infos)), masks, strict=False))
    return told


@lru_cache
def _names_of_masks(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Cached names of masks."""
    return tuple(f"_{key}" for key in keys)


def of_first_env(told: Any) -> Any:
    """Infos of environment 0 without the batch axis and masks."""
    if isinstance(told, dict):
        return {key: of_first_env(values) for key, values in told.items() if key[0] != "_"}
    return told[0] if told.ndim > 1 else told[0].item()
