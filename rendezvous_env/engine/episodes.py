"""Reset of episodes: seed, episode number and initial condition of each environment."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from ..graphs.edges import ARCS
from ..graphs.random_graphs import CustomFamily
from ..obstacles.fields import FieldRules
from ..obstacles.obstacle_set import world_of
from ..physics.random_streams import ignore_overflow
from ..robots.events import draw_faults, fault_rules
from ..scenario.scenario import Scenario
from ..scenario.start_options import StartOptions
from . import reset
from .edge_tables import as_kept
from .memory import AWAITING_RESET, RUNNING, Robot
from .memory_layout import Scratch
from .preparation import StartRules, fixed_links, fixed_obstacles, start_rules
from .state import BatchState


class EpisodeReset:
    """Initialises the episodes of B environments."""

    def __init__(self, state: BatchState, robot: Robot, scratch: Scratch) -> None:
        self._state, self._robot, self._scratch = state, robot, scratch
        self._rules = start_rules(state.scenario)
        links, n = fixed_links(state.scenario), state.scenario.n_robots
        self._links = None if links is None else as_kept(state.links, [links], n)
        self._obstacles = state.share(fixed_obstacles(state.scenario))
        self._unturned = _unturned(state.scenario)
        self._entries: dict[Any, Callable[..., Any]] = {}

    def begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None,
        given: StartOptions,
        resting: bool,
    ) -> None:
        """Start a new episode in these environments, (count,).

        ``seeds``, of all of them, and ``resting`` are as in ``Simulator.reset``. An exception
        leaves the state unchanged.
        """
        self._check_room_for_links(given)
        before = self._state.copy_of(which)
        try:
            self._assign_seeds(which, seeds)
            rules = self._take_given(which, given)
            self._draw(which, AWAITING_RESET if resting else RUNNING, rules)
        except BaseException:
            self._state.give(which, **before)
            raise

    def _draw(self, which: NDArray[np.int64], status: int, rules: StartRules) -> None:
        """Sample everything that is not given, in the order of the module ``reset``, and start."""
        state, robot, work, lanes = self._state, self._robot, self._scratch, self._state.lanes
        streams, lists = (state.seed, state.number), (work.listed, work.numbers[0])
        if rules.graph is not None and rules.draw_weights:
            given: tuple[Any, ...] = *streams, rules.graph, state.links, *lists, work.counts
            failed = self._run(reset.draw_graphs, lanes, which, *given)
            if failed >= 0:
                raise RuntimeError(
                    f"the graph sampled for environment {failed} has more links than expected; "
                    "choose another seed"
                )
        pending, trial = which, 0
        while len(pending) and trial < reset.MAX_TRIALS:
            pending = self._draw_room(pending, trial, rules)
            trial += 1
        if len(pending):
            raise RuntimeError(self._no_room(int(pending[0])))
        state.lay_out_discs(which)
        if rules.draw_frames:
            self._run(reset.draw_frames, lanes, which, robot.axes, *streams, state.robots)
        if robot.memories:
            given = rules.draw_memory, *streams, state.robots
            self._run(reset.draw_memories, lanes, which, robot, *given)
        if rules.draw_weights and rules.factors is not None:
            given = *rules.factors, *streams, state.scenario.n_robots, state.links
            self._run(reset.multiply_arcs, which, *given)
        if state.faults.size:
            self._run(draw_faults, which, fault_rules(state.scenario), *streams, state.faults)
        state.begin(which, status)

    def _draw_room(
        self, which: NDArray[np.int64], trial: int, rules: StartRules
    ) -> NDArray[np.int64]:
        """Sample obstacles and positions of environments.

        Returns the environments to sample again: those whose robots are separated although the
        field excludes that.
        """
        state, work, field, lanes = self._state, self._scratch, rules.field, self._state.lanes
        streams, world, positions = (state.seed, state.number), state.obstacles, work.vectors[0]
        if field is not None and rules.draw_obstacles:
            # obstacles keep clear of given positions, and sampled positions of obstacles
            n_given = 0 if rules.draw_positions else state.scenario.n_robots
            given: tuple[Any, ...] = field, n_given, state.robots, world, positions
            failed = self._run(reset.draw_fields, lanes, which, trial, *streams, *given)
            if failed >= 0:
                raise RuntimeError(self._no_room(failed))
            self._close_seams(which, field)
        pending, further = which if rules.draw_positions else which[:0], 0
        while len(pending) and further < reset.MAX_CONNECTED:
            pending = self._draw_positions(pending, (trial, further), rules)
            further += 1
        if len(pending):
            raise RuntimeError(self._no_room(int(pending[0])))
        if field is None or not rules.draw_obstacles or field.passage == 0.0:
            return which[:0]
        walled_in = np.zeros(len(which), np.bool_)
        given = field.passage, state.robots, world, positions, work.chains, walled_in
        self._run(reset.check_passages, lanes, which, *given)
        return which[walled_in]

    def _close_seams(self, which: NDArray[np.int64], field: Any) -> None:
        """Close the seams between sampled discs or spheres; sampled walls have none."""
        if isinstance(field, FieldRules):
            dim, world = self._state.scenario.dim, self._state.obstacles
            if dim == 2:
                self._run(reset.close_disc_field_seams, which, world)
            else:
                self._run(reset.close_field_seams, which, dim, world)

    def _draw_positions(
        self, which: NDArray[np.int64], trials: tuple[int, int], rules: StartRules
    ) -> NDArray[np.int64]:
        """Sample positions of environments.

        Returns those in which links up to the required length do not connect the robots.
        """
        state, work, lanes = self._state, self._scratch, self._state.lanes
        lengths = rules.spawn_edges, rules.least_distance, rules.keep_out
        world = state.obstacles if state.obstacles.kinds.shape[1] else None
        given: tuple[Any, ...] = (
            lengths,
            rules.region,
            rules.reach is not None,
            state.seed,
            state.number,
            state.links,
            world,
        )
        memory = state.robots, work.vectors[0]
        failed = self._run(reset.draw_positions, lanes, which, trials, *given, *memory)
        if failed >= 0:
            raise RuntimeError(self._no_room(failed))
        if rules.reach is None or rules.reach == math.inf:
            return which[:0]
        parted = np.zeros(len(which), np.bool_)
        given = rules.reach, state.robots, work.vectors[0], work.counts, parted
        self._run(reset.check_connected, lanes, which, *given)
        return which[parted]

    def _run(self, kernel: Any, *arguments: Any) -> Any:
        """Result of a kernel, compiled on first use."""
        key = kernel, sum(argument is None for argument in arguments)
        if (entry := self._entries.get(key)) is None:
            entry = self._entries[key] = ignore_overflow(entry_point(kernel, arguments))
        return entry(*arguments)

    def _no_room(self, team: int) -> str:
        scenario = self._state.scenario
        if scenario.start_reach < math.inf:
            return (
                f"no initial positions found for environment {team}: {scenario.n_robots} robots in "
                f"a spawn_size of {scenario.spawn_size} m, connected by links of at most range − "
                f"(n − 1) merge_radius/2 = {scenario.start_reach:.6g} m, 2 merge_radius apart and "
                "clear of obstacles; make spawn_size smaller or sensing.range larger, use fewer "
                "obstacles, or pass require_connected=False"
            )
        if scenario.start_region is not None:
            return (
                f"no room for initial positions in environment {team}: {scenario.n_robots} "
                f"robots, neighbours at least 2 merge_radius = {2 * scenario.merge_radius} m "
                "apart and clear of obstacles, in the start_region; enlarge it"
            )
        return (
            f"no room for initial positions in environment {team}: {scenario.n_robots} robots, "
            f"neighbours at least 2 merge_radius = {2 * scenario.merge_radius} m apart and clear "
            f"of obstacles, in a spawn_size of {scenario.spawn_size} m; enlarge it or use fewer "
            "obstacles"
        )

    def _assign_seeds(self, which: NDArray[np.int64], seeds: list[int | None] | None) -> None:
        """Assign new seeds, or advance to the next episode of a seed."""
        seed, number = self._state.seed, self._state.number
        unseeded = which[number[which] < 0]
        number[which] += 1
        if seeds is not None:
            given = [team for team in which.tolist() if seeds[team] is not None]
            seed[given] = [seeds[team] for team in given]
            number[given] = 0
            unseeded = np.setdiff1d(unseeded, given)
        if len(unseeded):
            entropy = np.random.SeedSequence().generate_state(len(unseeded), np.uint64)
            seed[unseeded] = entropy >> np.uint64(1)

    def _check_room_for_links(self, given: StartOptions) -> None:
        """Reject given weights with more links than the graph has memory for."""
        room = self._state.place.n_links
        for weights in () if given.weights is None else given.weights:
            if (found := np.count_nonzero(np.triu(weights))) > room:
                raise ValueError(
                    f"weights have {found} links; environments of this scenario have memory for "
                    f"{room}; give the scenario a graph with as many"
                )

    def _take_given(self, which: NDArray[np.int64], given: StartOptions) -> StartRules:
        """Write the given parts of an initial condition into the state.

        Returns rules that sample the other parts.
        """
        state, rules, scenario = self._state, self._rules, self._state.scenario
        n, d = scenario.n_robots, scenario.dim
        positions = _or(given.positions, scenario.start_positions)
        angles, frames = _or(given.angles, scenario.start_headings), given.frames
        if frames is None and not scenario.model.n_angles and scenario.local_frames == "global":
            frames = np.broadcast_to(np.eye(d), (1, n, d, d))
        if positions is not None:
            state.give(which, positions=_for_each(positions, which))
        if angles is not None:
            kept = np.zeros((*angles.shape[:-1], scenario.model.memory_size(d)))
            kept[..., : angles.shape[-1]] = angles  # other memory starts at zero
            kept[..., self._unturned, :] = 0.0
            state.give(which, memory=_for_each(kept, which))
        if frames is not None:
            flat = frames.reshape(len(frames), n, d * d)
            state.give(which, frames=_for_each(flat, which))
        state.give(which, **self._links_of(which, given.weights))
        world, obstacles = self._obstacles, given.obstacles
        if obstacles is not None:
            tables = _for_each(obstacles, which)
            given_world = world_of(tables, dim=scenario.dim) if obstacles.size else None
            world = state.with_index(given_world, which)
        if world:
            state.give(which, **world)
        if state.traffic.size:
            state.give(which, traffic=np.zeros(state.traffic.shape[1:]))
        return rules._replace(
            draw_positions=positions is None,
            draw_memory=angles is None,
            draw_frames=rules.draw_frames and frames is None,
            draw_weights=given.weights is None,
            draw_obstacles=rules.draw_obstacles and given.obstacles is None,
        )

    def _links_of(
        self, which: NDArray[np.int64], weights: NDArray[np.float64] | None
    ) -> dict[str, NDArray[Any]]:
        """Links that are given, fixed, or sampled by a custom family, see ``as_kept``.

        Empty where kernels sample them.
        """
        state, scenario = self._state, self._state.scenario
        graph, connected, n = scenario.sensing_graph, scenario.require_connected, scenario.n_robots
        if weights is not None:
            kept = weights if state.links.form == ARCS else np.triu(weights)
            lists = [(*np.nonzero(m), m[np.nonzero(m)]) for m in _for_each(kept, which)]
        elif self._links is not None:
            return self._links
        elif isinstance(graph, CustomFamily):
            streams = zip(state.seed[which], state.number[which], strict=True)
            lists = [graph.draw(n, seed, number, connected=connected) for seed, number in streams]
        else:
            return {}
        return as_kept(state.links, lists, n)


def _unturned(scenario: Scenario) -> list[int]:
    """Robots of a mixed team whose frame is the global one for any headings."""
    if not scenario.mixes_models or scenario.local_frames != "global":
        return []
    straight = {model.name for model in scenario.models if model.n_angles == 0}
    return [robot for robot, name in enumerate(scenario.robot_model) if name in straight]


def _or(value: NDArray[np.float64] | None, default: Any) -> NDArray[np.float64] | None:
    """Value for all environments, or else the scenario's."""
    return value if default is None or value is not None else np.array([default], np.float64)


def _for_each(values: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.float64]:
    """One entry for each of these environments, from one for all or one per environment."""
    return values if len(values) == 1 else values[which]
