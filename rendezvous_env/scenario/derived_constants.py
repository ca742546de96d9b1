"""What follows from the fields of a scenario: steps, limits and weights of theory 3 and 4."""

from __future__ import annotations

import math
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..graphs import Graph, GraphLike
from ..obstacles import parsing as obstacles
from ..obstacles.fields import Field
from ..obstacles.parsing import Obstacles
from ..robots.robot_models import ROBOT_MODELS, RobotModel
from ..sensors.sensing import Sensing
from .observation_layout import ObservationLayout


class DerivedConstants:
    """Constants that follow from the fields of a scenario."""

    n_robots: int
    dim: int
    robot_model: str
    graph: GraphLike
    require_connected: bool
    sensing: Sensing
    merge_radius: float
    time_step: float | None
    time_limit: float
    max_speed: float | None
    max_turn_rate: float | None
    max_acceleration: float | None
    obstacles: Obstacles | Field
    obstacle_slots: int | None
    neighbour_slots: int | None

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
        """a*, m/s: the least edge of a maximum spanning tree, in the worst case (theory 3); of
        directed and changing graphs a number below which no D_i of a robot that sees someone falls.
        """
        return self.sensing_graph.bottleneck_weight(self.n_robots)

    @property
    def start_reach(self) -> float:
        """R − (n − 1) r/2, m: links up to this length connect every start that is drawn for a
        proximity graph with a range R (guarantees, section 12); infinite where none need to.
        """
        return self.sensing_graph.start_reach(self)

    @property
    def dead_zone(self) -> float:
        """δ = a*/(2n), m/s: below it a certified heading need not follow the net bearing."""
        return self.bottleneck_weight / (2 * self.n_robots)

    @property
    def certified_step(self) -> float:
        """τ = r/(2D̄), s: the longest step with which V cannot rise between merges (theory 4); on
        graphs that are directed or change, half the longest with which the hull cannot grow.
        """
        return self.merge_radius / (2 * self.max_degree) if self.max_degree > 0 else math.inf

    @cached_property
    def step_degree(self) -> float:
        """The D_i, m/s, that default step and speed are made for: D̄, or less in large sparse graphs
        of single integrators (``Graph.step_degree``).
        """
        if not self.model.bounded:
            return self.max_degree
        return self.sensing_graph.step_degree(self.n_robots)

    @property
    def scales_velocity(self) -> bool:
        """Whether the step in force is the default one of a large sparse graph, longer than
        certified: laws then scale their velocities by r/(2 D_i τ) where that is below 1 (theory 4).
        """
        return self.time_step is None and self.step_degree < self.max_degree

    @property
    def tau(self) -> float:
        """τ, s: the step in force, r/(2D) with D the ``step_degree`` if none is given."""
        if self.time_step is not None:
            return self.time_step
        return self.merge_radius / (2 * self.step_degree) if self.step_degree > 0 else math.inf

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
        """Symmetric bound on each number of an action, (a,): m/s, m/s², or m/s and rad/s.

        The rate ω_α of a 3-D robot has ten times the bound of the others, because law (17) divides
        it by cos β; at the bound it saturates.
        """
        return np.array(self.model.bounds(self), dtype=np.float64)

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
