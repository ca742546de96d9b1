"""One step of B environments: which stages there are, and in which order.

From the action to the new observation, over the blocks of one thread after another:

    propose_motion              displacement of every robot if nothing were in its way
    stop_at_obstacles           exact contacts, where an obstacle is within reach
    merge_robots, pack_robots   exact merges, or bodies that touch, where robots are within reach
    advance_free                all other environments
    update_robots               memory and frames of robot models
    update_links                arcs that change with time
    sense_pairs, sense_links    bearings of neighbours, V, the closest pair
    sense_discs, sense_shapes   silhouettes of obstacles, clearance
    apply_noise                 range, field of view, random errors
    write_observations          from lanes to one array for each environment
    apply_occlusion             occlusion, rows that close up, delay
    conclude_step               reward, rendezvous, time limit

Each is a kernel of its own with the arrays it uses as arguments, compiled when it is first called
for; what a scenario does not have is not called. Between stages numbers are in the scratch memory
of a thread. An observation without a step leaves out the first five and the last.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...compilation import entry_point, kernel
from ...graphs.edges import DENSE
from ...obstacles.contact import IGNORE
from ...outcome import StepOutput
from ...physics.random_streams import ignore_overflow
from ...robots.motion import frame_turns
from ..memory import CLEARANCE, SQUARE_CLOSEST, Robot
from ..memory_layout import Scratch
from ..preparation import Constants, Sensor
from ..state import State
from . import apply_noise as noise
from . import apply_occlusion as occlusion
from .collide import (
    merge_robots,
    pack_robots,
    reaches,
    stop_at_obstacles,
    stop_curves_at_obstacles,
)
from .conclude import conclude_step
from .propose import advance_free, propose_motion, refresh_frames, update_robots
from .sense_neighbours import hide_docked, sense_links, sense_pairs, update_links
from .sense_obstacles import measure_clearance, sense_discs, sense_shapes
from .write_observations import sense_oneself, write_observations, write_packed

_LARGEST = np.finfo(np.float32).max
Call = Callable[[], Any]


class StepStages:
    """The stages of the steps of B environments, as calls."""

    def __init__(
        self, state: State, robot: Robot, constants: Constants, sensor: Sensor | None
    ) -> None:
        self.constants = constants
        self.collides = False
        """Whether the stages of contacts and merges are called, and so compiled."""
        self._state, self._robot, self._sensor = state, robot, sensor
        self._entries: dict[Any, Callable[..., Any]] = {}
        place, obstacles = state.place, state.obstacles
        self._took_part = np.zeros(state.merged_into.shape, np.bool_)
        self._meets_obstacles = constants.contact_mode != IGNORE and obstacles.kinds.shape[1] > 0
        self._reach = reaches(
            constants.speed_limit,
            constants.duration,
            constants.merge_radius,
            constants.packs,
            self._meets_obstacles,
        )
        fields = state.environments.reshape(place.blocks, -1, place.lanes)
        self._square_closest, self._clearance = fields[:, SQUARE_CLOSEST], fields[:, CLEARANCE]
        self._dense = state.links.form == DENSE
        self._has_shapes = place.scenario.dim == 3 or not place.only_balls

    def can_collide(self) -> bool:
        """Whether something can meet in the next step."""
        near = self._square_closest < self._reach[0]
        return bool(near.any() or (self._clearance < self._reach[1]).any())

    def _bind(self, kernel: Any, *arguments: Any) -> Call:
        """A call of a kernel, which is compiled here if it has not been."""
        if (entry := self._entries.get(kernel)) is None:
            # for arrays that may be written to, as a caller's actions need not be
            types = tuple(map(_writable, arguments))
            entry = self._entries[kernel] = ignore_overflow(entry_point(kernel, types))
        return partial(entry, *arguments)

    def calls(
        self,
        first: int,
        last: int,
        actions: NDArray[np.float32] | None,
        output: StepOutput,
        scratch: Scratch,
    ) -> list[Call]:
        """What there is to call, in order, for some blocks: a step under actions (B, n, a), or if
        they are None an observation.
        """
        calls: list[Call] = []
        moves = actions is not None
        if moves:
            self._move(calls.append, first, last, actions, output, scratch)
        elif self._robot.memories and frame_turns(type(self._robot.model)):
            lanes, robots = self._state.lanes, self._state.robots
            calls.append(self._bind(refresh_frames, self._robot, lanes, first, last, robots))
        self._sense(calls.append, first, last, moves, output, scratch)
        if moves:
            self._conclude(calls.append, first, last, output)
        return calls

    def _move(self, add: Any, first: int, last: int, actions: Any, output: Any, work: Any) -> None:
        state, robot, constants = self._state, self._robot, self.constants
        width, lanes, moves = state.place.width, state.lanes, work.moves
        robots, merged, environments = state.robots, state.merged_into, state.environments
        now = robots, merged, environments, moves
        reach = self._reach
        add(self._bind(propose_motion, width, robot, first, last, reach, actions, *now))
        if self.collides:
            blocks, mode = (first, last), constants.contact_mode
            if self._meets_obstacles:
                given = *blocks, mode, *now, state.obstacles, output.contact, work.normals
                if robot.memories:
                    add(self._bind(stop_curves_at_obstacles, robot, lanes, *given))
                else:
                    add(self._bind(stop_at_obstacles, lanes, len(robot.axes), *given))
            memory = work.vectors, work.numbers, work.listed, work.flags
            if constants.packs:
                sizes = 2.0 * constants.body_radius, constants.merge_radius
                add(self._bind(pack_robots, lanes, *blocks, sizes, *now, *memory))
            else:
                given = *now, state.links, state.obstacles, self._took_part, *memory
                add(self._bind(merge_robots, lanes, *blocks, constants.merge_radius, *given))
        add(self._bind(advance_free, width, robot.axes, first, last, robots, environments, moves))
        if robot.memories:
            given = width, robot, first, last, constants.contact_mode, *now, output.contact
            add(self._bind(update_robots, *given))

    def _sense(self, add: Any, first: int, last: int, moves: bool, output: Any, work: Any) -> None:
        state, robot, constants, place = self._state, self._robot, self.constants, self._state.place
        width, lanes, links, axes, entries = place.width, state.lanes, state.links, robot.axes, robot.entries
        robots, merged, environments = state.robots, state.merged_into, state.environments
        slots, rows = constants.neighbour_slots, self._rows(first, last, output, work)
        if state.changes is not None:
            time = moves, constants.duration, state.changes, state.seed, state.number
            given = *time, robots, merged, environments, links
            add(self._bind(update_links, axes, entries, first, last, *given))
        if self._dense:
            given = robots, links.weights, rows, work.pair, environments
            add(self._bind(sense_pairs, width, axes, entries, first, last, *given))
        else:
            given = links, robots, rows, work.counts, environments, output.crowded
            add(self._bind(sense_links, axes, entries, first, last, slots, *given))
        if constants.packs:
            docked = constants.body_radius + 0.5 * constants.merge_radius
            given = docked, robots, rows, work.vectors[0]
            add(self._bind(hide_docked, lanes, first, last, *given))
        if state.obstacles.kinds.shape[1]:
            self._sense_obstacles(add, first, last, rows, output, work)
        if self._sensor is not None:
            self._apply_noise(add, first, last, moves, self._sensor, rows, work)
        observations = output.observations
        if self._dense and place.packed:
            given = slots, links, rows, work.counts, observations, output.crowded
            add(self._bind(write_packed, lanes, first, last, *given))
        elif rows is work.rows:
            add(self._bind(write_observations, width, axes, first, last, rows, observations))
        if place.scenario.model.senses:
            given = robots, merged, observations
            add(self._bind(sense_oneself, robot, lanes, first, last, *given))
        if self._sensor is not None:
            self._apply_occlusion(add, first, last, moves, self._sensor, output, work)

    def _rows(self, first: int, last: int, output: StepOutput, work: Scratch) -> Any:
        """Where observations are sensed: in scratch memory, or, where blocks have one lane and rows
        are already in their order, in the output.
        """
        place = self._state.place
        if place.lanes > 1 or (self._dense and place.packed):
            return work.rows
        whole = first == 0 and last == place.blocks
        return output.observations if whole else output.observations[first:last]

    def _sense_obstacles(
        self, add: Any, first: int, last: int, rows: Any, output: Any, work: Any
    ) -> None:
        state, constants, robot = self._state, self.constants, self._robot
        width, lanes, reach = state.place.width, state.lanes, constants.obstacle_range
        robots, merged, own = state.robots, state.merged_into, state.place.neighbours
        clearance = output.clearance
        if len(robot.axes) == 2:
            given = robots, merged, state.discs, rows, clearance, work.disc
            add(self._bind(sense_discs, width, first, last, reach, own, *given))
        if self._has_shapes:
            given = robots, merged, state.obstacles, state.links, rows, clearance
            memory = work.silhouette, work.vectors, work.listed, work.numbers[0]
            blocks = lanes, first, last, reach, own
            add(self._bind(sense_shapes, robot.axes, robot.entries, *blocks, *given, *memory))
        given = constants.weighs_clearance, clearance, state.environments
        add(self._bind(measure_clearance, lanes, first, last, reach, *given))

    def _apply_noise(
        self, add: Any, first: int, last: int, moves: bool, sensor: Sensor, rows: Any, work: Any
    ) -> None:
        state, robot, own = self._state, self._robot, self._state.place.neighbours
        width, errors, memory = state.place.width, sensor.errors, (work.keys, work.words)
        blocks = first, last, moves, errors
        streams, environments = (state.seed, state.number), state.environments
        if errors.over_lanes:
            slots = self.constants.neighbour_slots
            given = slots, sensor.listed, state.links, *streams, state.robots, environments
            lists = rows, work.listed, work.numbers[0], work.counts
            arguments = *blocks, *given, *lists, *memory
            add(self._bind(noise.apply_noise, width, robot.axes, robot.entries, *arguments))
        if state.obstacles.kinds.shape[1] and errors.changes_silhouettes:
            points = len(work.silhouette)
            given = own, points, *streams, environments, rows, *memory
            kernel = noise.apply_noise_to_silhouettes
            add(self._bind(kernel, width, robot.axes, *blocks, *given))

    def _apply_occlusion(
        self, add: Any, first: int, last: int, moves: bool, sensor: Sensor, output: Any, work: Any
    ) -> None:
        state, robot, slots = self._state, self._robot, self.constants.neighbour_slots
        lanes, merged, seen = state.lanes, state.merged_into, output.observations
        if sensor.errors.one_by_one:
            radius, scene = self.constants.body_radius, (state.robots, merged, state.obstacles)
            given = sensor.errors, radius, slots, sensor.packed, state.links, *scene, seen
            memory = work.vectors, work.listed, work.numbers[0], work.counts
            kernel, shape = occlusion.apply_occlusion, (robot.axes, robot.entries, lanes)
            add(self._bind(kernel, *shape, first, last, *given, *memory))
        if sensor.packed:
            start, end = first * lanes, min(last * lanes, len(seen))
            add(self._bind(occlusion.close_rows, start, end, slots, seen))
        if state.past.shape[1] > 1:
            given = moves, merged, state.environments, seen, state.past
            add(self._bind(occlusion.delay_observations, lanes, first, last, *given))

    def _conclude(self, add: Any, first: int, last: int, output: StepOutput) -> None:
        state, constants = self._state, self.constants
        rules = constants.duration, constants.max_steps, constants.reward_weights
        given = state.environments, state.merged_into, self._took_part
        written = output.scores, output.active, output.status, output.robot_rewards, output.contacts
        blocks = state.place.width, first, last
        add(self._bind(conclude_step, *blocks, *rules, constants.all_earn, *given, *written))


def _writable(value: Any) -> Any:
    read_only = isinstance(value, np.ndarray) and not value.flags.writeable
    return np.empty_like(value) if read_only else value


@kernel
def first_not_finite(values):
    """Index of the first number that is infinite or NaN, or −1."""
    # to count has no branch and becomes SIMD; the place is looked for only if there is one
    finite = 0
    for k in range(len(values)):
        finite += abs(values[k]) <= _LARGEST
    if finite == len(values):
        return -1
    k = 0
    while abs(values[k]) <= _LARGEST:
        k += 1
    return k
