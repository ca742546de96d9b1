"""Seeds and ``reset(options=…)``: any part of an initial condition can be given."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import graphs
from ..checks import (
    check_shape,
    counted,
    floats,
    format_limit,
    is_int,
    mapping,
    raise_invalid,
    short_repr,
)
from ..graphs.reading import as_dense
from ..graphs.weights import weighted_links
from ..limits import LARGEST, LARGEST_SEED
from ..obstacles import parsing as obstacles
from ..obstacles.moving import moves
from ..obstacles.obstacle_set import check_outside, pack
from ..suggestions import nearest_word

_ROUNDING = 1e-9


class StartOptions(NamedTuple):
    """Given parts of an initial condition, with a leading axis of 1 or B; None is sampled."""

    positions: NDArray[np.float64] | None = None
    angles: NDArray[np.float64] | None = None
    frames: NDArray[np.float64] | None = None
    weights: NDArray[np.float64] | None = None
    obstacles: NDArray[np.float64] | None = None


def parse_options(scenario: Any, num_envs: int, options: Mapping[str, Any] | None) -> StartOptions:
    """Validate the options of a reset of B environments, see ``Simulator.reset``.

    An unknown key is ignored, as in Gymnasium. One that is similar to an option is rejected, and so
    is a field of the scenario, since a reset does not change it.

    Raises:
        ValueError: for an invalid option; the message gives its value and a remedy.
    """
    options = as_options(options)
    fields = ["max_cycles", *(field.name for field in dataclasses.fields(scenario) if options)]
    for key in options:
        if key in OPTIONS:
            continue
        if near := nearest_word(key, OPTIONS, cutoff=0.8):
            raise ValueError(f"options: {short_repr(key)} is not an option; did you mean {near!r}?")
        if field := nearest_word(key, fields, cutoff=0.8, parts=False):
            raise ValueError(
                f"options: {short_repr(key)} is a field of the scenario, which a reset does not "
                "change; "
                f"make another environment with {field}=…; options are {', '.join(OPTIONS)}"
            )
    values = ((options.get(key), read) for key, read in _READERS.items())
    given = StartOptions(
        *(None if value is None else read(scenario, num_envs, value) for value, read in values)
    )
    positions, start = given.positions, scenario.start_positions
    if start is not None and (given.weights is not None or given.obstacles is not None):
        positions = np.array([start]) if positions is None else positions
    if positions is not None:
        graph = scenario.sensing_graph
        weights = [graph.sparse_weights] if given.weights is None else given.weights
        own = options.get("obstacles")
        standing = scenario.obstacles if own is None else obstacles.parse(own, scenario.dim)
        for k in range(max(len(positions), len(weights))):
            team, of_team = positions[k % len(positions)], weights[k % len(weights)]
            check_positions(
                "positions", scenario, team, of_team, standing if k < len(positions) else ()
            )
            if scenario.body_radius is not None:
                check_apart("positions", team, scenario.body_radius)
    return given


def as_options(options: Any) -> dict[Any, Any]:
    """Copy of the options as a dict; None is empty."""
    if options is None:
        return {}
    return dict(mapping("options", options, f"None or a dict; it may hold {', '.join(OPTIONS)}"))


def _table(field: str, value: Any, shape: tuple[int, ...], num_envs: int) -> NDArray[np.float64]:
    """Table with leading axis 1 (shared by all environments) or B."""
    array = floats(field, value)
    batched = array.ndim == len(shape) + 1
    checked = check_table(field, array, (num_envs, *shape) if batched else shape)
    return checked if batched else checked[None]


def _positions(scenario: Any, num_envs: int, value: Any) -> NDArray[np.float64]:
    return _table("positions", value, (scenario.n_robots, scenario.dim), num_envs)


def _angles(scenario: Any, num_envs: int, value: Any) -> NDArray[np.float64]:
    n, width = scenario.n_robots, scenario.model.n_angles
    if width == 0:
        none = f"{scenario.robot_model} robots have no heading"
        raise ValueError(f'headings: {none}; give "frames" instead')
    array = floats("headings", value)
    if width == 1 and array.shape in ((n,), (num_envs, n)):
        array = array[..., None]
    return _table("headings", array, (n, width), num_envs)


def _frames(scenario: Any, num_envs: int, value: Any) -> NDArray[np.float64]:
    if scenario.model.n_angles:
        raise ValueError('frames: those of this model are the body axes; give "headings" instead')
    d = scenario.dim
    frames = _table("frames", value, (scenario.n_robots, d, d), num_envs)
    gram = np.swapaxes(frames, -1, -2) @ frames
    wrong = (np.abs(gram - np.eye(d)).max(axis=(-2, -1)) > _ROUNDING) | (np.linalg.det(frames) < 0)
    for team, robot in np.argwhere(wrong):
        matrix = short_repr(frames[team, robot].tolist())
        raise ValueError(f"frames: that of robot_{robot} is {matrix}; it must be a rotation")
    return frames


def _weights(scenario: Any, num_envs: int, value: Any) -> NDArray[np.float64]:
    n, graph = scenario.n_robots, scenario.sensing_graph
    given = as_dense("weights", value)
    weights = given[None] if given.ndim == 2 else given
    if weights.shape not in ((1, n, n), (num_envs, n, n)):
        raise ValueError(f"weights have shape {given.shape}; they must be {(n, n)}")
    if graph.changes:
        moment = f"those of a {graph.kind} graph are of the moment"
        raise ValueError(f"weights: none can be given where the graph changes: {moment}")
    return np.array([_checked_weights(scenario, matrix) for matrix in weights])


def _checked_weights(scenario: Any, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """One environment's weights (n, n), m/s, symmetric to the last bit where they must be."""
    directed = scenario.sensing_graph.directed
    first, second, found = weighted_links(matrix, len(matrix), "weights", directed=directed)
    weights = np.zeros(matrix.shape)
    weights[first, second] = found
    if not directed:
        weights[second, first] = found
    _check_within(scenario, weights)
    return weights


def _check_within(scenario: Any, weights: NDArray[np.float64]) -> None:
    """Raise a ValueError if given weights exceed the scenario's D̄, a* or number of rows."""
    n, directed = scenario.n_robots, scenario.sensing_graph.directed
    given = graphs.directed(weights) if directed else graphs.from_matrix(weights)
    if scenario.require_connected and (why := given.connectivity_error(n)) is not None:
        raise ValueError(f"weights are not connected: {why}")
    if scenario.body_radius is not None and given.most_links(n) < n * (n - 1) // 2:
        raise ValueError(
            "weights must link all robots with a body_radius: unlinked robots would overlap"
        )
    degree = given.max_degree(n)
    if degree > scenario.max_degree * (1 + _ROUNDING):
        raise ValueError(
            f"weights reach D = {degree:.6g} m/s; the scenario's step and limits assume at most "
            f"{scenario.max_degree:.6g}"
        )
    bottleneck = given.bottleneck_weight(n)
    if bottleneck < scenario.bottleneck_weight * (1 - _ROUNDING):
        raise ValueError(
            f"weights have the bottleneck a* = {bottleneck:.6g} m/s; the scenario's guarantee "
            f"assumes at least {scenario.bottleneck_weight:.6g}"
        )
    counts, slots = (weights > 0).sum(axis=1), scenario.observation_layout.neighbour_slots
    if counts.max() > slots:
        found = f"robot_{int(np.argmax(counts))} {counted(counts.max(), 'neighbour')}"
        rows = f"there are rows for neighbour_slots = {slots}"
        raise ValueError(f"weights give {found}; {rows}; give the scenario more neighbour_slots")


def _obstacles(scenario: Any, num_envs: int, value: Any) -> NDArray[np.float64]:
    parsed = obstacles.parse(value, scenario.dim)
    if scenario.meeting == "pack" and parsed != ():
        raise ValueError('obstacles: meeting="pack" does not support obstacles')
    if moves(parsed) or moves(scenario.obstacles):
        raise ValueError(
            "obstacles: those given to a reset do not move, and replace no moving ones; define "
            "moving ones in the scenario"
        )
    if not isinstance(parsed, tuple):
        raise ValueError("obstacles: give a list of obstacles; a field belongs in the scenario")
    slots = scenario.obstacle_places
    return pack(parsed, slots, obstacles.row_width(scenario.obstacles))[None]


_READERS: dict[str, Callable[[Any, int, Any], NDArray[np.float64]]] = {
    "positions": _positions,
    "headings": _angles,
    "frames": _frames,
    "weights": _weights,
    "obstacles": _obstacles,
}
"""Parsers of the options, in the order of ``StartOptions``."""
OPTIONS = tuple(_READERS)


def check_table(field: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Validated float64 array of a shape; a ValueError names the invalid robot."""
    table = np.array(floats(field, value))
    check_shape(field, table, shape)
    if not (wanted := np.abs(table) <= LARGEST).all():
        at = tuple(int(k) for k in np.argwhere(~wanted)[0])
        bounds = f"finite, and from {-LARGEST:g} to {LARGEST:g}"
        raise_invalid(f"{field} of robot_{at[0]}", table[at[0]].tolist(), bounds)
    return table


def check_positions(
    field: str, scenario: Any, positions: NDArray[np.float64], weights: Any, standing: Any
) -> None:
    """Raise a ValueError for positions (n, d), m, inside obstacles, or for coincident neighbours.

    Neighbours have a positive entry in a weight matrix (n, n), or in a function of n returning one.
    """
    _, place, counts = np.unique(positions + 0.0, axis=0, return_inverse=True, return_counts=True)
    if counts.max() > 1:
        matrix = weights(len(positions)) if callable(weights) else weights
        ends = np.sort(np.array(matrix.nonzero()), axis=0)
        coincident = ends[:, place[ends[0]] == place[ends[1]]]
        if coincident.size:
            i, j = min(coincident.T.tolist())
            place_of_both = f"{positions[i].tolist()}; they must not coincide"
            raise ValueError(
                f"{field}: neighbours robot_{i} and robot_{j} are both at {place_of_both}"
            )
    if isinstance(standing, tuple) and scenario.obstacle_contact != "ignore":
        check_outside(field, positions, standing)


def check_apart(field: str, positions: NDArray[np.float64], body_radius: Any) -> None:
    """Raise a ValueError for bodies that overlap beyond rounding.

    Their radius is a number, m, or one for each robot.
    """
    radii = np.broadcast_to(np.array(body_radius, np.float64), (len(positions),))
    least = radii[:, np.newaxis] + radii
    offsets = positions[:, np.newaxis] - positions
    distances = np.linalg.norm(offsets, axis=-1) + np.diag(np.full(len(positions), np.inf))
    if (distances < least * (1 - _ROUNDING)).any():
        i, j = divmod(int((distances - least).argmin()), len(positions))
        apart = f"{distances[i, j]:.4g} m apart; it must be"
        wanted = f"at least {format_limit(float(least[i, j]))} m, two body_radius"
        raise ValueError(f"{field}: robot_{i} and robot_{j} are {apart} {wanted}")


def seeds_of_environments(seed: Any, num_envs: int) -> list[int | None] | None:
    """Seed for each of B environments, None to keep the current one; None if all are kept.

    One number s gives environment i the seed s + i; a sequence or array gives one per
    environment. Each is ``folded``.
    """
    if seed is None:
        return None
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    if not isinstance(seed, Sequence) or isinstance(seed, str | bytes):
        first = check_seed(seed)  # the others are s + i
        return [folded(first + team) for team in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(
            f"seed has {counted(len(seed), 'entry')}; it must be one number, or {num_envs}"
        )
    return [None if entry is None else folded(check_seed(entry)) for entry in seed]


def check_seed(seed: Any) -> int:
    """Validated seed: as in Gymnasium, any nonnegative integer."""
    if not is_int(seed) or seed < 0:
        raise_invalid("seed", seed, "an integer, 0 or more")
    return int(seed)


def folded(seed: int) -> int:
    """Seed in use, below 2⁶³; larger ones are folded by NumPy's ``SeedSequence``."""
    if seed <= LARGEST_SEED:
        return seed
    return int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] >> np.uint64(1))
