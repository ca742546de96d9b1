"""Which episode of which seed each team is in, and how it begins."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import entry_point
from ..graphs.random_graphs import CustomFamily
from ..obstacles.obstacle_set import world_of
from ..physics.random_streams import ignore_overflow
from ..scenario.start_options import StartOptions
from .edge_tables import LinkList, listed
from .memory import AWAITING_RESET, RUNNING, Layout, Robot
from .memory.obstacles import room_for_obstacles
from .memory_layout import sampled_starts
from .preparation import fixed_links, fixed_obstacles, start_rules
from .reset.starts import TOO_MANY_LINKS, StartRules, reset_teams
from .state import Overwritten, State, overwrite, undo


class Episodes:
    """Seeds and episode numbers of B teams, and the beginning of their episodes.

    Args:
        state: of the teams.
        layout: of its memory.
        robot: its model.
        scratch: working memory for one team.
    """

    def __init__(self, state: State, layout: Layout, robot: Robot, scratch: Any) -> None:
        self.seed, self.number = state.seed, state.number
        self._state, self._layout, self._robot, self._scratch = state, layout, robot, scratch
        scenario = state.scenario
        self._rules = start_rules(scenario)
        links = fixed_links(scenario)
        self._links = None if links is None else state.as_kept([links])
        self._obstacles = fixed_obstacles(scenario)
        self._reset: Callable[..., Any] | None = None

    def begin(
        self,
        which: NDArray[np.int64],
        seeds: list[int | None] | None,
        given: StartOptions,
        resting: bool,
    ) -> None:
        """Begin a new episode in some teams.

        Args:
            which: (count,), teams.
            seeds: of all teams; None goes on to the next episode of their seed.
            given: parts of a start.
            resting: let these teams pass the next step without moving.

        Raises:
            ValueError: for links for which there is no room; nothing has changed then.
            RuntimeError: if no room was found for a start or an obstacle; likewise.
        """
        self._check_room_for_links(given)
        if (reset := self._reset) is None:  # compiling may be interrupted: before anything changes
            arguments = self._arguments(which, resting, self._rules)
            reset = self._reset = ignore_overflow(entry_point(reset_teams, arguments))
        log: list[Overwritten] = []
        self._assign_seeds(which, seeds, log)
        try:
            rules = self._take_given(which, given, log)
        except ValueError:  # of a family of graphs of a user's own
            undo(log)
            raise
        failed, why = reset(*self._arguments(which, resting, rules))
        if failed >= 0:
            undo(log)
            raise RuntimeError(self._no_room(failed, why))

    def _arguments(
        self, which: NDArray[np.int64], resting: bool, rules: StartRules
    ) -> tuple[Any, ...]:
        """What ``reset_teams`` takes."""
        state = self._state
        return (
            which,
            AWAITING_RESET if resting else RUNNING,
            rules,
            (self.seed, self.number),
            (self._layout, self._robot),
            state.parts(),
            self._scratch,
            tuple(sampled_starts(state.place, len(which))),
            room_for_obstacles(state.obstacles, len(which)),
        )

    def _no_room(self, team: int, why: int) -> str:
        scenario = self._state.scenario
        if why == TOO_MANY_LINKS:
            return (
                f"the graph drawn for team {team} has more links than expected; choose another seed"
            )
        if scenario.start_reach < math.inf:
            return (
                f"no start found for team {team}: {scenario.n_robots} robots in a spawn_size of "
                f"{scenario.spawn_size} m, connected by links of at most range − (n − 1) "
                f"merge_radius/2 = {scenario.start_reach:.6g} m, 2 merge_radius apart and clear of "
                "obstacles; make spawn_size smaller or sensing.range larger, thin out the "
                "obstacles, or pass require_connected=False"
            )
        return (
            f"no room for the start of team {team}: {scenario.n_robots} robots, "
            f"neighbours at least 2 merge_radius = {2 * scenario.merge_radius} m apart "
            f"and clear of obstacles, in a spawn_size of {scenario.spawn_size} m; "
            "enlarge it or thin out the obstacles"
        )

    def _assign_seeds(
        self, which: NDArray[np.int64], seeds: list[int | None] | None, log: list[Overwritten]
    ) -> None:
        """Seed teams anew, or send them on to the next episode of their seed."""
        unseeded = which[self.number[which] < 0]
        overwrite(self.number, which, self.number[which] + 1, log)
        if seeds is not None:
            given = [team for team in which.tolist() if seeds[team] is not None]
            overwrite(self.seed, given, [seeds[team] for team in given], log)
            overwrite(self.number, given, 0, log)
            unseeded = np.setdiff1d(unseeded, given)
        if len(unseeded):
            entropy = np.random.SeedSequence().generate_state(len(unseeded), np.uint64)
            overwrite(self.seed, unseeded, entropy >> np.uint64(1), log)

    def _check_room_for_links(self, given: StartOptions) -> None:
        """Refuse given weights with more links than a team of this graph can keep."""
        room = self._state.place.n_links
        for weights in () if given.weights is None else given.weights:
            if (found := np.count_nonzero(np.triu(weights))) > room:
                raise ValueError(
                    f"weights have {found} links; teams of this scenario's graph have room for "
                    f"{room}; give the scenario a graph with as many"
                )

    def _take_given(
        self, which: NDArray[np.int64], given: StartOptions, log: list[Overwritten]
    ) -> StartRules:
        """Write the given parts of a start into the state; the rules say to draw the others."""
        state, rules = self._state, self._rules
        scenario, n, d = state.scenario, state.scenario.n_robots, state.scenario.dim
        starts, headings = scenario.start_positions, scenario.start_headings
        positions = given.positions if starts is None else _or(given.positions, [starts])
        angles = given.angles if headings is None else _or(given.angles, [headings])
        frames, obstacles = given.frames, given.obstacles
        if frames is None and not scenario.model.nonholonomic and scenario.local_frames == "global":
            frames = np.broadcast_to(np.eye(d), (1, n, d, d))
        if positions is not None:
            state.give("positions", _for_each(positions, which), which, log)
        if angles is not None:
            kept = np.zeros((*angles.shape[:-1], scenario.model.memory_size(d)))
            kept[..., : angles.shape[-1]] = angles  # whatever else it keeps begins at zero
            state.give("memory", _for_each(kept, which), which, log)
        if frames is not None:
            flat = frames.reshape(len(frames), n, d * d)
            state.give("frames", _for_each(flat, which), which, log)
        if given.weights is not None:
            one_way = state.place.one_way
            links = [listed(m, one_way=one_way) for m in _for_each(given.weights, which)]
            state.give_links(state.as_kept(links), which, log)
        elif self._links is not None:
            state.give_links(self._links, which, log)
        elif isinstance(scenario.sensing_graph, CustomFamily):
            state.give_links(state.as_kept(self._draw_custom(which)), which, log)
        if obstacles is not None and obstacles.size:
            state.give_obstacles(world_of(_for_each(obstacles, which)), which, log)
        elif self._obstacles is not None and obstacles is None:
            state.give_obstacles(self._obstacles, which, log)
        return rules._replace(
            draw_positions=positions is None,
            draw_memory=angles is None,
            draw_frames=rules.draw_frames and frames is None,
            draw_weights=given.weights is None,
            draw_obstacles=rules.draw_obstacles and given.obstacles is None,
        )

    def _draw_custom(self, which: NDArray[np.int64]) -> list[LinkList]:
        """The links of these teams' episodes, drawn by the family of a user's own."""
        scenario = self._state.scenario
        return [
            scenario.sensing_graph.draw(
                scenario.n_robots,
                self.seed[team],
                self.number[team],
                connected=scenario.require_connected,
            )
            for team in which
        ]


def _or(value: NDArray[np.float64] | None, default: Any) -> NDArray[np.float64]:
    return np.array(default, dtype=np.float64) if value is None else value


def _for_each(values: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.float64]:
    """One entry for each of these teams, from one for all or one for every team of the batch."""
    return values if len(values) == 1 else values[which]
