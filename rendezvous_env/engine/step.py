"""One step of B environments: its stages and their order.

From the action to the new observation, over the blocks of one thread after another:

    take_commands               commands in execution, with asynchronous activation
    disturb_commands            crashes, adversaries, slip and disturbances
    propose_motion              displacement of every robot, applied where no contact is possible
    move_obstacles              obstacles that move, and contacts with all
    stop_at_obstacles           exact contacts, where an obstacle is within reach, if none moves
    merge_robots, pack_robots   exact merges, or bodies that touch, where robots are within reach
    settle_merged               positions of robots that merged beside moving obstacles
    update_robots               memory and frames of robot models
    turn_frames                 drift of local frames
    update_links                arcs that change with time
    sense_pairs, sense_links    bearings of neighbours, V, the closest pair
    sum_bearings                net bearings, for adversaries
    sense_discs, sense_shapes   angular extents of obstacles, clearance
    sense_indexed               instead of both, for many obstacles
    apply_noise                 range, field of view, random errors
    remember_…                  memories of detection and of noise
    apply_effects               blind zone, detection, errors with a memory, outliers
    write_observations          from lanes to one array for each environment
    apply_occlusion             occlusion, compact rows, samples, delay
    hide_from_blind             no rows for robots with a failed sensor
    conclude_step               reward, rendezvous, time limit

Each stage is a separate kernel with the arrays it uses as arguments, compiled on first use. Stages
that a scenario does not need are skipped. Between stages numbers are in the scratch memory of a
thread. An observation without a step omits the stages of motion and the last.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point, kernel
from ..graphs.edges import DENSE
from ..obstacles.contact import IGNORE
from ..obstacles.moving import Traffic
from ..outcome import StepOutput
from ..physics.random_streams import ignore_overflow
from ..robots.activation import ActivationRules
from ..robots.events import EventRules
from ..robots.motion import frame_turns
from ..sensors.imperfections import (
    changes_lanes,
    changes_silhouettes,
    changes_singles,
    columns_of,
    table_of,
)
from .memory import Robot, is_near
from .memory_layout import Scratch
from .preparation import Constants, Sensor
from .stages.apply_effects import apply_effects, turn_observers, turn_silhouettes
from .stages.apply_noise import apply_noise, apply_noise_to_silhouettes, round_silhouettes
from .stages.apply_occlusion import apply_occlusion, close_rows, delay_observations
from .stages.collide import (
    merge_robots,
    pack_robots,
    reaches,
    stop_at_obstacles,
    stop_curves_at_obstacles,
)
from .stages.commands import (
    disturb_commands,
    hide_from_blind,
    sum_bearings,
    take_commands,
    turn_frames,
)
from .stages.conclude import conclude_step
from .stages.move_obstacles import move_obstacles, settle_merged
from .stages.propose import propose_motion, refresh_frames, update_robots
from .stages.remember import hold_observations, remember_detection, remember_errors
from .stages.sense_neighbours import hide_docked, sense_links, sense_pairs, update_links
from .stages.sense_obstacles import (
    measure_clearance,
    sense_discs,
    sense_indexed,
    sense_shapes,
)
from .stages.write_observations import sense_oneself, write_observations, write_packed
from .state import BatchState

_LARGEST = np.finfo(np.float32).max
Call = Callable[[], Any]


class _Placeholder(NamedTuple):
    """Trailing argument of a stage that changes in each step."""

    place: int  # index among outputs, actions and rows


_OUTPUT: Any = StepOutput(*map(cast(Any, _Placeholder), range(len(StepOutput._fields))))
_ACTIONS, _ROWS = _Placeholder(len(_OUTPUT)), _Placeholder(len(_OUTPUT) + 1)


class StepStages:
    """Stages of the steps of B environments, as calls."""

    def __init__(
        self,
        state: BatchState,
        robot: Robot,
        constants: Constants,
        sensor: Sensor | None,
        traffic: Traffic | None = None,
        clocks: ActivationRules | None = None,
        events: EventRules | None = None,
    ) -> None:
        self._state, self._robot, self._constants, self._sensor = state, robot, constants, sensor
        self._traffic, self._clocks, self._events = traffic, clocks, events
        self._drives = events is not None and state.scenario.events.drives
        self.all_compiled = False
        """True if the stages of contacts and merges are also compiled."""
        self._entries: dict[Any, Callable[..., Any]] = {}
        self._plans: dict[Any, list[tuple[Call, Any]]] = {}
        place = state.place
        self._took_part = np.zeros(state.merged_into.shape, np.bool_)
        self._taken = np.zeros((0, *state.merged_into.shape[1:], len(robot.inputs)), np.float32)
        """Actions of no environment, for stages after one that has written those of ``moves``."""
        self._has_obstacles = state.obstacles.kinds.shape[1] > 0
        self._has_contacts = constants.contact_mode != IGNORE and self._has_obstacles
        self._reach = reaches(constants, self._has_contacts)
        self._dense = state.links.form == DENSE
        self._direct = place.direct

    def any_near(self) -> bool:
        """True if a contact is possible in the next step, see ``is_near``."""
        lanes = self._state.lanes
        return bool(is_near(self._state.environments.T, np.arange(lanes), lanes, self._reach).any())

    def calls(
        self,
        first: int,
        last: int,
        actions: NDArray[np.float32] | None,
        output: StepOutput,
        scratch: Scratch,
        collides: bool,
    ) -> list[tuple[Any, ...]]:
        """Calls of some blocks, in order, each a function and arguments for ``operator.call``.

        Missing kernels are compiled.

        With actions (B, n, a), those of a step, including contacts and merges if it ``collides``.
        Without actions, those of an observation.
        """
        rows = scratch.rows
        if self._direct:
            whole = last - first == len(output.observations)
            rows = output.observations if whole else output.observations[first:last]
        given = (*output, actions, rows)
        key = first, last, id(scratch), actions is not None, collides
        if (plan := self._plans.get(key)) is None:
            stages = self._stages_of(first, last, actions is not None, collides, scratch)
            plan = self._plans[key] = [self._bound(given, *stage) for stage in stages]
            self.all_compiled |= collides
        return [(call,) if late is None else (call, *late(given)) for call, late in plan]

    def _bound(self, given: tuple[Any, ...], kernel: Any, *arguments: Any) -> tuple[Call, Any]:
        """Call of a kernel with all arguments except the late ones.

        Also the function that selects these from those ``given`` in a step. A missing kernel is
        compiled.
        """
        late: list[Any] = [one.place for one in arguments if isinstance(one, _Placeholder)]
        fixed = arguments[: len(arguments) - len(late)]
        if (entry := self._entries.get(kernel)) is None:
            found = (*fixed, *(_writable(given[place]) for place in late))
            entry = self._entries[kernel] = ignore_overflow(entry_point(kernel, found))
        if not late:
            return partial(entry, *fixed), None
        if len(late) == 1:
            late = [slice(late[0], late[0] + 1)]
        return partial(entry, *fixed), itemgetter(*late)

    def _stages_of(
        self, first: int, last: int, moves: bool, collides: bool, work: Scratch
    ) -> Iterator[Any]:
        """Kernels and their arguments, in order."""
        state, robot, lanes = self._state, self._robot, self._state.lanes
        if moves:
            yield from self._move(first, last, collides, work)
        elif robot.memories and frame_turns(type(robot.model)):
            yield refresh_frames, robot, lanes, first, last, state.robots
        yield from self._sense_neighbours(first, last, moves, work)
        if self._has_obstacles:
            yield from self._sense_obstacles(first, last, work)
        if self._sensor is not None:
            yield from self._apply_noise(first, last, moves, self._sensor, work)
        yield from self._write_observations(first, last, work)
        if self._sensor is not None:
            yield from self._apply_occlusion(first, last, moves, self._sensor, work)
        if "blind" in state.scenario.events.kinds:
            sensed = state.scenario.observation_layout.obstacles.stop
            given = moves, sensed, state.environments, state.faults
            yield hide_from_blind, lanes, first, last, *given, _OUTPUT.observations
        if moves:
            yield self._conclude(first, last)

    def _move(self, first: int, last: int, collides: bool, work: Scratch) -> Iterator[Any]:
        state, robot, rules = self._state, self._robot, self._constants
        width, lanes, environments = state.place.width, state.lanes, state.environments
        now = state.robots, state.merged_into, environments, work.moves
        actions: Any = _ACTIONS
        if self._clocks is not None:
            yield self._take_commands(self._clocks, first, last, work)
            actions = state.commands
        if self._events is not None and self._drives:
            yield self._disturb_commands(self._events, first, last, work, actions)
            actions = self._taken
        yield propose_motion, width, robot, first, last, self._reach, *now, actions
        if self._traffic is not None:
            yield self._move_obstacles(first, last, self._traffic, work)
        if collides:
            blocks, mode = (first, last), rules.contact_mode
            if self._has_contacts and self._traffic is None:
                given: tuple[Any, ...] = (
                    *blocks,
                    mode,
                    *now,
                    state.tables,
                    state.index,
                    work.near,
                    work.near_listed,
                    work.normals,
                    _OUTPUT.contact,
                )
                if robot.memories:
                    yield stop_curves_at_obstacles, robot, lanes, *given
                else:
                    yield stop_at_obstacles, lanes, len(robot.axes), *given
            memory = work.vectors, work.numbers, work.listed, work.flags
            if rules.packs:
                sizes = 2.0 * rules.body_radius, rules.merge_radius
                yield pack_robots, lanes, *blocks, sizes, *now, *memory
            else:
                given = *now, state.links, state.obstacles, self._took_part, *memory
                yield merge_robots, lanes, *blocks, rules.merge_radius, rules.merges_through, *given
            if self._traffic is not None and self._has_contacts:
                given = state.robots, state.merged_into, environments
                beside = self._took_part, state.arrivals
                yield settle_merged, lanes, len(robot.axes), *blocks, *given, *beside
        if robot.memories:
            given = first, last, rules.contact_mode, *now
            yield update_robots, width, robot, *given, _OUTPUT.contact
        if self._events is not None and state.scenario.events.turns_frames:
            shape, streams = (robot.axes, robot.entries), (state.seed, state.number)
            own = work.keys, work.words[0], work.pair, state.robots
            given = self._events, streams, environments, *own
            yield turn_frames, width, *shape, first, last, *given

    def _take_commands(
        self, clocks: ActivationRules, first: int, last: int, work: Scratch
    ) -> tuple[Any, ...]:
        state, width = self._state, self._state.place.width
        streams, now = (state.seed, state.number), (state.robots, state.merged_into)
        kept = state.commands, state.last_activation, state.activated
        given = clocks, streams, *now, state.environments, state.nets, kept
        memory = work.keys, work.pair, work.moves[0]
        return take_commands, width, self._robot, first, last, *given, *memory, _ACTIONS

    def _disturb_commands(
        self, events: EventRules, first: int, last: int, work: Scratch, commands: Any
    ) -> tuple[Any, ...]:
        state, width = self._state, self._state.place.width
        streams, now = (state.seed, state.number), (state.robots, state.merged_into)
        given = events, streams, *now, state.environments, state.nets, state.faults
        memory = work.keys, work.words.reshape(-1, width.lanes), work.pair, work.moves
        return disturb_commands, width, self._robot, first, last, *given, *memory, commands

    def _move_obstacles(self, first: int, last: int, traffic: Traffic, work: Scratch) -> Any:
        state, rules = self._state, self._constants
        lengths = rules.duration, rules.merge_radius
        now = state.robots, state.merged_into, state.environments, work.moves
        streams = traffic, state.traffic, state.seed, state.number
        given = state.obstacles, state.discs, state.arrivals, work.traffic
        rest = *now, *streams, *given, _OUTPUT.contact
        blocks = first, last, rules.contact_mode, traffic.pushes
        return move_obstacles, self._robot, state.lanes, *blocks, lengths, *rest

    def _sense_neighbours(self, first: int, last: int, moves: bool, work: Scratch) -> Iterator[Any]:
        state, robot, rules, links = self._state, self._robot, self._constants, self._state.links
        shape, blocks, robots = (robot.axes, robot.entries), (first, last), state.robots
        if state.changes is not None:
            given: tuple[Any, ...] = (
                moves,
                rules.duration,
                state.changes,
                state.seed,
                state.number,
                robots,
            )
            others = state.merged_into, state.environments, links
            yield update_links, *shape, *blocks, *given, *others
        if self._dense:
            given = robots, links.weights, work.pair, state.environments
            yield sense_pairs, state.place.width, *shape, *blocks, *given, _ROWS
        else:
            given = rules.neighbour_slots, links, robots, work.counts, state.environments
            yield sense_links, *shape, *blocks, *given, _ROWS, _OUTPUT.neighbour_overflow
        if state.nets.size:
            given = robots, links, work.vectors, work.listed, work.numbers[0], state.nets
            yield sum_bearings, state.place.width, *shape, *blocks, *given, _ROWS
        if rules.packs:
            docked = rules.body_radius + 0.5 * rules.merge_radius
            yield hide_docked, state.lanes, *blocks, docked, robots, work.vectors[0], _ROWS

    def _sense_obstacles(self, first: int, last: int, work: Scratch) -> Iterator[Any]:
        state, robot, rules, place = self._state, self._robot, self._constants, self._state.place
        blocks = first, last, rules.obstacle_range
        given: tuple[Any, ...] = (state.robots, state.merged_into)
        late = _ROWS, _OUTPUT.clearance
        if state.index is not None:
            slots = place.scenario.observation_layout.obstacle_slots
            near = state.tables, state.index
            lists = work.silhouette, work.near_listed, work.near_distances
            rest = place.neighbours, slots, *given, *near, *lists
            yield sense_indexed, robot.entries, *blocks, *rest, *late
        elif len(robot.axes) == 2:
            own = place.neighbours
            yield sense_discs, place.width, *blocks, own, *given, state.discs, work.disc, *late
        if state.index is None and (len(robot.axes) == 3 or not place.only_balls):
            blocks_of = robot.axes, robot.entries, state.lanes, *blocks, place.neighbours
            memory = work.silhouette, work.vectors, work.listed, work.numbers[0]
            yield sense_shapes, *blocks_of, *given, state.obstacles, state.links, *memory, *late
        given = rules.weighs_clearance, state.environments
        yield measure_clearance, state.lanes, *blocks, *given, _OUTPUT.clearance

    def _apply_noise(
        self, first: int, last: int, moves: bool, sensor: Sensor, work: Scratch
    ) -> Iterator[Any]:
        state, robot, place = self._state, self._robot, self._state.place
        errors = sensor.errors
        if sensor.effects is not None:  # linear falloff ends at the edge
            own = columns_of(errors)
            views = np.where(sensor.effects.falloffs > 0.0, math.pi, own.half_field)
            errors = table_of(own._replace(half_field=views))
        blocks = first, last, moves, errors
        memory, streams = (work.keys, work.words), (state.seed, state.number)
        if changes_lanes(errors):
            given: tuple[Any, ...] = (
                self._constants.neighbour_slots,
                sensor.listed,
                state.links,
                *streams,
            )
            lists = work.listed, work.numbers[0], work.counts
            shape = place.width, robot.axes, robot.entries
            now = state.robots, state.environments
            yield apply_noise, *shape, *blocks, *given, *now, *lists, *memory, _ROWS
        yield from self._apply_effects(first, last, moves, sensor, work)
        if self._has_obstacles:
            yield from self._apply_noise_to_silhouettes(first, last, moves, sensor, work)

    def _apply_effects(
        self, first: int, last: int, moves: bool, sensor: Sensor, work: Scratch
    ) -> Iterator[Any]:
        state, robot, effects = self._state, self._robot, sensor.effects
        blocks, streams = (first, last, moves), (state.seed, state.number, state.environments)
        memory = work.keys, work.words
        if effects is not None and effects.remembers:
            given: tuple[Any, ...] = sensor.redraws, *streams, *memory, state.detection
            yield remember_detection, state.place.width, *blocks, *given
        if effects is not None and effects.drifts:
            given = sensor.errors_kept, *streams, *memory, state.errors
            yield remember_errors, state.place.width, *blocks, *given
        yield from self._turn_observers((0, state.place.neighbours), blocks, sensor, work)
        if effects is not None:
            given = self._constants.neighbour_slots, sensor.listed, state.links
            now = state.seed, state.number, state.merged_into, state.robots, state.environments
            kept = state.detection, state.errors
            lists = work.listed, work.numbers[0], work.counts
            shape = state.place.width, robot.axes, robot.entries
            rest = *lists, *memory, work.pair, _ROWS
            yield (
                apply_effects,
                *shape,
                *blocks,
                sensor.samples,
                effects,
                *given,
                *now,
                *kept,
                *rest,
            )

    def _turn_observers(
        self, rows: tuple[int, int], blocks: tuple[int, int, bool], sensor: Sensor, work: Scratch
    ) -> Iterator[Any]:
        """Rotate a range of rows by the bias of each robot's sensor."""
        if sensor.observer_bias.max() > 0.0:
            state = self._state
            streams = state.seed, state.number, state.environments
            given = (
                sensor.samples,
                sensor.observer_bias,
                *rows,
                *streams,
                work.keys,
                work.pair,
                _ROWS,
            )
            yield turn_observers, state.place.width, self._robot.axes, *blocks, *given

    def _apply_noise_to_silhouettes(
        self, first: int, last: int, moves: bool, sensor: Sensor, work: Scratch
    ) -> Iterator[Any]:
        """Stages that change angular extents, in the order of neighbour rows: sectors come last."""
        state, place, effects = self._state, self._state.place, sensor.effects
        own, points, n = place.neighbours, place.points, place.scenario.n_robots
        shape, errors = (place.width, self._robot.axes), sensor.errors
        streams = state.seed, state.number, state.environments
        memory = work.keys, work.words
        if changes_silhouettes(errors):
            given = own, points, *streams, *memory, _ROWS
            yield apply_noise_to_silhouettes, *shape, first, last, moves, errors, *given
        end = own + place.n_obstacles * points
        yield from self._turn_observers((own, end), (first, last, moves), sensor, work)
        if effects is not None and effects.drifts:
            kept = effects, own, points, n * (n - 1), *streams, state.errors
            blocks = *shape, first, last, moves, sensor.samples
            yield turn_silhouettes, *blocks, *kept, *memory, _ROWS
        if columns_of(errors).sectors.any():
            yield round_silhouettes, *shape, first, last, errors, own, points, state.batch, _ROWS

    def _write_observations(self, first: int, last: int, work: Scratch) -> Iterator[Any]:
        state, robot, place = self._state, self._robot, self._state.place
        seen, blocks = _OUTPUT.observations, (first, last)
        if self._dense and place.packed:
            given = self._constants.neighbour_slots, state.links, work.rows, work.counts
            yield write_packed, state.lanes, *blocks, *given, seen, _OUTPUT.neighbour_overflow
        elif not self._direct:
            yield write_observations, place.width, robot.axes, *blocks, work.rows, seen
        if place.scenario.model.senses:
            yield sense_oneself, robot, state.lanes, *blocks, state.robots, state.merged_into, seen

    def _apply_occlusion(
        self, first: int, last: int, moves: bool, sensor: Sensor, work: Scratch
    ) -> Iterator[Any]:
        state, robot, rules, lanes = self._state, self._robot, self._constants, self._state.lanes
        slots, merged, seen = rules.neighbour_slots, state.merged_into, _OUTPUT.observations
        if changes_singles(sensor.errors):
            given: tuple[Any, ...] = (
                sensor.errors,
                rules.body_radii,
                slots,
                sensor.packed,
                state.links,
            )
            memory = work.vectors, work.listed, work.numbers[0], work.counts
            shape = robot.axes, robot.entries, lanes, first, last
            scene = state.robots, merged, state.obstacles
            yield apply_occlusion, *shape, *given, *scene, *memory, seen
        if sensor.packed:
            yield close_rows, first * lanes, min(last * lanes, state.batch), slots, seen
        if sensor.samples.max() > 0.0:
            given = moves, sensor.samples, merged, state.environments, state.held
            yield hold_observations, lanes, first, last, *given, seen
        if state.past.shape[1] > 1:
            given = moves, sensor.delays, merged, state.environments, state.past
            yield delay_observations, lanes, first, last, *given, seen

    def _conclude(self, first: int, last: int) -> tuple[Any, ...]:
        state, rules, late = self._state, self._constants, _OUTPUT
        blocks = state.place.width, first, last
        given = rules.duration, rules.max_steps, rules.reward_weights, rules.all_earn, self._reach
        now = state.environments, state.merged_into, self._took_part
        written = late.scores, late.active, late.status, late.robot_rewards, late.contacts
        return conclude_step, *blocks, *given, *now, *written


def _writable(value: Any) -> Any:
    read_only = isinstance(value, np.ndarray) and not value.flags.writeable
    return np.empty_like(value) if read_only else value


@kernel
def first_not_finite(values):
    """Index of the first number that is infinite or NaN, or −1."""
    # counting has no branch and becomes SIMD; the index is searched only if there is one
    finite = 0
    for k in range(len(values)):
        finite += abs(values[k]) <= _LARGEST
    if finite == len(values):
        return -1
    k = 0
    while abs(values[k]) <= _LARGEST:
        k += 1
    return k
