"""Scenario: everything one experiment is, checked once and then immutable."""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import tomllib
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from . import graphs, obstacles, packing
from .graphs import Graph, GraphLike
from .observation_layout import ObservationLayout
from .obstacles import ObstacleField, Obstacles
from .rewards import RewardWeights
from .robot_models import ROBOT_MODELS, RobotModel

CONTACT_MODES = ("slide", "stop", "ignore")
LOCAL_FRAMES = ("random", "global")
ON_MERGE = ("remove", "follow")
Table = tuple[tuple[float, ...], ...]


class TimeStepWarning(UserWarning):
    """The time step is longer than the certified one, so V may rise between merges."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One experiment: the team, its graph, the world, the clock and the reward.

    Instances are immutable, hashable and equal when their fields are. Derived constants of
    theory.md sections 3 and 4 (``certified_step``, ``bottleneck_weight``, …) are properties.

    Raises:
        ValueError: naming the field, its value and what would be right.
    """

    name: str = "custom"
    """What tables and files call it."""
    n_robots: int = 5
    """Number of robots n, at least 2."""
    dim: int = 2
    """Dimension d of the space, 2 or 3."""
    robot_model: str = "single_integrator"
    """single_integrator or double_integrator (2-D or 3-D), unicycle (2-D), nonholonomic_3d (3-D),
    or one that has been registered."""
    graph: GraphLike = dataclasses.field(default_factory=graphs.complete)
    """Who sees whom: a Graph, the name of one, or a symmetric (n, n) matrix of weights a_ij in
    m/s."""
    require_connected: bool = True
    """Refuse a graph that is not connected: its robots can never all meet (theorem 1)."""
    merge_radius: float = 0.2
    """r in m: neighbours that come this close become one robot."""
    time_step: float | None = None
    """τ in s; None is the certified step r/(2D̄), with which V cannot rise between merges."""
    allow_long_step: bool = False
    """Do not warn about a time step longer than the certified one: it is meant."""
    time_limit: float = 30.0
    """Length of an episode in s; rounded up to whole steps."""
    max_speed: float | None = None
    """v_max in m/s, direction kept; None is D̄, which law (1) never exceeds."""
    max_turn_rate: float | None = None
    """Largest ω, ω_β in rad/s (ω_α may be ten times larger, see nonholonomic_3d); None is D̄."""
    max_acceleration: float | None = None
    """a_max in m/s² of a double integrator, direction kept; None is v_max per 0.25 s."""
    obstacles: Obstacles | ObstacleField = ()
    """Discs, convex polygons, capsules or spheres, or a random field drawn for every episode."""
    obstacle_range: float = 2.0
    """An obstacle is seen while its nearest point is within this distance, m."""
    obstacle_slots: int | None = None
    """M, obstacles that an observation has room for; None is as many as there can be."""
    obstacle_contact: str = "slide"
    """At an obstacle: slide along it, stop at it, or ignore it."""
    neighbour_slots: int | None = None
    """K, neighbour rows of an observation; None is the most neighbours that a robot can have in any
    episode, merges included. With fewer, a robot that comes to have more is an error."""
    spawn_size: float = 10.0
    """Starts are drawn from a square or cube of this edge length about the origin, m."""
    start_positions: Table | None = None
    """(n, d) in m, if the start is given rather than drawn."""
    start_headings: Table | None = None
    """(n, 1) yaw or (n, 2) yaw and pitch in rad, if they are given rather than drawn."""
    local_frames: str = "random"
    """Frames of single integrators: a random fixed rotation for each robot, or the global frame."""
    on_merge: str = "remove"
    """A merged-away robot ends (remove), or stays with zero observations (follow)."""
    reward: RewardWeights = dataclasses.field(default_factory=RewardWeights)
    """Weights of the reward terms."""

    def __post_init__(self) -> None:
        """Convert and check every field; see the class for what is raised."""
        self._check_team()
        self._check_numbers()
        self._check_choices()
        self._check_graph()
        self._check_obstacles()
        self._check_starts()
        self._check_time_step()

    # ---- construction -------------------------------------------------------------------------

    def replace(self, **changes: Any) -> Scenario:
        """A copy with some fields changed; starts of another shape have to be given anew.

        Raises:
            ValueError: for an unknown field, naming the nearest one, or an impossible value.
        """
        _check_keys(changes, [field.name for field in dataclasses.fields(self)], "scenario")
        return dataclasses.replace(self, **changes)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Scenario:
        """Read a scenario from a TOML file; an absent key has its default, and a scenario without
        a name that of the file.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: for text that is not TOML, an unknown key or an impossible value.
        """
        text = Path(path).read_text(encoding="utf-8")
        try:
            plain = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{path}: not a TOML file: {error}") from error
        return cls.from_plain({"name": Path(path).stem, **plain})

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Scenario:
        """A scenario from plain data, as TOML or JSON hold it."""
        _check_keys(plain, [field.name for field in dataclasses.fields(cls)], "scenario")
        reward = dict(plain.get("reward", {}))
        _check_keys(reward, [f.name for f in dataclasses.fields(RewardWeights)], "reward")
        return cls(**{**plain, "reward": RewardWeights(**reward)})

    def to_plain(self) -> dict[str, Any]:
        """The scenario as plain data; ``from_plain`` gives an equal scenario. None is an absent
        key.
        """
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain["graph"] = self.sensing_graph.to_plain()
        plain["obstacles"] = obstacles.to_plain(self.obstacles)
        plain["reward"] = dataclasses.asdict(self.reward)
        for key in ("start_positions", "start_headings"):
            if plain[key] is not None:
                plain[key] = [list(row) for row in plain[key]]
        if not plain["obstacles"]:
            del plain["obstacles"]
        return {key: value for key, value in plain.items() if value is not None}

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the scenario to a TOML file that ``from_toml`` reads back as an equal scenario."""
        import tomli_w

        temporary = Path(f"{path}.part")
        temporary.write_text(tomli_w.dumps(self.to_plain()), encoding="utf-8")
        temporary.replace(path)

    # ---- derived constants --------------------------------------------------------------------

    @property
    def sensing_graph(self) -> Graph:
        """The field ``graph`` as a Graph, which it is after construction."""
        return cast(Graph, self.graph)

    @property
    def model(self) -> RobotModel:
        """The robot model."""
        return ROBOT_MODELS[self.robot_model]

    @cached_property
    def max_degree(self) -> float:
        """D̄, m/s: the largest D_i = Σ_j a_ij that an episode or its merges can produce (theory
        4).
        """
        return self.sensing_graph.max_degree(self.n_robots)

    @cached_property
    def bottleneck_weight(self) -> float:
        """a*, m/s: the least edge of a maximum spanning tree, in the worst case (theory 3)."""
        return self.sensing_graph.bottleneck_weight(self.n_robots)

    @property
    def dead_zone(self) -> float:
        """δ = a*/(2n), m/s: below it a certified heading need not follow the net bearing."""
        return self.bottleneck_weight / (2 * self.n_robots)

    @property
    def certified_step(self) -> float:
        """τ = r/(2D̄), s: the longest step with which V cannot rise between merges (theory 4)."""
        return self.merge_radius / (2 * self.max_degree) if self.max_degree > 0 else math.inf

    @property
    def tau(self) -> float:
        """τ, s: the step in force."""
        return self.certified_step if self.time_step is None else self.time_step

    @property
    def max_steps(self) -> int:
        """Steps until the time limit."""
        return max(1, math.ceil(self.time_limit / self.tau - 1e-9))

    @property
    def speed_limit(self) -> float:
        """v_max in force, m/s."""
        return self.max_degree if self.max_speed is None else self.max_speed

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
        """Symmetric bound on each number of an action, (a,): m/s, m/s², or m/s and rad/s.

        The rate ω_α of a 3-D robot has ten times the bound of the others, because law (17) divides
        it by cos β; at the bound it saturates.
        """
        return np.array(self.model.bounds(self))

    @cached_property
    def observation_layout(self) -> ObservationLayout:
        """Which row of an observation is what."""
        slots = self.obstacle_slots
        return ObservationLayout(
            dim=self.dim,
            neighbour_slots=self.neighbour_slots
            or self.sensing_graph.most_neighbours(self.n_robots),
            obstacle_slots=obstacles.max_count(self.obstacles) if slots is None else slots,
            senses_gravity=self.model.senses_gravity,
            senses_velocity=self.model.senses_velocity,
        )

    # ---- checks -------------------------------------------------------------------------------

    def _refuse(self, field: str, wanted: str) -> None:
        raise ValueError(f"{field} is {getattr(self, field)!r}; it must be {wanted}")

    def _check_team(self) -> None:
        for field, least in (("n_robots", 2), ("dim", 2)):
            value = getattr(self, field)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                self._refuse(field, f"a whole number, {least} or more")
            object.__setattr__(self, field, int(value))
        if self.dim not in (2, 3):
            self._refuse("dim", "2 or 3")
        if self.robot_model not in ROBOT_MODELS:
            self._refuse("robot_model", _one_of(ROBOT_MODELS))
        if self.dim not in self.model.dims:
            fitting = [model.name for model in ROBOT_MODELS.values() if self.dim in model.dims]
            self._refuse("robot_model", f"{_one_of(fitting)} where dim is {self.dim}")

    def _check_numbers(self) -> None:
        required = ("merge_radius", "time_limit", "obstacle_range", "spawn_size")
        optional = ("time_step", "max_speed", "max_turn_rate", "max_acceleration")
        for field in required + optional:
            value = getattr(self, field)
            if value is None and field in optional:
                continue
            if not _is_real(value) or not (math.isfinite(value) and value > 0):
                self._refuse(field, "a positive, finite number")
            object.__setattr__(self, field, float(value))

    def _check_choices(self) -> None:
        choices = {
            "obstacle_contact": CONTACT_MODES,
            "local_frames": LOCAL_FRAMES,
            "on_merge": ON_MERGE,
            "require_connected": (True, False),
            "allow_long_step": (True, False),
        }
        for field, allowed in choices.items():
            if getattr(self, field) not in allowed:
                self._refuse(field, _one_of(allowed))
        if not isinstance(self.name, str) or not self.name:
            self._refuse("name", "a word")
        if not isinstance(self.reward, RewardWeights):
            self._refuse("reward", "a RewardWeights")

    def _check_graph(self) -> None:
        graph = graphs.parse(self.graph)
        object.__setattr__(self, "graph", graph)
        pieces = graph.components(self.n_robots)
        if len(pieces) > 1 and self.require_connected:
            listed = " and ".join(str(piece) for piece in pieces)
            raise ValueError(
                f"graph is not connected: it falls into {listed}, which can never meet "
                "(theorem 1); join them by an edge, or pass require_connected=False"
            )
        slots = self.neighbour_slots
        most = self.n_robots - 1
        if slots is not None and (not _is_whole(slots) or not 1 <= slots <= most):
            self._refuse(
                "neighbour_slots", f"None or a whole number from 1 to n_robots - 1 = {most}"
            )

    def _check_obstacles(self) -> None:
        parsed = obstacles.parse(self.obstacles, self.dim)
        object.__setattr__(self, "obstacles", parsed)
        slots, count = self.obstacle_slots, obstacles.max_count(parsed)
        if slots is not None and (not isinstance(slots, int) or slots < count):
            self._refuse("obstacle_slots", f"None or at least the number of obstacles, {count}")

    def _check_starts(self) -> None:
        shapes = {"start_positions": self.dim, "start_headings": self.model.n_angles}
        for field, width in shapes.items():
            if getattr(self, field) is None:
                continue
            table = check_table(field, getattr(self, field), (self.n_robots, width))
            object.__setattr__(self, field, tuple(tuple(row) for row in table.tolist()))
        if self.start_positions is not None:
            positions = np.array(self.start_positions)
            check_distinct(
                "start_positions", positions, self.sensing_graph.base_weights(self.n_robots)
            )
            if not isinstance(self.obstacles, ObstacleField) and self.obstacle_contact != "ignore":
                packing.check_outside("start_positions", positions, self.obstacles)

    def _check_time_step(self) -> None:
        if self.time_step is None and not math.isfinite(self.certified_step):
            self._refuse("time_step", "given where the graph has no edge: no step is certified")
        if not self.allow_long_step and self.tau > self.certified_step * (1 + 1e-12):
            warnings.warn(
                f"time_step is {self.tau:.6g} s, longer than the certified step "
                f"{self.certified_step:.6g} s: V may rise between merges unless velocities are "
                "scaled (theory 4); pass allow_long_step=True if this is meant",
                TimeStepWarning,
                stacklevel=_frames_to_caller(),
            )


def check_table(field: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A finite float64 array of a shape.

    Raises:
        ValueError: naming the field, and its shape or the robot whose entry is not finite.
    """
    try:
        table = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field} must be numbers of shape {shape}: {error}") from error
    if table.shape != shape:
        raise ValueError(f"{field} has shape {table.shape}; it must be {shape}")
    if not np.isfinite(table).all():
        at = tuple(int(k) for k in np.argwhere(~np.isfinite(table))[0])
        raise ValueError(f"{field} of robot_{at[0]} is {table[at[0]].tolist()}; it must be finite")
    return table


def check_distinct(
    field: str, positions: NDArray[np.float64], weights: NDArray[np.float64]
) -> None:
    """Refuse neighbours that stand in the same place: no bearing exists between them.

    Args:
        field: what the message calls the positions.
        positions: (n, d), m.
        weights: (n, n); only pairs with a positive weight are looked at.

    Raises:
        ValueError: naming the pair.
    """
    offsets = positions[None] - positions[:, None]
    coincident = (np.abs(offsets).max(axis=-1) == 0) & np.triu(weights > 0)
    for i, j in np.argwhere(coincident):
        raise ValueError(
            f"{field}: neighbours robot_{i} and robot_{j} both stand at {positions[i].tolist()}; "
            "they must not coincide"
        )


def nearest_word(word: str, words: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The word most like ``word``, if any is much like it."""
    close = difflib.get_close_matches(word, list(words), n=1, cutoff=cutoff)
    return close[0] if close else None


def _check_keys(given: Iterable[str], known: list[str], what: str) -> None:
    for key in given:
        if key not in known:
            near = nearest_word(key, known, cutoff=0.4)
            hint = f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"
            raise ValueError(f"{what} has no field {key!r}; {hint}")


def _one_of(choices: Iterable[Any]) -> str:
    return "one of " + ", ".join(repr(choice) for choice in choices)


def _is_real(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _frames_to_caller() -> int:
    """How far up the stack the code stands that made the scenario, for the warning's line
    number.
    """
    import sys

    level, frame = 1, sys._getframe(1)
    inside: Callable[[str], bool] = lambda name: name.startswith(("rendezvous_env.", "dataclasses"))  # noqa: E731
    while frame.f_back and (
        inside(frame.f_globals.get("__name__", "")) or frame.f_code.co_name == "__init__"
    ):
        frame, level = frame.f_back, level + 1
    return level
