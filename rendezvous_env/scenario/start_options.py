"""How a start can be given: seeds, and what ``reset(options=…)`` accepts, any part of a start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import graphs
from ..checks import check_distinct, check_table, floats, is_whole, mapping, nearest_word, shown
from ..graphs.weights import check_weights
from ..limits import LARGEST_SEED
from ..obstacles import obstacle_set
from ..obstacles import parsing as obstacles
from .scenario import Scenario

_ROUNDING = 1e-9


class StartOptions(NamedTuple):
    """The given parts of a start, checked; each has a leading axis of 1 or B. None is to be
    drawn.
    """

    positions: NDArray[np.float64] | None = None
    angles: NDArray[np.float64] | None = None
    frames: NDArray[np.float64] | None = None
    weights: NDArray[np.float64] | None = None
    obstacles: NDArray[np.float64] | None = None


def parse_options(
    scenario: Scenario, num_envs: int, options: Mapping[str, Any] | None
) -> StartOptions:
    """Check the options of a reset of B teams, see ``Simulator.reset``.

    An unknown key is ignored, as Gymnasium has it, unless it is nearly one of ours.

    Raises:
        ValueError: naming the option, its value and what would be right.
    """
    options = as_options(options)
    for key in options:
        near = nearest_word(key, OPTIONS, cutoff=0.8)
        if key not in OPTIONS and near:
            raise ValueError(f"options: {shown(key)} is not an option; did you mean {near!r}?")
    values = ((options.get(key), read) for key, read in _READERS.items())
    given = StartOptions(
        *(None if value is None else read(scenario, num_envs, value) for value, read in values)
    )
    _check_together(scenario, given, options)
    return given


def as_options(options: Any) -> dict[Any, Any]:
    """Options as a dict of their own; None is none, and what is no mapping is refused."""
    if options is None:
        return {}
    return dict(mapping("options", options, f"None or a dict; it may hold {', '.join(OPTIONS)}"))


def _table(field: str, value: Any, shape: tuple[int, ...], num_envs: int) -> NDArray[np.float64]:
    """(1, …) from one table for all teams, or (B, …) from one for each."""
    array = floats(field, value)
    batched = array.ndim == len(shape) + 1
    checked = check_table(field, array, (num_envs, *shape) if batched else shape)
    return checked if batched else checked[None]


def _positions(scenario: Scenario, num_envs: int, value: Any) -> NDArray[np.float64]:
    return _table("positions", value, (scenario.n_robots, scenario.dim), num_envs)


def _angles(scenario: Scenario, num_envs: int, value: Any) -> NDArray[np.float64]:
    n, width = scenario.n_robots, scenario.model.n_angles
    if width == 0:
        raise ValueError(
            f'headings: {scenario.robot_model} robots have none; give "frames" instead'
        )
    array = floats("headings", value)
    if width == 1 and array.shape in ((n,), (num_envs, n)):
        array = array[..., None]
    return _table("headings", array, (n, width), num_envs)


def _frames(scenario: Scenario, num_envs: int, value: Any) -> NDArray[np.float64]:
    if scenario.model.nonholonomic:
        raise ValueError(
            'frames: the body axes are the frame of this model; give "headings" instead'
        )
    d = scenario.dim
    frames = _table("frames", value, (scenario.n_robots, d, d), num_envs)
    gram = np.swapaxes(frames, -1, -2) @ frames
    wrong = (np.abs(gram - np.eye(d)).max(axis=(-2, -1)) > _ROUNDING) | (np.linalg.det(frames) < 0)
    for team, robot in np.argwhere(wrong):
        matrix = shown(frames[team, robot].tolist())
        raise ValueError(f"frames: that of robot_{robot} is {matrix}; it must be a rotation")
    return frames


def _weights(scenario: Scenario, num_envs: int, value: Any) -> NDArray[np.float64]:
    n = scenario.n_robots
    given = floats("weights", value)
    weights = given[None] if given.ndim == 2 else given
    if weights.shape not in ((1, n, n), (num_envs, n, n)):
        raise ValueError(f"weights have shape {given.shape}; they must be {(n, n)}")
    graph = scenario.sensing_graph
    if graph.changes:
        raise ValueError(
            f"weights: none can be given where the graph changes: those of a {graph.kind} graph "
            "are of the moment"
        )
    for matrix in weights:
        check_weights(matrix, n, "weights", directed=graph.directed)
        _check_within(scenario, matrix)
        counts = (matrix > 0).sum(axis=1)
        if counts.max() > (slots := scenario.observation_layout.neighbour_slots):
            robot = int(np.argmax(counts))
            raise ValueError(
                f"weights give robot_{robot} {counts[robot]} neighbours; there are rows for "
                f"neighbour_slots = {slots}; give the scenario more neighbour_slots"
            )
    return weights


def _check_within(scenario: Scenario, weights: NDArray[np.float64]) -> None:
    """The constants D̄ and a* of the mission must hold for the given weights too."""
    n, directed = scenario.n_robots, scenario.sensing_graph.directed
    given = graphs.directed(weights) if directed else graphs.from_matrix(weights)
    if scenario.require_connected and (why := given.why_not_joined(n)) is not None:
        raise ValueError(f"weights are not connected: {why}")
    degree = given.max_degree(n)
    if degree > scenario.max_degree * (1 + _ROUNDING):
        raise ValueError(
            f"weights reach D = {degree:.6g} m/s; the scenario's step and limits stand on at most "
            f"{scenario.max_degree:.6g}"
        )
    bottleneck = given.bottleneck_weight(n)
    if bottleneck < scenario.bottleneck_weight * (1 - _ROUNDING):
        raise ValueError(
            f"weights have the bottleneck a* = {bottleneck:.6g} m/s; the scenario's guarantee "
            f"stands on at least {scenario.bottleneck_weight:.6g}"
        )


def _obstacles(scenario: Scenario, num_envs: int, value: Any) -> NDArray[np.float64]:
    parsed = obstacles.parse(value, scenario.dim)
    if not isinstance(parsed, tuple):
        raise ValueError(
            "obstacles: give them one by one; a random field belongs into the scenario"
        )
    slots = scenario.observation_layout.obstacle_slots
    if len(parsed) > slots:
        raise ValueError(
            f"obstacles: {len(parsed)} given, but the scenario has room for {slots}; "
            "set its obstacle_slots"
        )
    width = obstacles.row_width(scenario.obstacles)
    if obstacles.row_width(parsed) > width:
        raise ValueError(
            "obstacles: one has more corners than any of the scenario's own obstacles, or is a "
            "capsule where the scenario has none"
        )
    if obstacles.only_balls(scenario.obstacles) and not obstacles.only_balls(parsed):
        raise ValueError(
            "obstacles: the scenario's own are all round, so only round ones can be given"
        )
    return obstacle_set.pack(parsed, slots, width)[None]


_READERS: dict[str, Callable[[Scenario, int, Any], NDArray[np.float64]]] = {
    "positions": _positions,
    "headings": _angles,
    "frames": _frames,
    "weights": _weights,
    "obstacles": _obstacles,
}
"""In the order of ``StartOptions``."""
OPTIONS = tuple(_READERS)


def _check_together(scenario: Scenario, given: StartOptions, options: Mapping[str, Any]) -> None:
    """Given positions must neither coincide nor lie in a given obstacle."""
    positions = given.positions
    if positions is None:
        return
    weights = [scenario.sensing_graph.sparse_weights] if given.weights is None else given.weights
    for k in range(max(len(positions), len(weights))):
        check_distinct("positions", positions[k % len(positions)], weights[k % len(weights)])
    standing = options.get("obstacles", scenario.obstacles)
    standing = obstacles.parse(standing, scenario.dim)
    if isinstance(standing, tuple) and scenario.obstacle_contact != "ignore":
        for team in positions:
            obstacle_set.check_outside("positions", team, standing)


# ---- seeds -------------------------------------------------------------------------------------


def seeds_of_teams(seed: Any, num_envs: int) -> list[int | None] | None:
    """A seed for each of B teams, None where it keeps its own; None if all do.

    One number s gives team i the seed s + i; a sequence or array gives each team its own.

    Raises:
        ValueError: naming what is no seed.
    """
    if seed is None:
        return None
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    if not isinstance(seed, Sequence) or isinstance(seed, str | bytes):
        first = _checked_seed(seed)
        if first + num_envs - 1 > LARGEST_SEED:
            raise ValueError(
                f"seed {first} must leave room for {num_envs} teams, whose seeds follow on it: "
                f"at most {LARGEST_SEED - num_envs + 1}"
            )
        return [first + team for team in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"seed has {len(seed)} entries; it must be one number, or {num_envs}")
    return [None if entry is None else _checked_seed(entry) for entry in seed]


def _checked_seed(value: Any) -> int:
    if not is_whole(value) or not 0 <= value <= LARGEST_SEED:
        raise ValueError(f"seed {shown(value)} must be a whole number, 0 or more, at most 2^63 - 1")
    return int(value)
