"""The environment as pure functions: ``make``, ``reset`` and ``step``."""

from dataclasses import dataclass
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ..checks import check_int, check_shape, choice, flag, raise_invalid, short_repr
from ..engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from ..envs.guarantee import settings_of
from ..envs.gymnasium_env import _autoreset_mode
from ..envs.overrides import sorted_overrides
from ..envs.spaces import action_box, choice_box, observation_box, team_box
from ..limits import MAX_TEAMS
from ..obstacles.contact import IGNORE
from ..rewards.terms import team_reward
from ..robots.motion import FREE, motion_of
from ..robots.robot_models import constants_of
from ..safety.heading import HeadingFilter
from ..safety.safety_filter import FILTERS, SafetyFilter
from ..safety.tank import EnergyTank
from ..scenario.scenario import CONTACT_MODES, Scenario
from ..scenario.scenarios import ScenarioLike, resolve
from ..scenario.start_options import seeds_of_environments
from ..sensors.imperfections import imperfections_of
from .arrays.array_form import Array, array_form, norm_of
from .arrays.selection import divided
from .arrays.some_envs import for_envs
from .coverage import check_covered, raise_not_covered
from .filters.heading import Heading
from .filters.tank import Tank
from .imperfections import SensorModel, delayed
from .initial_conditions import InitialConditionSampler
from .merging import MergeArrays, Merging
from .obstacles.contact import ObstacleContact
from .obstacles.fields import Fields
from .sensing import clearances, lyapunov, sense, sense_obstacles

Info = dict[str, Array]

_ROUNDING = 1.0 + 1e-4  # far above that of positions in float32
_LONGEST = 1e15  # action whose square float32 can represent, beyond every limit


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """State of one environment, or of B, along the last axis of every array."""

    positions: Array
    """p_i, (n, d), m; of a merged robot, where it merged."""
    frames: Array
    """R_i, local → global, (n, d·d), row by row; (n, 0) for robots with angles."""
    memory: Array
    """Angles, rad, or velocity, m/s, (n, k)."""
    weights: Array
    """a_ij after merges, (n, n), m/s."""
    merged_into: Array
    """(n,), index of the surviving agent of each robot; its own while it is active."""
    seed: Array
    """(2,) uint32, the upper and lower half of the seed."""
    episode: Array
    """Number of the episode of this seed, from 0."""
    status: Array
    """0 running, 1 rendezvous, 2 time limit."""
    steps: Array
    """Steps done in this episode."""
    path_length: Array
    """Sum of the path lengths of all robots, m."""
    lyapunov: Array
    """V, m²/s."""
    initial_lyapunov: Array
    """V at the start of the episode, m²/s."""
    closest: Array
    """Smallest squared distance of neighbours, m²."""
    contacts: Array
    """Contacts in this episode, one for each robot and step."""
    clearance: Array
    """(n,), m, distance to the nearest obstacle; inf without one, and for merged robots."""
    obstacles: Any
    """Sampled obstacles of the episode; () without any."""
    past: Any
    """Last observations, for a delay, (delay + 1, n, rows, d); () without one."""
    guarantee: Any
    """State of the filter; () without one."""

    def replace(self, **changes: Any) -> "State":
        """A copy with some arrays changed."""
        return State(**{**vars(self), **changes})


class RendezvousJaxEnv:
    """A scenario as pure functions; see ``make``."""

    def __init__(
        self,
        scenario: Scenario,
        safety_filter: SafetyFilter | None,
        num_envs: int | None,
        autoreset: bool,
        differentiable: bool,
        final_obs: bool,
    ) -> None:
        check_covered(scenario)
        self.scenario, self.num_envs, self.autoreset = scenario, num_envs, autoreset
        self.differentiable, self.final_obs = differentiable, final_obs
        n = scenario.n_robots
        self.single_observation_space: Space[Any] = team_box(
            observation_box(scenario, False, safety_filter), n
        )
        self.single_action_space: Space[Any] = team_box(
            action_box(scenario) if safety_filter is None else choice_box(safety_filter), n
        )
        self._action_shape: tuple[int, ...] = self.action_space.shape or ()
        self._batch: tuple[int, ...] = () if num_envs is None else (num_envs,)
        self._dtype = jnp.result_type(float)
        self._seen_as = self._dtype if differentiable else jnp.float32
        self._filter: Heading | Tank | None = None
        if isinstance(safety_filter, EnergyTank):
            self._filter = Tank(safety_filter, self._seen_as)
        elif isinstance(safety_filter, HeadingFilter):
            self._filter = Heading(safety_filter, self._seen_as)
        self._model = constants_of(scenario)
        motion = motion_of(type(self._model))
        assert motion is not None  # robot models are described before they are registered
        self._motion = {name: array_form(getattr(motion, name)) for name in _EQUATIONS}
        has_obstacles = scenario.observation_layout.obstacle_slots > 0
        self._fields = Fields(scenario, self._dtype) if has_obstacles else None
        self._starts = InitialConditionSampler(scenario, self._fields, self._dtype)
        exact = imperfections_of(scenario.sensing, n) is None
        self._sensor = None if exact else SensorModel(scenario)
        one_way = scenario.sensing_graph.directed
        self._merge = Merging(
            n,
            scenario.merge_radius,
            one_way,
            differentiable,
            self._fields,
            scenario.merges_through,
        )
        mode = CONTACT_MODES.index(scenario.obstacle_contact)
        self._contact: ObstacleContact | None = None
        if self._fields is not None and mode != IGNORE:
            self._contact = ObstacleContact(self._fields, self._model, mode, differentiable)
        # inlined in a caller's program, which XLA compiles faster than a nested one
        self._begin = jax.jit(self._begin_all, inline=True)
        self._go = jax.jit(self._step_all, inline=True)

    @property
    def observation_space(self) -> Space[Any]:
        """Observations (n, rows, d), or (B, n, rows, d)."""
        return self._batched(self.single_observation_space)

    @property
    def action_space(self) -> Space[Any]:
        """Actions (n, a), or (B, n, a)."""
        return self._batched(self.single_action_space)

    def _batched(self, space: Space[Any]) -> Space[Any]:
        return space if self.num_envs is None else batch_space(space, self.num_envs)

    def reset(self, seed: Any) -> tuple[Array, State]:
        """Begin the first episode of a seed.

        Args:
            seed: an integer s, for s + i in environment i, or a sequence of B. Initial conditions
                are then those of the engine. A JAX key samples a seed for each environment; a JAX
                array of two uint32 is always a key. Under ``jit`` and ``vmap`` it is a key.

        Returns:
            Observations (n, rows, d), or (B, n, rows, d), and the state.

        Raises:
            ValueError: for an invalid seed.
        """
        return self._begin(self._words(seed))

    def _words(self, seed: Any) -> Array:
        if isinstance(seed, jax.Array) and (
            jnp.issubdtype(seed.dtype, jax.dtypes.prng_key)
            or (seed.dtype == jnp.uint32 and seed.shape == (2,))
        ):
            return jax.random.bits(seed, (2, *self._batch), jnp.uint32)
        if isinstance(seed, jax.core.Tracer):
            raise_invalid(
                "seed",
                seed,
                "a JAX key under jit and vmap, as of jax.random.split(jax.random.key(0), 8)",
            )
        given = np.asarray(seed) if isinstance(seed, jax.Array) else seed
        seeds = seeds_of_environments(given, self.num_envs or 1)
        if seeds is None or None in seeds:  # an environment has no seed to keep, as in the engine
            raise_invalid("seed", seed, "an integer, or one for each environment, or a JAX key")
        numbers = np.array(seeds, np.uint64)
        words = np.stack([numbers >> np.uint64(32), numbers & np.uint64(0xFFFFFFFF)])
        return jnp.asarray(words.astype(np.uint32).reshape(2, *self._batch))

    def step(
        self, key: Any, state: State, action: Any
    ) -> tuple[Array, State, Array, Array, Array, Info]:
        """Advance by one step τ.

        Args:
            key: unused; the signature is that of gymnax.
            state: of ``reset`` or ``step``.
            action: (n, a), or (B, n, a); actions of merged robots are ignored.

        Returns:
            Observations, state, team reward, termination (rendezvous), truncation (time limit),
            and infos: ``robot_rewards``, ``active``, ``merged_into``, ``contact`` and ``clearance``
            (m), (n,); ``success``, ``time`` (s), ``contacts``, ``path_length`` (m) and ``lyapunov``
            (m²/s) at the end of the step, before an autoreset; and with ``final_obs`` the
            observations with which an episode ended, zero where none did.

        Raises:
            ValueError: for an action of another shape, or not of real numbers.
        """
        return self._go(state, self._checked(action))

    def _checked(self, action: Any) -> Array:
        try:
            array = jnp.asarray(action)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"action is {short_repr(action)}; it must be an array of numbers"
            ) from error
        if jnp.issubdtype(array.dtype, jnp.complexfloating):
            raise_invalid("action", array.dtype, "real numbers")
        check_shape("action", array, self._action_shape)
        return array

    def _begin_all(self, seed: Array) -> tuple[Array, State]:
        zero = jnp.zeros(self._batch, jnp.int32)
        number = jnp.zeros(self._batch, self._dtype)
        start, n = self._starts(seed, zero), self.scenario.n_robots
        robots = jnp.broadcast_to(self._robots, (n, *self._batch))
        counts = {"episode": zero, "status": zero + RUNNING, "steps": zero, "contacts": zero}
        clearance = jnp.full((n, *self._batch), jnp.inf, self._dtype)
        totals = dict.fromkeys(("path_length", "lyapunov", "initial_lyapunov", "closest"), number)
        begun = State(
            **start._asdict(), merged_into=robots, seed=seed, clearance=clearance, **counts,
            **totals, past=self._no_past(), guarantee=(),
        )  # fmt: skip
        if self._filter is not None:
            begun = begun.replace(guarantee=self._forgotten())
        seen, state = self._look(begun)
        return self._env_first(seen), state.replace(initial_lyapunov=state.lyapunov)

    def _no_past(self) -> Any:
        delay, sensed = self.scenario.delay_steps, self.scenario.observation_layout.obstacles.stop
        if delay == 0:
            return ()
        shape = delay + 1, self.scenario.n_robots, sensed, self.scenario.dim, *self._batch
        return jnp.zeros(shape, self._seen_as)

    @property
    def _robots(self) -> Array:
        robots = jnp.arange(self.scenario.n_robots, dtype=jnp.int32)
        return robots.reshape(-1, *[1] * len(self._batch))

    def _forgotten(self) -> Any:
        n, d = self.scenario.n_robots, self.scenario.dim
        assert self._filter is not None
        return self._filter.begin(n, d, self._batch, self._dtype)

    def _env_first(self, rows: Array) -> Array:
        """Rows (n, rows, d, *batch) with the environment axis first."""
        return jnp.moveaxis(rows, -1, 0) if self._batch else rows

    def _step_all(
        self, state: State, action: Array
    ) -> tuple[Array, State, Array, Array, Array, Info]:
        took_part, running = state.merged_into == self._robots, state.status == RUNNING
        before = state
        state, contact = self._move(state, action, took_part & running)
        touched = jnp.sum(contact, axis=0, dtype=jnp.int32)
        state = state.replace(contacts=state.contacts + touched)
        costs = self._costs(contact)
        if isinstance(self._filter, Tank):
            levels = self._filter.update(state.guarantee, contact, state.merged_into, running)
            state = state.replace(guarantee=levels)
        active = state.merged_into == self._robots
        steps = state.steps + running
        met = running & (jnp.sum(active, axis=0) == 1)
        over = running & ~met & (steps >= self.scenario.max_steps)
        ended, infos = met | over, {}
        status = jnp.where(met, RENDEZVOUS, jnp.where(over, TIME_OUT, state.status))
        state = state.replace(steps=steps, status=status.astype(jnp.int32))
        infos["time"] = steps * self.scenario.tau
        infos["path_length"], infos["success"] = state.path_length, state.status == RENDEZVOUS
        infos["contacts"] = state.contacts
        if self.autoreset:
            last, state, last_infos = self._end(state, ended)
            infos |= last_infos
        seen, state = self._look(state, running)
        now, closeness = state.lyapunov, self._closeness(state)
        if self.autoreset:
            now = jnp.where(ended, last[0], now)
            closeness = jnp.where(ended, last[1], closeness)
            contact &= ~ended
            first = jnp.where(ended, state.lyapunov, state.initial_lyapunov)
            state = state.replace(initial_lyapunov=first)
        infos["lyapunov"] = now
        reward = array_form(team_reward)(
            divided(before.lyapunov - now, before.initial_lyapunov),
            1.0 / self.scenario.max_steps, touched.astype(self._dtype), closeness, met,
            self.scenario.reward.built_in,
        )  # fmt: skip
        reward = jnp.where(running, reward, 0.0)
        follows = self.scenario.on_merge == "follow"
        robot_rewards = jnp.where(follows | took_part, reward, 0.0)
        infos |= {
            "robot_rewards": self._env_first(robot_rewards),
            "active": self._env_first(state.merged_into == self._robots),
            "merged_into": self._env_first(state.merged_into),
            **{key: self._env_first(cost) for key, cost in costs.items()},
            "contact": self._env_first(contact),
            "clearance": self._env_first(state.clearance),
        }
        return self._env_first(seen), state, reward, met, over, infos

    def _costs(self, contact: Array) -> Info:
        """Costs of the step by key, (n, *batch), as ``rewards.costs``."""
        each = {"contact": contact.astype(self._dtype)}  # links are lost by merging only
        names = self.scenario.costs
        costs = {f"cost_{name}": each.get(name, jnp.zeros_like(each["contact"])) for name in names}
        if names:
            costs["cost"] = sum(costs.values(), jnp.zeros_like(each["contact"]))
        return costs

    def _closeness(self, state: State, recompute: bool = False) -> Array:
        """Σ_i max(0, 1 − clearance_i/range), see ``team_reward``; 0 where it has no weight.

        ``recompute`` is whether the clearances have to be computed.
        """
        if self._fields is None or self.scenario.reward.clearance_penalty == 0.0:
            return jnp.zeros_like(state.lyapunov)
        clearance = state.clearance
        if recompute:
            world = self._fields.world(state.obstacles, state.status.ndim)
            active = state.merged_into == self._robots
            clearance = clearances(self._fields.shapes, world, state.positions, active)
        near = jnp.maximum(0.0, 1.0 - clearance / self.scenario.obstacle_range)
        return jnp.sum(near, axis=0)

    def _frames_of(self, state: State) -> Any:
        """Frames as tuples of arrays (n, *batch)."""
        fixed = tuple(state.frames[:, k] for k in range(state.frames.shape[1]))
        memory = tuple(state.memory[:, k] for k in range(state.memory.shape[1]))
        frame = self._motion["frame"](self._model, fixed, memory)
        shape = state.merged_into.shape  # an entry may be a constant
        return tuple(jnp.broadcast_to(jnp.asarray(entry, self._dtype), shape) for entry in frame)

    def _rescaled(self, action: Array) -> Array:
        """Shorten actions (n, a, *batch) whose square overflows float32, as limits do in float64.

        Inputs of the filter, of which only the direction counts, are also lengthened.
        """
        if self._dtype != jnp.float32 or self.scenario.model.nonholonomic:
            return action
        largest = jnp.max(jnp.abs(action), axis=1, keepdims=True)
        least = 0.0 if self._filter is None else 1.0 / _LONGEST
        return action * divided(jnp.clip(largest, least, _LONGEST), largest)

    def _move(self, state: State, action: Array, acting: Array) -> tuple[State, Array]:
        """Motion, merges and memory of the robots that act, and their contacts."""
        action = jnp.moveaxis(action, 0, -1) if self._batch else action
        action = action.astype(self._seen_as).astype(self._dtype)
        memory = state.guarantee
        action = self._rescaled(action)
        if self._filter is not None:
            action, memory = self._filter.apply(action, memory)
            action = action.astype(self._seen_as).astype(self._dtype)
        inputs = tuple(jnp.where(acting, action[:, k], 0.0) for k in range(action.shape[1]))
        frame = self._frames_of(state)
        kept = tuple(state.memory[:, k] for k in range(state.memory.shape[1]))
        way, length = self._motion["propose"](self._model, inputs, frame, kept)
        way = tuple(jnp.where(acting, part, 0.0) for part in way)
        ways, length = jnp.stack(way, axis=1), jnp.where(acting, length, 0.0)
        contact, met = jnp.zeros(acting.shape, bool), cast(Any, FREE)
        if self._contact is not None:
            near = acting & (state.clearance < length * _ROUNDING + self._contact.margin)
            curve = inputs, frame, kept
            ways, contact = self._contact(state.obstacles, near, state.positions, ways, curve)
            way = tuple(ways[:, k] for k in range(ways.shape[1]))
            length = jnp.where(contact, norm_of(way), length)
            met = jnp.where(contact, self._contact.outcome, FREE)
        moving = MergeArrays(
            state.positions, ways, length, state.weights, state.merged_into, state.obstacles
        )
        reach = (self.scenario.merge_radius + 2.0 * jnp.max(length, axis=0)) * _ROUNDING
        near = (state.status == RUNNING) & (state.closest < reach * reach)
        free = moving._replace(positions=moving.positions + moving.displacements, obstacles=())
        moved = for_envs(near, self._merge, moving, free, self.differentiable)
        if kept:
            after = self._motion["update"](self._model, inputs, frame, kept, way, met)
            runs = state.status == RUNNING
            after = [jnp.where(runs, new, old) for new, old in zip(after, kept, strict=True)]
            state = state.replace(memory=jnp.stack(after, axis=1))
        return state.replace(
            positions=moved.positions,
            weights=moved.weights,
            merged_into=moved.merged_into,
            path_length=state.path_length + jnp.sum(moved.lengths, axis=0),
            guarantee=memory,
        ), contact

    def _end(self, state: State, ended: Array) -> tuple[tuple[Array, Array], State, Info]:
        """Begin the next episode where one has ended.

        Also returns V and closeness at its end, and its last observations.
        """
        changing = "positions", "frames", "memory", "weights", "obstacles"
        begun = {name: getattr(state, name) for name in changing}
        zero, seen = jnp.zeros_like(state.lyapunov), {}
        if self.final_obs:
            shape = (*(self.single_observation_space.shape or ()), *self._batch)
            seen = {"final_obs": jnp.zeros(shape, self._seen_as)}

        def renew(old: State) -> Any:
            new = self._starts(old.seed, old.episode + 1)._asdict()
            if not self.final_obs:
                last = lyapunov(old.positions, old.weights), self._closeness(old, recompute=True)
                return last, new, {}
            rows, after = self._look(old, jnp.ones(old.status.shape, bool))
            return (after.lyapunov, self._closeness(after)), new, {"final_obs": rows}

        otherwise = (zero, zero), begun, seen
        last, begun, seen = for_envs(ended, renew, state, otherwise, self.differentiable)
        state = state.replace(
            **begun,
            merged_into=jnp.where(ended, self._robots, state.merged_into),
            episode=jnp.where(ended, state.episode + 1, state.episode),
            status=jnp.where(ended, RUNNING, state.status),
            steps=jnp.where(ended, 0, state.steps),
            contacts=jnp.where(ended, 0, state.contacts),
            path_length=jnp.where(ended, 0.0, state.path_length),
        )
        if self._filter is not None:
            memory = jax.tree.map(
                lambda new, old: jnp.where(ended, new, old), self._forgotten(), state.guarantee
            )
            state = state.replace(guarantee=memory)
        return last, state, {name: self._env_first(rows) for name, rows in seen.items()}

    def _look(self, state: State, advances: Any = False) -> tuple[Array, State]:
        """Observations of all robots, (n, rows, d, *batch), and the state with its V.

        ``advances`` is whether an environment (*batch) has done a step since its last observation.
        """
        layout, n = self.scenario.observation_layout, self.scenario.n_robots
        keys, sensor = None, self._sensor
        if sensor is not None:
            keys = sensor.keys(state.seed, state.episode, state.steps)
        frame = self._frames_of(state)
        frames = jnp.stack(frame, axis=1)
        senses = self._seen_as, sensor, keys
        sight = sense(state.positions, frames, state.weights, layout.neighbour_slots, *senses)
        rows, clearance = sight.rows, state.clearance
        ndim = state.merged_into.ndim - 1
        robots = jnp.arange(n).reshape(n, *[1] * ndim)
        if self._fields is not None:
            world, active = self._fields.world(state.obstacles, ndim), state.merged_into == robots
            edges, clearance = sense_obstacles(
                self._fields.shapes, world, state.positions, frames, active, sight.net_bearings,
                self.scenario.obstacle_range, *senses,
            )  # fmt: skip
            rows = jnp.concatenate([rows, edges], axis=1)
        past = state.past
        if self.scenario.delay_steps > 0:
            past, rows = delayed(past, rows, state.steps == 0, advances)
            rows = jnp.where((state.merged_into == robots)[:, None, None], rows, 0.0)
        if self.scenario.model.senses:
            kept = tuple(state.memory[:, k] for k in range(state.memory.shape[1]))
            infos = self._motion["sense"](self._model, frame, kept)
            own = jnp.stack([jnp.broadcast_to(part, frame[0].shape) for part in infos], axis=1)
            own = jnp.where((state.merged_into == robots)[:, None], own, 0.0)
            rows = jnp.concatenate([rows, own[:, None].astype(rows.dtype)], axis=1)
        memory = state.guarantee
        if self._filter is not None:
            rows, memory = self._filter.observe(rows, memory)
        return rows, state.replace(
            lyapunov=sight.lyapunov, closest=sight.closest, clearance=clearance, past=past,
            guarantee=memory,
        )  # fmt: skip


_EQUATIONS = ("propose", "update", "frame", "sense")
_COVERED: dict[str, Any] = {"heading": HeadingFilter, "tank": EnergyTank}
"""Filters of ``safety`` by name."""


def make(
    scenario: ScenarioLike = "cloud-8",
    guarantee: str | None = None,
    *,
    num_envs: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.DISABLED,
    differentiable: bool = False,
    final_obs: bool = False,
    **options: Any,
) -> RendezvousJaxEnv:
    """Create an environment of pure functions ``reset`` and ``step``.

    Numbers are float64 where ``jax_enable_x64`` is set when this is called, else float32.

    Args:
        scenario: as for ``rendezvous_env.make_vec``.
        guarantee: "heading" for the heading filter (theorem C), "tank" for the energy tank
            (theorem D); actions are then its inputs. None for no filter.
        num_envs: B environments, which is faster than ``vmap``; None for one without a batch axis.
            In the arrays of the state the environment axis is last.
        autoreset_mode: DISABLED, an environment that has ended stops; or SAME_STEP.
        differentiable: whether gradients pass through merges and contacts, in loops of fixed
            length, and actions and observations are not rounded to float32.
        final_obs: whether infos contain the last observation of episodes that end.
        **options: fields of the scenario to change, and settings of the filter.

    Raises:
        NotImplementedError: naming a field that the JAX form does not cover. Contact of robots with
            inertia is not differentiable.
        TypeError: for an unknown option, with the nearest known one.
        ValueError: for an invalid value.
    """
    if guarantee is not None:
        choice("guarantee", guarantee, FILTERS)
        if guarantee not in _COVERED:
            raise_not_covered("guarantee", repr(guarantee))
    settings = [] if guarantee is None else settings_of(_COVERED[guarantee])
    of_filter, fields = sorted_overrides(make, settings, options)
    resolved = resolve(scenario, **fields)
    check_covered(resolved)
    mode = _autoreset_mode(autoreset_mode)
    if mode is AutoresetMode.NEXT_STEP:
        raise_not_covered("autoreset_mode", str(mode))
    contact = resolved.observation_layout.obstacle_slots and resolved.obstacle_contact != "ignore"
    if flag("differentiable", differentiable) and contact and resolved.model.keeps_velocity:
        raise_not_covered("differentiable", "True with contact of robots with inertia")
    if num_envs is not None:
        check_int("num_envs", num_envs, 1, MAX_TEAMS)
    safety_filter = None
    if guarantee is not None:
        safety_filter = _COVERED[guarantee](resolved, 1, **of_filter)
    return RendezvousJaxEnv(
        resolved,
        safety_filter,
        num_envs,
        mode is AutoresetMode.SAME_STEP,
        differentiable,
        flag("final_obs", final_obs),
    )
