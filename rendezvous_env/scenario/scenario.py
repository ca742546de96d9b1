"""Scenario: the complete, immutable and validated description of one experiment."""

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

from .. import checks, field_checks, graphs
from ..checks import check_int, positive
from ..field_checks import Metres, Seconds
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..graphs import Graph, GraphLike
from ..limits import LONGEST_NAME, MAX_OBSTACLES, MAX_ROBOTS, MAX_STEPS
from ..obstacles import parsing as obstacles
from ..obstacles import spatial_index
from ..obstacles.parsing import Obstacles
from ..rewards.costs import as_costs
from ..rewards.terms import RewardWeights
from ..robots.activation import Activation, ActivationLike, as_activation
from ..robots.events import Events
from ..robots.mixed_team import check_members, mixed_model
from ..robots.robot_models import ROBOT_MODELS, RobotModel, try_with
from ..sensors.robot_sensors import as_sensing
from ..sensors.sensing import Sensing
from . import scenario_files
from .observation_layout import ObservationLayout
from .start_options import check_apart, check_positions, check_table
from .start_region import Region, check_region, starts_in

CONTACT_MODES = ("slide", "stop", "ignore")
_PACKING = ("single_integrator", "unicycle")
"""Robot models whose bodies may pack."""
Table = tuple[tuple[float, ...], ...]
PER_ROBOT = ("robot_model", "max_speed", "max_turn_rate", "max_acceleration", "body_radius")
"""Fields with one value for all robots, or a list with one for each."""


def _limit(unit: str) -> Any:
    """Check of a positive limit of all robots, or of a list with one for each."""
    return partial(checks.one_or_each, check=partial(positive, unit=unit), unit=unit)


_Each = float | tuple[float, ...]


class TimeStepWarning(UserWarning):
    """Time step longer than the certified one, so V may increase between merges."""


def _check_name(field: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST_NAME or not value.isprintable():
        checks.raise_invalid(field, value, f"a word of at most {LONGEST_NAME} printable characters")
    return value


def _check_dim(field: str, value: Any) -> int:
    if not checks.is_int(value) or value not in (2, 3):
        checks.raise_invalid(field, value, "2 or 3")
    return int(value)


@lists_fields
@field_checks.names_unknown_fields("scenario")
@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Complete description of an experiment: robots, graph, obstacles, time step and reward.

    Instances are immutable and hashable; equality compares all fields. Derived constants of
    theory.md sections 3 and 4 (``certified_step``, ``bottleneck_weight``, …) are properties.
    Numeric limits of the fields are constants in ``limits.py``.

    Raises:
        ValueError: for an invalid field; the message gives the field, its value and a remedy.
        UnknownFieldError: for an unknown field; the message gives the closest known one. It is both
            a ValueError and a TypeError.
    """

    name: Annotated[str, _check_name] = "custom"
    """Name in tables and files."""
    n_robots: Annotated[int, partial(check_int, least=2, most=MAX_ROBOTS)] = 5
    """Number of robots n, at least 2."""
    dim: Annotated[int, _check_dim] = 2
    """Dimension d of the workspace, 2 or 3."""
    robot_model: Annotated[
        str | tuple[str, ...],
        partial(checks.one_or_each, check=partial(checks.choice, choices=ROBOT_MODELS)),
    ] = "single_integrator"
    """Robot model: single_integrator or double_integrator (2-D or 3-D), unicycle (2-D),
    nonholonomic_3d (3-D), or a registered name. A list with one name for each robot mixes at most
    three models."""
    graph: GraphLike = dataclasses.field(default_factory=graphs.complete)
    """Sensing graph: a Graph, a name, a list of edges (i, j) or (i, j, a_ij), or a networkx
    graph. Also a symmetric (n, n) matrix of weights a_ij in m/s, dense or sparse."""
    require_connected: bool = True
    """Reject a graph that is not connected, on which rendezvous is impossible (theorem 1). A
    directed graph needs a robot that is reachable from all others; for a switching graph the union
    is checked. With a proximity graph, initial conditions are sampled connected."""
    merge_radius: Metres = 0.2
    """Merge radius r, m: neighbours at most this far apart merge into one robot."""
    body_radius: Annotated[_Each, _limit("m")] | None = None
    """Radius of each robot's disc or sphere, m, at most r/2, or a list with one for each robot;
    requires a complete graph. None is a point robot; with occlusion by robots in ``sensing``,
    points occlude as discs of radius r/2."""
    meeting: Literal["merge", "pack"] = "merge"
    """Terminal condition. "merge": robots merge within r. "pack": bodies stop on contact and
    rendezvous is one cluster in which each robot is within r of two others. With "pack", robots
    do not observe robots in contact, unless all are. "pack" requires 2-D, no obstacles, and
    single integrators or unicycles."""
    time_step: Seconds | None = None
    """Time step τ, s. None is the certified step r/(2D̄), for which V cannot increase between
    merges under laws (1) and (4) on fixed undirected graphs. For sparse graphs of 48 or more
    single integrators, None is r/(2D), with D the ``step_degree``; laws and wrappers then scale
    velocities."""
    allow_long_step: bool = False
    """Suppress the warning about a time step longer than the certified one."""
    time_limit: Seconds = 30.0
    """Episode length, s, rounded up to whole steps."""
    max_speed: Annotated[_Each, _limit("m/s")] | None = None
    """Speed limit v_max, m/s, or a list with one for each robot; limiting preserves the
    direction. None is D̄, which law (1) never exceeds. For sparse graphs of 48 or more single
    integrators, None is the ``step_degree``."""
    max_turn_rate: Annotated[_Each, _limit("rad/s")] | None = None
    """Turn rate limit of ω and ω_β, rad/s, or a list with one for each robot; None is D̄. The
    limit of ω_α is up to ten times larger, see nonholonomic_3d."""
    max_acceleration: Annotated[_Each, _limit("m/s²")] | None = None
    """Acceleration limit a_max of double integrators, m/s², or a list with one for each robot;
    limiting preserves the direction. None, the default, is v_max per 0.25 s."""
    obstacles: Obstacles = ()
    """Discs, convex polygons, capsules or spheres, or a random field sampled in each episode."""
    obstacle_range: Metres = 2.0
    """Sensing range of obstacles, m, measured to the nearest point."""
    obstacle_slots: int | None = None
    """Number of obstacles M in an observation; None is the maximum number of obstacles. Unused
    rows are zero."""
    obstacle_overflow: Literal["error", "nearest"] = "error"
    """Handling of more obstacles than ``obstacle_slots``: an error, or only the nearest in range
    are observed."""
    obstacle_contact: Literal["slide", "stop", "ignore"] = "slide"
    """Contact model: slide along the obstacle, stop, or ignore it. Touching or overlapping
    obstacles act as their union; gaps below 1.8 µm are closed."""
    obstacle_push: Literal["push", "stop"] = "push"
    """Moving obstacles ("rv.Moving") push robots, or stop at them until the path is free. They stop
    in either case if a robot is between the obstacle and a wall."""
    merge_through_obstacles: bool = True
    """True if robots merge through an obstacle thinner than ``merge_radius``. With False they
    merge only if no obstacle is between them. Until then they may be closer than r and V can
    increase, so the bounds on V (theorems A, C and D) do not hold. No effect without obstacles
    or if contact is ignored. Rendezvous among obstacles is not guaranteed in either case."""
    neighbour_slots: int | None = None
    """Number of neighbour rows K in an observation. None is the maximum number of neighbours in
    any episode, merges included. Rows beyond n − 1 are zero. Exceeding it raises an error,
    unless ``neighbour_overflow`` is "nearest"."""
    neighbour_overflow: Literal["error", "nearest"] = "error"
    """Handling of more neighbours than ``neighbour_slots``: an error, or only the nearest are
    observed. The sum of incomplete rows differs from f_i, so no theorem holds."""
    spawn_size: Annotated[float | tuple[float, ...], checks.edge_lengths] = 10.0
    """Edge length of the square or cube about the origin in which initial positions are sampled,
    m. A list of d numbers gives the edges of a rectangle or box."""
    start_region: Annotated[Region, starts_in] | None = None
    """Region in which initial positions are sampled uniformly: disjoint convex polygons of the
    plane, m, within the spawn square. None is the whole square or cube."""
    start_positions: Table | None = None
    """Fixed initial positions, (n, d), m; None samples them."""
    start_headings: Table | None = None
    """Fixed initial headings, rad: (n, 1) yaw, or (n, 2) yaw and pitch; None samples them."""
    local_frames: Literal["random", "global"] = "random"
    """Frames of single integrators: a random fixed rotation per robot, or the global frame."""
    on_merge: Literal["remove", "follow"] = "remove"
    """Agent of a merged robot: it ends ("remove"), or stays with zero observations ("follow")."""
    sensing: Annotated[Sensing, as_sensing] = dataclasses.field(default_factory=Sensing)
    """Sensor imperfections; none by default. A list of n sensors gives each robot its own."""
    reward: Annotated[RewardWeights, field_checks.of_class(RewardWeights)] = dataclasses.field(
        default_factory=RewardWeights
    )
    """Weights of the reward terms."""
    costs: Annotated[tuple[str, ...], as_costs] = ()
    """Costs for constrained learning: "contact", "rise", "link_lost", or registered reward
    terms; see ``rewards.costs``."""

    activation: Annotated[ActivationLike, as_activation] = dataclasses.field(
        default_factory=Activation
    )
    """Clocks of the robots: "synchronous", "periodic", "random", "bounded", or an Activation with
    periods, a probability or a bound. The actions of inactive robots are ignored."""
    hold: Literal["command", "stop"] = "command"
    """Inactive robots repeat their last command, or have zero action. No effect with synchronous
    activation."""

    events: Annotated[Events, field_checks.of_class(Events)] = dataclasses.field(
        default_factory=Events
    )
    """Failures and disturbances of robots: crashes, sensor failures, adversaries, drift of local
    frames, slip and velocity disturbances. None by default."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        self._check_lists()  # before lists of equal entries become one value
        field_checks.check_fields(self)
        if self.mixes_models:
            check_members(self.robot_model, self.models, self.dim)  # type: ignore[arg-type]
        if self.dim not in self.model.dims:
            fitting = [repr(m.name) for m in ROBOT_MODELS.values() if self.dim in m.dims]
            wanted = f"one of {', '.join(fitting)} where dim is {self.dim}"
            checks.raise_invalid("robot_model", self.robot_model, wanted)
        object.__setattr__(self, "sensing", self.sensing.of_team(self.n_robots))
        self._check_graph()
        self._check_obstacles()
        self._check_bodies()
        self._check_starts()
        self._check_time_step()
        self.sensing.check_delay(self.tau)
        self.activation.check_fits(self.n_robots)
        self.events.check_fits(self)

    @property
    def sensing_graph(self) -> Graph:
        """``graph`` as a Graph, which it is after construction."""
        return cast(Graph, self.graph)

    @property
    def model(self) -> RobotModel:
        """Robot model; ValueError if it is not registered, e.g. after unpickling.

        A mixed team has a model of its own, see ``robots.mixed_team``.
        """
        if isinstance(self.robot_model, tuple):
            return mixed_model(self.models)
        return cast(RobotModel, ROBOT_MODELS[self.robot_model])

    @property
    def models(self) -> tuple[RobotModel, ...]:
        """Different robot models of the team, by name."""
        given = self.robot_model
        names = sorted(set(given)) if isinstance(given, tuple) else [given]
        return tuple(cast(RobotModel, ROBOT_MODELS[name]) for name in names)

    @property
    def mixes_models(self) -> bool:
        """True if robots of the team have different models."""
        return isinstance(self.robot_model, tuple)

    @cached_property
    def nonholonomic_robots(self) -> NDArray[np.bool_]:
        """True for robots that move along their body axis only, (n,)."""
        given = self.robot_model
        names = given if isinstance(given, tuple) else (given,) * self.n_robots
        return np.array([ROBOT_MODELS[name].nonholonomic for name in names])

    @cached_property
    def max_degree(self) -> float:
        """Largest weighted degree D_i = Σ_j a_ij possible in an episode, D̄, m/s (theory 4)."""
        return float(self.sensing_graph.max_degree(self.n_robots))

    @cached_property
    def bottleneck_weight(self) -> float:
        """Worst-case bottleneck weight a*, m/s (theory 3); see ``GraphNumbers``."""
        return float(self.sensing_graph.bottleneck_weight(self.n_robots))

    @property
    def start_reach(self) -> float:
        """Link length that connects every sampled initial condition, m; see ``Graph``."""
        return self.sensing_graph.start_reach(self)

    @property
    def spawn_edges(self) -> tuple[float, ...]:
        """Edge lengths of the spawn area, (d,), m."""
        size = self.spawn_size
        return size if isinstance(size, tuple) else (size,) * self.dim

    @property
    def spawn_diagonal(self) -> float:
        """Largest distance between two points of the spawn area, m."""
        size = self.spawn_size
        return math.hypot(*size) if isinstance(size, tuple) else size * math.sqrt(self.dim)

    @property
    def dead_zone(self) -> float:
        """δ = a*/(2n), m/s: for shorter net bearings, certified headings are unconstrained."""
        return self.bottleneck_weight / (2 * self.n_robots)

    @property
    def certified_step(self) -> float:
        """Certified step r/(2D̄), s.

        It is the longest step for which V provably cannot increase between merges under laws (1)
        and (4) (theory 4). On directed or switching graphs it is half the longest step for which
        the hull cannot grow.
        """
        return self._step_for(self.max_degree)

    @cached_property
    def step_degree(self) -> float:
        """Degree D_i, m/s, for the default step and speed.

        It is D̄, or less on large sparse graphs of single integrators
        (``GraphNumbers.step_degree``).
        """
        graph = self.sensing_graph
        return float(graph.step_degree(self.n_robots)) if self.model.bounded else self.max_degree

    @property
    def scales_velocity(self) -> bool:
        """True if the default step of a large sparse graph is in use, longer than certified.

        Laws then scale their velocities by min(1, r/(2 D_i τ)) (theory 4).
        """
        return self.time_step is None and self.step_degree < self.max_degree

    @property
    def tau(self) -> float:
        """Time step τ in use, s; by default r/(2D), with D the ``step_degree``."""
        return self._step_for(self.step_degree) if self.time_step is None else self.time_step

    def _step_for(self, degree: float) -> float:
        return self.merge_radius / (2 * degree) if degree > 0 else math.inf

    @property
    def merges_through(self) -> bool:
        """True if any two neighbours within r merge, obstacles or not."""
        nothing = not self.obstacles and not self.obstacle_slots  # nor given to any reset
        return self.merge_through_obstacles or nothing or self.obstacle_contact == "ignore"

    @property
    def max_steps(self) -> int:
        """Time limit in steps."""
        return max(1, math.ceil(self.time_limit / self.tau - 1e-9))

    @property
    def delay_steps(self) -> int:
        """Delay of observations in steps; the largest of the robots."""
        return int(self.sensing.delays(self.n_robots, self.tau).max())

    @property
    def per_robot(self) -> tuple[str, ...]:
        """Names of the fields that are lists with one value for each robot."""
        return tuple(name for name in PER_ROBOT if isinstance(getattr(self, name), tuple))

    def of_robot(self, robot: int) -> Scenario:
        """Scenario in which all robots have the model and limits of one robot.

        Initial conditions are sampled.
        """
        own = tuple(getattr(self, name)[robot] for name in self.per_robot)
        if not own:
            return self
        if own not in self._variants:
            free: dict[str, Any] = {"start_positions": None, "start_headings": None}
            free["allow_long_step"] = True
            fields = dict(zip(self.per_robot, own, strict=True))
            if self.mixes_models:  # whose defaults depend on the model
                free["time_step"] = self.tau
                fields.setdefault("max_speed", self.speed_limit)
            self._variants[own] = self.replace(**fields, **free)
        return self._variants[own]

    @cached_property
    def _variants(self) -> dict[tuple[Any, ...], Scenario]:
        """Results of ``of_robot`` by the values of a robot."""
        return {}

    @property
    def speed_limit(self) -> float:
        """Speed limit v_max in use, m/s; the largest of the robots."""
        return self.step_degree if self.max_speed is None else _largest(self.max_speed)

    @property
    def min_speed_limit(self) -> float:
        """Speed limit of the slowest robot, m/s."""
        return _least(self.max_speed) if isinstance(self.max_speed, tuple) else self.speed_limit

    @property
    def speed_limits(self) -> NDArray[np.float64]:
        """Speed limit of each robot, (n,), m/s."""
        given = self.max_speed if isinstance(self.max_speed, tuple) else self.speed_limit
        return np.broadcast_to(np.array(given, np.float64), (self.n_robots,))

    @property
    def acceleration_limit(self) -> float:
        """Acceleration limit in use, m/s²; the largest of the robots."""
        given = self.max_acceleration
        return 4.0 * self.speed_limit if given is None else _largest(given)

    @property
    def turn_limit(self) -> float:
        """Turn rate limit in use, rad/s; the largest of the robots."""
        return self.max_degree if self.max_turn_rate is None else _largest(self.max_turn_rate)

    @property
    def min_turn_limit(self) -> float:
        """Smallest turn rate limit of the robots, rad/s."""
        given = self.max_turn_rate
        return _least(given) if isinstance(given, tuple) else self.turn_limit

    @property
    def action_size(self) -> int:
        """Number of action components of one robot."""
        return len(self.action_bounds)

    @cached_property
    def action_bounds(self) -> NDArray[np.float64]:
        """Symmetric bounds of the action components, (a,): m/s, m/s², or m/s and rad/s.

        They are the largest of the robots.
        """
        if not self.per_robot:
            return np.array(self.model.bounds(self), dtype=np.float64)
        return np.asarray(self.robot_bounds.max(axis=0))

    @cached_property
    def robot_bounds(self) -> NDArray[np.float64]:
        """Symmetric bounds of the actions of each robot, (n, a), as ``action_bounds``.

        They are 0 for components that a robot does not have, see ``action_mask``.
        """
        each = np.zeros(self.action_mask.shape)
        each[self.action_mask] = [bound for bounds in self._listed_bounds for bound in bounds]
        return each

    @cached_property
    def action_mask(self) -> NDArray[np.bool_]:
        """True for components of an action that a robot has, (n, a).

        In mixed teams actions are padded to the widest; a robot uses the first components, and the
        others have no effect.
        """
        widths = np.array([len(bounds) for bounds in self._listed_bounds])
        return np.arange(widths.max()) < widths[:, np.newaxis]

    @property
    def pads_actions(self) -> bool:
        """True if robots have different numbers of action components."""
        return self.mixes_models and not bool(self.action_mask.all())

    @cached_property
    def _listed_bounds(self) -> list[list[float]]:
        """Symmetric bounds of the actions of each robot."""
        robots = range(self.n_robots if self.per_robot else 1)
        each = [list(one.model.bounds(one)) for one in map(self.of_robot, robots)]
        return each if self.per_robot else each * self.n_robots

    @cached_property
    def observation_layout(self) -> ObservationLayout:
        """Layout of the observation rows."""
        slots, most = self.obstacle_slots, self.sensing_graph.most_neighbours(self.n_robots)
        return ObservationLayout(
            dim=self.dim,
            neighbour_slots=self.neighbour_slots or most,
            obstacle_slots=obstacles.max_count(self.obstacles) if slots is None else slots,
            senses_gravity=any(model.senses == "gravity" for model in self.models),
            senses_velocity=any(model.senses == "velocity" for model in self.models),
        )

    @property
    def drops_neighbours(self) -> bool:
        """True if only the nearest neighbours are observed, since there may be more than rows."""
        slots, most = self.neighbour_slots, self.sensing_graph.most_neighbours(self.n_robots)
        return self.neighbour_overflow == "nearest" and slots is not None and slots < most

    @property
    def obstacle_places(self) -> int:
        """Maximum number of obstacles in an episode."""
        return max(obstacles.max_count(self.obstacles), self.observation_layout.obstacle_slots)

    @property
    def indexes_obstacles(self) -> bool:
        """True if a spatial index is used: for many given obstacles in 2-D."""
        given = self.obstacles if self.dim == 2 and isinstance(self.obstacles, tuple) else ()
        many = len(given) > 0 and self.obstacle_places >= spatial_index.INDEX_FROM
        return many and all(isinstance(one, spatial_index.SHAPES) for one in given)

    @cached_property
    def with_all_rows(self) -> Scenario:
        """Scenario with one row for each other robot and each obstacle.

        It is the scenario itself, unless its layout has more rows than robots or omits some. Exact
        sensors with a spatial index select the nearest obstacles themselves.
        """
        changes: dict[str, Any] = {}
        if self.drops_neighbours or (self.neighbour_slots or 0) > self.n_robots - 1:
            changes["neighbour_slots"] = self.n_robots - 1
        selects = self.indexes_obstacles and self.sensing.exact
        if self.observation_layout.obstacle_slots < self.obstacle_places and not selects:
            changes["obstacle_slots"] = None
        return self.replace(allow_long_step=True, **changes) if changes else self

    def replace(self, **changes: Any) -> Scenario:
        """Return a copy with changed fields.

        Given initial conditions of another shape must be given again.
        """
        return dataclasses.replace(self, **changes)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Scenario:
        """Read a scenario from a TOML file; its default name is the file name.

        Obstacles may be a table of kind "map" that refers to a map file, see docs/maps.md.

        Raises:
            FileNotFoundError: if the file does not exist.
            ValueError: for invalid TOML, an unknown key or an invalid value.
        """
        plain = scenario_files.read(path)
        try:
            plain = scenario_files.with_map(plain, Path(path).parent)
            return cls.from_plain({"name": Path(path).stem, **plain})
        except ValueError as error:
            raise ValueError(f"{checks.short_repr(str(path))[1:-1]}: {error}") from error

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Scenario:
        """Create a scenario from plain TOML or JSON data, with validation."""
        checks.mapping("a scenario's plain data", plain, "a mapping of fields to values")
        return field_checks.from_plain(cls, plain, "scenario")

    def to_plain(self) -> dict[str, Any]:
        """Return plain data for ``from_plain``; fields of None are omitted."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain["graph"] = self.sensing_graph.to_plain()
        plain["obstacles"] = obstacles.to_plain(self.obstacles) or None
        plain["reward"] = self.reward.to_plain()
        plain["sensing"] = None if self.sensing.exact else self.sensing.to_plain()
        plain["costs"] = list(self.costs) or None
        plain["start_region"] = self.start_region and [
            [list(vertex) for vertex in polygon.vertices] for polygon in self.start_region
        ]
        plain |= {name: list(getattr(self, name)) for name in self.per_robot}
        plain["obstacle_push"] = None if self.obstacle_push == "push" else self.obstacle_push
        clocks = self.activation
        plain["activation"] = None if clocks.synchronous else clocks.to_plain()
        plain["events"] = self.events.to_plain() or None
        plain["hold"] = None if self.hold == "command" else self.hold
        plain["merge_through_obstacles"] = False if not self.merge_through_obstacles else None
        for key in ("neighbour_overflow", "obstacle_overflow"):  # added after the file format
            plain[key] = None if plain[key] == "error" else plain[key]
        if isinstance(self.spawn_size, tuple):
            plain["spawn_size"] = list(self.spawn_size)
        for key in ("start_positions", "start_headings"):
            plain[key] = plain[key] and [list(row) for row in plain[key]]
        return {key: value for key, value in plain.items() if value is not None}

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write a TOML file from which ``from_toml`` reads an equal scenario."""
        scenario_files.write(path, self.to_plain())

    def _check_lists(self) -> None:
        """Check that each list of limits or sensors has one entry for each robot."""
        if not checks.is_int(self.n_robots):
            return  # rejected later
        for name in (*PER_ROBOT, "sensing"):
            given = getattr(self, name)
            if checks.is_sequence(given) and len(given) not in (0, self.n_robots):
                remedy = f"{self.n_robots} entries, one for each robot, or a single one for all"
                checks.raise_invalid(name, list(given), remedy)

    def _check_graph(self) -> None:
        graph = graphs.parse(self.graph, self.n_robots)
        object.__setattr__(self, "graph", graph)
        why = graph.connectivity_error(self.n_robots)
        if why is not None and self.require_connected:
            raise ValueError(f"graph is not connected: {why}, or pass require_connected=False")
        self._check_slots("neighbour_slots", 1, MAX_ROBOTS, "an integer from 1 to")

    def _check_slots(self, field: str, least: int, most: int, wanted: str) -> None:
        slots = getattr(self, field)
        if slots is not None and not (checks.is_int(slots) and least <= slots <= most):
            checks.raise_invalid(field, slots, f"None or {wanted} {most}")

    def _check_obstacles(self) -> None:
        parsed = obstacles.parse(self.obstacles, self.dim)
        object.__setattr__(self, "obstacles", parsed)
        count = obstacles.max_count(parsed)
        if count > MAX_OBSTACLES:
            raise ValueError(f"obstacles: {count} were given; at most {MAX_OBSTACLES} may be")
        wanted = (
            f"at least the number of obstacles, {count}, unless obstacle_overflow is 'nearest', "
            "and at most"
        )
        least = 0 if self.obstacle_overflow == "nearest" else count
        self._check_slots("obstacle_slots", least, MAX_OBSTACLES, wanted)

    def _check_bodies(self) -> None:
        """Check that bodies cannot overlap: pairs merge at r, or bodies stop (guarantees 13)."""
        packs, n, radius = self.meeting == "pack", self.n_robots, self.body_radius
        if radius is None:
            if packs:
                checks.raise_invalid("body_radius", None, "given with meeting='pack': bodies touch")
            return
        if packs and isinstance(radius, tuple):
            checks.raise_invalid("body_radius", list(radius), "one number with meeting='pack'")
        if _largest(radius) > 0.5 * self.merge_radius:
            most = f"at most half the merge_radius, {0.5 * self.merge_radius} m"
            checks.raise_invalid("body_radius", radius, most)
        graph = self.sensing_graph
        if graph.directed or not graph.fixed or graph.most_links(n) < n * (n - 1) // 2:
            raise ValueError(
                "graph must be complete with a body_radius: unlinked robots would overlap"
            )
        if not self.merges_through:
            wanted = "True with a body_radius: bodies on both sides of a wall would overlap"
            checks.raise_invalid("merge_through_obstacles", False, wanted)
        free = self.dim == 2 and not self.obstacles
        if packs and not (free and self.robot_model in _PACKING):
            if self.mixes_models:
                wanted = f"'merge' for the robot models {', '.join(sorted(set(self.robot_model)))}"
                checks.raise_invalid("meeting", "pack", f"{wanted}: only one model can pack")
            raise ValueError(
                f"meeting is 'pack'; it must be 'merge' for {self.robot_model} robots in "
                f"{self.dim}-D{' among obstacles' if self.obstacles else ''}: bodies pack as "
                "single integrators or unicycles, without obstacles"
            )

    def _check_starts(self) -> None:
        size = self.spawn_size
        if isinstance(size, tuple) and len(size) != self.dim:
            wanted = f"a number, or {self.dim} numbers where dim is {self.dim}"
            checks.raise_invalid("spawn_size", list(size), wanted)
        check_region(self)
        widths = {"start_positions": self.dim, "start_headings": self.model.n_angles}
        for field, width in widths.items():
            if getattr(self, field) is not None:
                table = check_table(field, getattr(self, field), (self.n_robots, width))
                object.__setattr__(self, field, tuple(map(tuple, table.tolist())))
        if self.start_positions is not None:
            positions, weights = np.array(self.start_positions), self.sensing_graph.sparse_weights
            check_positions("start_positions", self, positions, weights, self.obstacles)
            if self.body_radius is not None:
                check_apart("start_positions", positions, self.body_radius)

    def _check_time_step(self) -> None:
        if self.time_step is None and not math.isfinite(self.certified_step):
            wanted = "given where the graph has no edge: no step is certified"
            checks.raise_invalid("time_step", None, wanted)
        self.sensing_graph.check_fits(self)
        if self.max_steps > MAX_STEPS:
            raise ValueError(
                f"time_limit is {self.time_limit:g} s: {self.max_steps:.3g} steps of {self.tau:g} "
                f"s; it must be at most {MAX_STEPS:.3g} steps"
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


def _largest(given: float | tuple[float, ...]) -> float:
    return max(given) if isinstance(given, tuple) else given


def _least(given: float | tuple[float, ...]) -> float:
    return min(given) if isinstance(given, tuple) else given


def _frames_to_caller() -> int:
    """Stack depth of the code that created the scenario, to which warnings refer."""

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
