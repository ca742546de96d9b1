"""Scenario: everything one experiment is, checked once and then immutable."""

from __future__ import annotations

import dataclasses
import math
import os
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from .. import checks, graphs
from ..checks import Metres, Seconds, check_int, positive
from ..field_docs import lists_fields
from ..graphs import Graph, GraphLike
from ..limits import LONGEST_NAME, MOST_OBSTACLES, MOST_ROBOTS, MOST_STEPS
from ..obstacles import parsing as obstacles
from ..obstacles.parsing import Obstacles
from ..rewards.costs import as_costs
from ..rewards.terms import RewardWeights
from ..robots.robot_models import ROBOT_MODELS, RobotModel, try_with
from ..sensors.sensing import Sensing
from . import scenario_files
from .observation_layout import ObservationLayout
from .start_options import check_apart, check_positions, check_table

CONTACT_MODES = ("slide", "stop", "ignore")
Table = tuple[tuple[float, ...], ...]


class TimeStepWarning(UserWarning):
    """The time step is longer than the certified one, so V may rise between merges."""


def _check_name(field: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST_NAME or not value.isprintable():
        checks.raise_invalid(field, value, f"a word of at most {LONGEST_NAME} printable characters")
    return value


def _check_dim(field: str, value: Any) -> int:
    if not checks.is_int(value) or value not in (2, 3):
        checks.raise_invalid(field, value, "2 or 3")
    return int(value)


@lists_fields
@checks.names_unknown_fields("scenario")
@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One experiment: the team, its graph, the world, the clock and the reward.

    Instances are immutable, hashable and equal when their fields are. Derived constants of
    theory.md sections 3 and 4 (``certified_step``, ``bottleneck_weight``, …) are properties.
    The largest and smallest numbers that a field takes stand in ``limits.py``.

    Raises:
        ValueError: naming the field, its value and what would be right.
        UnknownFieldError: for an unknown field, naming the nearest one; it is both a ValueError and
            a TypeError.
    """

    name: Annotated[str, _check_name] = "custom"
    """What tables and files call it."""
    n_robots: Annotated[int, partial(check_int, least=2, most=MOST_ROBOTS)] = 5
    """Number of robots n, at least 2."""
    dim: Annotated[int, _check_dim] = 2
    """Dimension d of the space, 2 or 3."""
    robot_model: Annotated[str, partial(checks.choice, choices=ROBOT_MODELS)] = "single_integrator"
    """single_integrator or double_integrator (2-D or 3-D), unicycle (2-D), nonholonomic_3d (3-D),
    or one that has been registered."""
    graph: GraphLike = dataclasses.field(default_factory=graphs.complete)
    """Who sees whom: a Graph, the name of one, a symmetric (n, n) matrix of weights a_ij in m/s,
    dense or sparse, a list of edges (i, j) or (i, j, a_ij), or a networkx graph."""
    require_connected: bool = True
    """Refuse a graph that is not connected: its robots can never all meet (theorem 1). A directed
    one must have a robot that is reached from all, a switching one taken together; with a proximity
    graph starts are drawn connected."""
    merge_radius: Metres = 0.2
    """r in m: neighbours that come this close become one robot."""
    body_radius: Metres | None = None
    """Of the disc or sphere that a robot is, m, at most r/2; everyone has to see everyone then.
    None is a point, which hides others as a disc of r/2 where ``sensing`` lets robots hide."""
    meeting: Literal["merge", "pack"] = "merge"
    """merge, or pack: bodies stop where they would touch, and have met when they lie in one cluster
    in which each is within r of two others. Robots see none of those they touch, unless they touch
    all. In the plane, without obstacles."""
    time_step: Seconds | None = None
    """τ in s; None is the certified step r/(2D̄), with which V cannot rise between merges under
    laws (1) and (4) on fixed undirected graphs; for 48 single integrators or more on a sparse graph
    r/(2D), D the ``step_degree``, to which laws and wrappers scale velocities."""
    allow_long_step: bool = False
    """Do not warn about a time step longer than the certified one: it is meant."""
    time_limit: Seconds = 30.0
    """Length of an episode in s; rounded up to whole steps."""
    max_speed: Annotated[float, partial(positive, unit="m/s")] | None = None
    """v_max in m/s, direction kept; None is D̄, which law (1) never exceeds; from 48 single
    integrators on, where the graph is sparse, the ``step_degree``, to which it is then cut."""
    max_turn_rate: Annotated[float, partial(positive, unit="rad/s")] | None = None
    """Largest ω, ω_β in rad/s (ω_α may be ten times larger, see nonholonomic_3d); None is D̄."""
    max_acceleration: Annotated[float, partial(positive, unit="m/s²")] | None = None
    """a_max in m/s² of a double integrator, direction kept; None is v_max per 0.25 s."""
    obstacles: Obstacles = ()
    """Discs, convex polygons, capsules or spheres, or a random field drawn for every episode."""
    obstacle_range: Metres = 2.0
    """An obstacle is seen while its nearest point is within this distance, m."""
    obstacle_slots: int | None = None
    """M, obstacles that an observation has room for; None is as many as there can be. Rows beyond
    those are zero."""
    obstacle_overflow: Literal["error", "nearest"] = "error"
    """Whether fewer ``obstacle_slots`` than obstacles are an error, or show the nearest of those in
    range."""
    obstacle_contact: Literal["slide", "stop", "ignore"] = "slide"
    """At an obstacle: slide along it, stop at it, or ignore it. Obstacles that touch or overlap act
    as their union; gaps of less than 1.8 µm are closed."""
    merge_through_obstacles: bool = True
    """Whether robots merge through an obstacle thinner than ``merge_radius``. With False they merge
    only where no obstacle is between them; until then they may be nearer than r, where V can rise,
    so that the bounds on V (theorems A, C and D) no longer hold. Without obstacles, or where robots
    ignore them, it has no effect. Theorems promise no rendezvous among obstacles either way."""
    neighbour_slots: int | None = None
    """K, neighbour rows of an observation; None is the most neighbours that a robot can have in any
    episode, merges included. Rows beyond n − 1 are zero. With fewer, a robot that comes to have
    more neighbours is an error, unless ``neighbour_overflow`` is "nearest"."""
    neighbour_overflow: Literal["error", "nearest"] = "error"
    """Whether more neighbours than ``neighbour_slots`` are an error, or the nearest are shown. Rows
    that are left out no longer add up to f_i: no theorem holds then."""
    spawn_size: Metres = 10.0
    """Starts are drawn from a square or cube of this edge length about the origin, m."""
    start_positions: Table | None = None
    """(n, d) in m, if the start is given rather than drawn."""
    start_headings: Table | None = None
    """(n, 1) yaw or (n, 2) yaw and pitch in rad, if they are given rather than drawn."""
    local_frames: Literal["random", "global"] = "random"
    """Frames of single integrators: a random fixed rotation for each robot, or the global frame."""
    on_merge: Literal["remove", "follow"] = "remove"
    """A merged-away robot ends (remove), or stays with zero observations (follow)."""
    sensing: Annotated[Sensing, checks.of_class(Sensing)] = dataclasses.field(
        default_factory=Sensing
    )
    """What the robots' sensors get wrong; by default nothing."""
    reward: Annotated[RewardWeights, checks.of_class(RewardWeights)] = dataclasses.field(
        default_factory=RewardWeights
    )
    """Weights of the reward terms."""
    costs: Annotated[tuple[str, ...], as_costs] = ()
    """Costs beside rewards, for learners with constraints: "contact", "rise", "link_lost", or
    registered reward terms; see ``rewards.costs``."""

    def __post_init__(self) -> None:
        checks.check_fields(self)
        if self.dim not in self.model.dims:
            fitting = [repr(m.name) for m in ROBOT_MODELS.values() if self.dim in m.dims]
            wanted = f"one of {', '.join(fitting)} where dim is {self.dim}"
            checks.raise_invalid("robot_model", self.robot_model, wanted)
        self._check_graph()
        self._check_obstacles()
        self._check_bodies()
        self._check_starts()
        self._check_time_step()

    @property
    def sensing_graph(self) -> Graph:
        """The field ``graph`` as a Graph, which it is after construction."""
        return cast(Graph, self.graph)

    @property
    def model(self) -> RobotModel:
        """The robot model; a ValueError where it is not registered, as after another's pickle."""
        return cast(RobotModel, ROBOT_MODELS[self.robot_model])

    @cached_property
    def max_degree(self) -> float:
        """D̄, m/s: the largest D_i = Σ_j a_ij that an episode can produce (theory 4)."""
        return float(self.sensing_graph.max_degree(self.n_robots))

    @cached_property
    def bottleneck_weight(self) -> float:
        """a*, m/s, in the worst case, see ``GraphNumbers.bottleneck_weight`` (theory 3)."""
        return float(self.sensing_graph.bottleneck_weight(self.n_robots))

    @property
    def start_reach(self) -> float:
        """Links up to this length, m, connect every start that is drawn, see ``Graph``."""
        return self.sensing_graph.start_reach(self)

    @property
    def dead_zone(self) -> float:
        """δ = a*/(2n), m/s: below it a certified heading need not follow the net bearing."""
        return self.bottleneck_weight / (2 * self.n_robots)

    @property
    def certified_step(self) -> float:
        """τ = r/(2D̄), s: the longest step for which it is proven that V cannot rise between merges
        under laws (1) and (4) (theory 4); on graphs that are directed or change, half the longest
        with which the hull cannot grow.
        """
        return self._step_for(self.max_degree)

    @cached_property
    def step_degree(self) -> float:
        """The D_i, m/s, that default step and speed are made for: D̄, or less in large sparse graphs
        of single integrators (``GraphNumbers.step_degree``).
        """
        graph = self.sensing_graph
        return float(graph.step_degree(self.n_robots)) if self.model.bounded else self.max_degree

    @property
    def scales_velocity(self) -> bool:
        """Whether the step in force is the default one of a large sparse graph, longer than
        certified: laws then scale their velocities by r/(2 D_i τ) where that is below 1 (theory 4).
        """
        return self.time_step is None and self.step_degree < self.max_degree

    @property
    def tau(self) -> float:
        """τ, s: the step in force, r/(2D) with D the ``step_degree`` if none is given."""
        return self._step_for(self.step_degree) if self.time_step is None else self.time_step

    def _step_for(self, degree: float) -> float:
        return self.merge_radius / (2 * degree) if degree > 0 else math.inf

    @property
    def merges_through(self) -> bool:
        """Whether any two neighbours that come within r merge."""
        nothing = not self.obstacles and not self.obstacle_slots  # nor given to any reset
        return self.merge_through_obstacles or nothing or self.obstacle_contact == "ignore"

    @property
    def max_steps(self) -> int:
        """Steps until the time limit."""
        return max(1, math.ceil(self.time_limit / self.tau - 1e-9))

    @property
    def speed_limit(self) -> float:
        """v_max in force, m/s."""
        return self.step_degree if self.max_speed is None else self.max_speed

    @property
    def acceleration_limit(self) -> float:
        """Largest acceleration in force, m/s²."""
        return 4.0 * self.speed_limit if self.max_acceleration is None else self.max_acceleration

    @property
    def turn_limit(self) -> float:
        """Largest turn rate in force, rad/s."""
        return self.max_degree if self.max_turn_rate is None else self.max_turn_rate

    @property
    def action_size(self) -> int:
        """Numbers in one robot's action."""
        return len(self.action_bounds)

    @cached_property
    def action_bounds(self) -> NDArray[np.float64]:
        """Symmetric bound on each number of an action, (a,): m/s, m/s², or m/s and rad/s."""
        return np.array(self.model.bounds(self), dtype=np.float64)

    @cached_property
    def observation_layout(self) -> ObservationLayout:
        """Which row of an observation is what."""
        slots, most = self.obstacle_slots, self.sensing_graph.most_neighbours(self.n_robots)
        return ObservationLayout(
            dim=self.dim,
            neighbour_slots=self.neighbour_slots or most,
            obstacle_slots=obstacles.max_count(self.obstacles) if slots is None else slots,
            senses_gravity=self.model.senses == "gravity",
            senses_velocity=self.model.senses == "velocity",
        )

    @property
    def drops_neighbours(self) -> bool:
        """Whether a robot may have more neighbours than rows, and only the nearest are shown."""
        slots, most = self.neighbour_slots, self.sensing_graph.most_neighbours(self.n_robots)
        return self.neighbour_overflow == "nearest" and slots is not None and slots < most

    @cached_property
    def with_all_rows(self) -> Scenario:
        """The scenario itself, or with a row for each other robot and each obstacle where its own
        layout has more rows than robots, or drops some.
        """
        changes: dict[str, Any] = {}
        if self.drops_neighbours or (self.neighbour_slots or 0) > self.n_robots - 1:
            changes["neighbour_slots"] = self.n_robots - 1
        if (slots := self.obstacle_slots) is not None and slots < obstacles.max_count(
            self.obstacles
        ):
            changes["obstacle_slots"] = None
        return self.replace(allow_long_step=True, **changes) if changes else self

    def replace(self, **changes: Any) -> Scenario:
        """A copy with some fields changed; starts of another shape have to be given anew."""
        return dataclasses.replace(self, **changes)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Scenario:
        """Read a scenario from a TOML file, whose name it has if none is given.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: for text that is not TOML, an unknown key or an impossible value.
        """
        plain = scenario_files.read(path)
        try:
            return cls.from_plain({"name": Path(path).stem, **plain})
        except ValueError as error:
            raise ValueError(f"{checks.short_repr(str(path))[1:-1]}: {error}") from error

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Scenario:
        """A scenario from plain data, as TOML or JSON hold it; checked as ever."""
        checks.mapping("a scenario's plain data", plain, "a mapping of fields to values")
        return checks.from_plain(cls, plain, "scenario")

    def to_plain(self) -> dict[str, Any]:
        """Plain data, of which ``from_plain`` makes an equal scenario; None is an absent key."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain["graph"] = self.sensing_graph.to_plain()
        plain["obstacles"] = obstacles.to_plain(self.obstacles) or None
        plain["reward"] = self.reward.to_plain()
        plain["sensing"] = None if self.sensing.exact else self.sensing.to_plain()
        plain["costs"] = list(self.costs) or None
        plain["merge_through_obstacles"] = False if not self.merge_through_obstacles else None
        for key in ("neighbour_overflow", "obstacle_overflow"):  # younger than files of scenarios
            plain[key] = None if plain[key] == "error" else plain[key]
        for key in ("start_positions", "start_headings"):
            plain[key] = plain[key] and [list(row) for row in plain[key]]
        return {key: value for key, value in plain.items() if value is not None}

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write a TOML file that ``from_toml`` reads back as an equal scenario."""
        scenario_files.write(path, self.to_plain())

    def _check_graph(self) -> None:
        graph = graphs.parse(self.graph, self.n_robots)
        object.__setattr__(self, "graph", graph)
        why = graph.why_not_joined(self.n_robots)
        if why is not None and self.require_connected:
            raise ValueError(f"graph is not connected: {why}, or pass require_connected=False")
        self._check_slots("neighbour_slots", 1, MOST_ROBOTS, "a whole number from 1 to")

    def _check_slots(self, field: str, least: int, most: int, wanted: str) -> None:
        slots = getattr(self, field)
        if slots is not None and not (checks.is_int(slots) and least <= slots <= most):
            checks.raise_invalid(field, slots, f"None or {wanted} {most}")

    def _check_obstacles(self) -> None:
        parsed = obstacles.parse(self.obstacles, self.dim)
        object.__setattr__(self, "obstacles", parsed)
        count = obstacles.max_count(parsed)
        if count > MOST_OBSTACLES:
            raise ValueError(f"obstacles: {count} were given; at most {MOST_OBSTACLES} may be")
        wanted = (
            f"at least the number of obstacles, {count}, unless obstacle_overflow is 'nearest', "
            "and at most"
        )
        least = 0 if self.obstacle_overflow == "nearest" else count
        self._check_slots("obstacle_slots", least, MOST_OBSTACLES, wanted)

    def _check_bodies(self) -> None:
        """Bodies do not overlap: they dock at r, where every pair does, or stop (guarantees 13)."""
        packs, n, radius = self.meeting == "pack", self.n_robots, self.body_radius
        if radius is None:
            if packs:
                checks.raise_invalid("body_radius", None, "given with meeting='pack': bodies touch")
            return
        if radius > 0.5 * self.merge_radius:
            most = f"at most half the merge_radius, {0.5 * self.merge_radius} m"
            checks.raise_invalid("body_radius", radius, most)
        graph = self.sensing_graph
        if graph.directed or not graph.fixed or graph.most_links(n) < n * (n - 1) // 2:
            raise ValueError("graph must be complete with a body_radius: others would not stop")
        if not self.merges_through:
            wanted = "True with a body_radius: bodies on both sides of a wall would overlap"
            checks.raise_invalid("merge_through_obstacles", False, wanted)
        free = self.dim == 2 and not self.obstacles
        if packs and not (free and self.robot_model == "single_integrator"):
            raise ValueError(
                f"meeting is 'pack'; it must be 'merge' for {self.robot_model} robots in "
                f"{self.dim}-D{' among obstacles' if self.obstacles else ''}: bodies pack as "
                "single integrators in the plane, without obstacles"
            )

    def _check_starts(self) -> None:
        widths = {"start_positions": self.dim, "start_headings": self.model.n_angles}
        for field, width in widths.items():
            if getattr(self, field) is not None:
                table = check_table(field, getattr(self, field), (self.n_robots, width))
                object.__setattr__(self, field, tuple(map(tuple, table.tolist())))
        if self.start_positions is not None:
            positions, weights = np.array(self.start_positions), self.sensing_graph.sparse_weights
            check_positions("start_positions", self, positions, weights, self.obstacles)
            if self.body_radius is not None:
                check_apart("start_positions", positions, 2.0 * self.body_radius)

    def _check_time_step(self) -> None:
        if self.time_step is None and not math.isfinite(self.certified_step):
            wanted = "given where the graph has no edge: no step is certified"
            checks.raise_invalid("time_step", None, wanted)
        self.sensing_graph.check_fits(self)
        if self.max_steps > MOST_STEPS:
            raise ValueError(
                f"time_limit is {self.time_limit:g} s: {self.max_steps:.3g} steps of {self.tau:g} "
                f"s; it must be at most {MOST_STEPS:.3g} steps"
            )
        allowed = self.allow_long_step or self.scales_velocity
        if not allowed and self.tau > self.certified_step * (1 + 1e-12):
            warnings.warn(
                f"time_step is {self.tau:.6g} s, longer than the certified step "
                f"{self.certified_step} s: V may rise between merges unless velocities are "
                "scaled (theory 4); pass allow_long_step=True if this is meant",
                TimeStepWarning,
                stacklevel=_frames_to_caller(),
            )


def _frames_to_caller() -> int:
    """How far up the stack the code stands that made the scenario: its line is warned of."""

    def inside(frame: Any) -> bool:
        module = frame.f_globals.get("__name__", "")
        return module.startswith(("rendezvous_env.", "dataclasses")) or (
            frame.f_code.co_name == "__init__"
        )

    level, frame = 1, sys._getframe(1)
    while frame.f_back and inside(frame):
        frame, level = frame.f_back, level + 1
    return level


try_with(lambda model, dim: Scenario(dim=dim, robot_model=model))
