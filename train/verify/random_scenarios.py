"""Whole scenarios drawn at random, out of everything that ``Scenario`` and the wrappers can be.

What the draw prefers are the places where promises break: robots within r of each other, nearly
opposite or nearly coincident; links just short enough; obstacles where robots will merge; weights
far apart; steps long and robots slow.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv

Array = NDArray[np.float64]
Random = np.random.Generator

CHOICES = ("law", "heading", "tank", "gains", "links")
"""What can keep a guarantee, as ``certificate`` calls it."""
_TRIES = 40
_CORNERS = 0.25
"""Share of scenarios that are drawn where promises would break first."""
_TOLERABLE = 0.7
"""Share of scenarios with a sensor that is wrong in one way, so little that theorems bear it."""
_SIZES = (2, 3, 3, 3, 4, 4, 4, 5, 6)


class Kind(NamedTuple):
    """What compiled code depends on: trials of one kind share it."""

    robot_model: str
    dim: int
    graphs: str
    """Which of GRAPHS."""
    exact: bool
    """Whether the sensor is; that of a proximity graph never is."""
    obstacles: str
    """none, round or any."""


def draw_kind(random: Random) -> Kind:
    """Mostly single integrators in the plane without obstacles, about which most is promised."""
    model, dim = _pick(random, *_MODELS)
    graphs = _pick(random, "fixed", "fixed", "changing", "proximity")
    exact = graphs != "proximity" and random.random() < 0.45
    obstacles = _pick(random, "none", "none", "none", "round", "any")
    return Kind(model, dim, graphs, exact, obstacles)


_MODELS = (
    *[("single_integrator", 2)] * 11,
    *[("single_integrator", 3)] * 4,
    *[("unicycle", 2)] * 2,
    *[("nonholonomic_3d", 3)] * 2,
    ("double_integrator", 2),
)


@dataclass(frozen=True)
class Drawn:
    """A scenario, and the arguments of its certificate and wrapper for each of CHOICES."""

    scenario: rv.Scenario
    arguments: dict[str, dict[str, float]]


def draw(random: Random, kind: Kind) -> Drawn:
    """A scenario that is possible; nothing else is asked of it."""
    for _ in range(_TRIES):
        try:
            scenario = _scenario(random, kind)
            given = {by: arguments(random, scenario, by) for by in CHOICES}
            if not kind.exact and kind.graphs != "proximity" and random.random() < _TOLERABLE:
                scenario = _tolerable(random, scenario, given)
            return Drawn(scenario, given)
        except ValueError:
            continue  # fields that do not go together
    return Drawn(rv.Scenario(), {by: arguments(random, rv.Scenario(), by) for by in CHOICES})


def arguments(random: Random, scenario: rv.Scenario, by: str) -> dict[str, float]:
    """What a certificate is asked with besides ``by``, and a wrapper made with."""
    if by == "heading":
        return {"min_alignment": float(1.0 - _log(random, 0.02, 0.95))}
    if by == "tank":
        budget = _log(random, 0.01, 10.0) * random.integers(2)
        return {"min_alignment": float(1.0 - _log(random, 0.02, 0.95)), "budget": float(budget)}
    if by == "links":
        return {"share": _log(random, 1e-3, 1.0)}
    if by == "gains" and random.random() < 0.6:
        most = min(scenario.max_degree, scenario.merge_radius / scenario.tau)
        low, high = sorted(most * random.uniform(0.05, 1.0, 2))
        return {"min_gain": float(low), "max_gain": float(high if random.random() < 0.7 else low)}
    return {}


def _tolerable(
    random: Random, scenario: rv.Scenario, given: dict[str, dict[str, float]]
) -> rv.Scenario:
    """The same with bearings that err, are noisy or are late by what some theorem bears, and with
    gains that are the same for all where it needs them.
    """
    n, step = scenario.n_robots, scenario.certified_step * _log(random, 0.1, 1.0)
    exact = scenario.replace(sensing=rv.Sensing(), max_speed=None, obstacles=())
    lasting = exact.sensing_graph.kind not in GRAPHS["changing"]
    flaw = _pick(random, "error", "error", "noise", "delay") if lasting else "error"
    if flaw == "noise":
        sensing = rv.Sensing(noise=_log(random, 0.01, 0.6))
    elif flaw == "delay":
        sensing = rv.Sensing(delay=int(random.integers(1, 5)))
        step = exact.certified_step * random.uniform(0.3, 1.05) / (sensing.delay + 1)
    else:
        by = _pick(random, *CHOICES)
        if by == "gains":
            gain = min(exact.max_degree, exact.merge_radius / step) * random.uniform(0.05, 0.5)
            given[by] = {"min_gain": float(gain), "max_gain": float(gain)}
        if by == "law" and random.random() < 0.7:
            graph = _pick(random, rv.graphs.complete, rv.graphs.cycle) if n > 2 else rv.graphs.path
            exact = exact.replace(graph=graph(float(exact.max_degree / n)))
            step = exact.certified_step * _log(random, 0.1, 0.7)
        exact = exact.replace(time_step=step, time_limit=1000.0 * step)
        found = rv.certificate(exact, by=by, **given[by])
        error = found.tolerated_bearing_error * random.uniform(0.1, 0.99)
        if random.random() < 0.6:  # turned as an adversary likes, not only outward
            for own in given.values():
                own["bearing_error"] = error
            return exact
        sensing = rv.Sensing(error=error)
    return exact.replace(sensing=sensing, time_step=step, time_limit=1000.0 * step)


def _log(random: Random, low: float, high: float) -> float:
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def _pick(random: Random, *options: Any) -> Any:
    return options[int(random.integers(len(options)))]


def _scenario(random: Random, kind: Kind) -> rv.Scenario:
    n, dim = _pick(random, *_SIZES), kind.dim
    r = _pick(random, 0.2, 0.2, _log(random, 0.05, 1.0))
    graph = _pick(random, *GRAPHS[kind.graphs])
    sight = r * _log(random, 0.6 * n + 2.0, 20.0 + n) if graph == "proximity" else None
    sensing = rv.Sensing() if kind.exact else _sensing(random, n, r, sight)
    reach = math.inf if sight is None else sight - (n - 1) * r / 2.0
    if random.random() < _CORNERS:
        return _corner(random, kind, n, r, graph, sensing, reach)
    places = _starts(random, n, dim, r, reach)
    fields: dict[str, Any] = {
        "n_robots": n,
        "dim": dim,
        "robot_model": kind.robot_model,
        "graph": _graph(random, graph, n, r),
        "merge_radius": r,
        "allow_long_step": True,
        "obstacle_contact": _pick(random, "slide", "stop", "ignore"),
        "spawn_size": r * _log(random, 4.0, 25.0),
        "start_positions": places,
        "local_frames": _pick(random, "random", "global"),
        "on_merge": _pick(random, "remove", "follow"),
        "sensing": sensing,
    }
    if kind.obstacles != "none":
        fields["obstacles"] = _obstacles(random, kind, r, places, fields["spawn_size"])
    scenario = rv.Scenario(**fields)
    return scenario.replace(**_clock(random, scenario))


def _corner(
    random: Random, kind: Kind, n: int, r: float, graph: str, sensing: rv.Sensing, reach: float
) -> rv.Scenario:
    """Where a promise would break first: links at their longest and merges that move robots away;
    heavy and light links of robots that hide each other; bearings that nearly cancel, in long steps
    of slow robots.
    """
    place = {"fixed": _on_line, "changing": _in_wedge, "proximity": _in_tail}[kind.graphs]
    places = place(random, n, kind.dim, r, reach)
    fields: dict[str, Any] = {
        "n_robots": n,
        "dim": kind.dim,
        "robot_model": kind.robot_model,
        "graph": _graph(random, graph, n, r),
        "merge_radius": r,
        "allow_long_step": True,
        "start_positions": places,
        "local_frames": "global",
        "sensing": sensing,
        "obstacle_contact": _pick(random, "ignore", "ignore", "slide"),
    }
    if kind.graphs == "fixed" and not kind.exact:
        fields["sensing"] = rv.Sensing(occlusion="robots")
        fields["graph"] = _fixed(random, n, False, 1.0)
        if random.random() < 0.5:  # in a row, and who is next has the light link
            fields["start_positions"] = _in_row(random, n, kind.dim, r)
            far = np.abs(np.arange(n)[:, None] - np.arange(n)) > 1
            light = _log(random, 0.003, 0.3) * (1.0 - np.eye(n))
            fields["graph"] = rv.graphs.from_matrix(np.where(far, 1.0, light))
    if kind.graphs == "changing":
        heavy = np.full((n, n), _log(random, 0.003, 1.0))
        heavy[0] = 1.0
        fields["graph"] = rv.graphs.directed(heavy * (1.0 - np.eye(n)))
    if kind.obstacles != "none":
        balls = _at_midpoints(random, rv.Disc if kind.dim == 2 else rv.Sphere, places)
        if kind.obstacles == "any":
            balls.append(_angular(random, kind.dim, r, places + 100.0 * r))
        fields["obstacles"] = tuple(balls)
    scenario = rv.Scenario(**fields)
    if kind.graphs != "changing":
        return scenario.replace(**_clock(random, scenario))
    tau = scenario.certified_step * _log(random, 1.0, 20.0)
    slow = r / tau * random.uniform(0.3, 1.0)
    return scenario.replace(time_step=tau, max_speed=slow, time_limit=1000.0 * tau)


def _clock(random: Random, scenario: rv.Scenario) -> dict[str, Any]:
    """Step and limits of speed: from a tenth to twenty times what is certified."""
    fields: dict[str, Any] = {}
    if random.random() < 0.6:
        fields["time_step"] = scenario.certified_step * _log(random, 0.1, 20.0)
    tau = fields.get("time_step", scenario.tau)
    if random.random() < 0.35:
        fields["max_speed"] = scenario.max_degree * _log(random, 0.02, 2.0)
        if tau > scenario.certified_step and random.random() < 0.6:
            fields["max_speed"] = scenario.merge_radius / tau * random.uniform(0.3, 1.0)
    if random.random() < 0.3:
        fields["max_turn_rate"] = _log(random, 0.1, 100.0)
    steps = max(1.0, getattr(scenario.sensing_graph, "dwell", 0.0) / tau)
    if hasattr(scenario.sensing_graph, "dwell") and steps <= 1.0:
        fields["time_step"] = scenario.sensing_graph.dwell
    return fields | {"time_limit": 1000.0 * fields.get("time_step", scenario.tau)}


GRAPHS = {
    "fixed": (
        *["complete", "matrix"] * 3,
        *("path", "cycle", "star", "random_tree", "erdos_renyi"),
    ),
    "changing": ("directed", "directed", "directed_cycle", "switching", "switching"),
    "proximity": ("proximity",),
}


def _weight(random: Random) -> Any:
    """One weight, or a range of them."""
    low = _pick(random, 1.0, _log(random, 0.01, 100.0))
    return low if random.random() < 0.6 else (low, low * _pick(random, 2.0, 100.0))


def _matrix(random: Random, n: int, density: float = 1.0) -> Array:
    """Weights: all the same, heavy or light, or anything over four decades; (n, n), m/s."""
    kind, scale = int(random.integers(4)), _log(random, 0.1, 10.0)
    weights = np.ones((n, n))
    if kind == 1:
        weights = np.where(random.random((n, n)) < 0.5, 1.0, _log(random, 0.003, 0.3))
    elif kind == 2:
        weights = 10.0 ** random.uniform(-2.0, 2.0, (n, n))
    elif kind == 3:
        weights = random.uniform(0.5, 2.0, (n, n))
    return np.asarray(scale * weights * (random.random((n, n)) < density) * (1.0 - np.eye(n)))


def _fixed(random: Random, n: int, directed: bool, density: float | None = None) -> Any:
    weights = _matrix(random, n, density or _pick(random, 1.0, 1.0, 0.6))
    if directed:
        return rv.graphs.directed(weights)
    return rv.graphs.from_matrix(np.triu(weights) + np.triu(weights).T)


def _graph(random: Random, kind: str, n: int, r: float) -> Any:
    graphs = rv.graphs
    if kind == "matrix":
        return _fixed(random, n, False)
    if kind == "directed":
        return _fixed(random, n, True)
    if kind == "switching":
        listed = [
            _pick(random, _fixed(random, n, True), _fixed(random, n, False), graphs.complete())
            for _ in range(int(random.integers(1, 4)))
        ]
        if n > 3 and random.random() < 0.3:  # sides that see each other, and then all
            side = np.arange(n) % 2
            across = (side[:, None] != side).astype(float)
            listed = [graphs.from_matrix(across), graphs.complete()]
        heaviest = max(graph.max_degree(n) for graph in listed)
        if heaviest == 0.0:
            raise ValueError("no graph of the list has an edge")
        dwell = r / (2.0 * heaviest) * _log(random, 1.0, 20.0)
        return graphs.switching(listed, dwell, _pick(random, "cyclic", "random"))
    if kind == "erdos_renyi":
        return graphs.erdos_renyi(random.uniform(0.2, 0.9), _weight(random))
    if kind == "cycle" and n == 2:
        kind = "path"
    return getattr(graphs, kind)(_weight(random))


def _sensing(random: Random, n: int, r: float, sight: float | None) -> rv.Sensing:
    """One imperfection, seldom several; a range that links need may be all."""
    fields: dict[str, Any] = {} if sight is None else {"range": sight}
    flaws = {
        "error": np.pi / n * _log(random, 0.001, 1.5),
        "occlusion": _pick(random, "robots", "robots", "obstacles", "both"),
        "noise": _log(random, 0.001, 1.0),
        "bias": _log(random, 0.001, 1.0),
        "dropout": random.uniform(0.0, 0.9),
        "delay": int(random.integers(1, 5)),
        "sectors": int(random.integers(2, 200)),
        "range": r * _log(random, 3.0, 100.0),
        "field_of_view": random.uniform(0.5, 2.0 * np.pi),
    }
    names = [*flaws, *["error", "occlusion"] * 4]
    while (not fields or random.random() < 0.2) and (sight is None or random.random() < 0.4):
        name = str(_pick(random, *names))
        fields.setdefault(name, flaws[name])
    return rv.Sensing(**fields)


def _starts(random: Random, n: int, dim: int, r: float, reach: float) -> Array | None:
    """Places (n, d), m, of one of STARTS, in any order and orientation; None: they are drawn."""
    place = _pick(random, *STARTS)
    if place is None:
        return None
    places = place(random, n, dim, r, reach)
    turn, _ = np.linalg.qr(random.normal(size=(dim, dim)))
    if random.random() < 0.7:
        places = random.permutation(places)
    return np.asarray(places @ turn.T)


def _in_box(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    return random.uniform(0.0, r * _log(random, 1.5, 25.0), (n, dim))


def _on_line(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    gaps = [_gap(random, r, reach) for _ in range(n)]
    places = np.zeros((n, dim))
    places[:, 0] = np.cumsum(gaps)
    return places + _pick(random, 0.0, 1e-9, 1e-3, 0.1) * r * random.normal(size=(n, dim))


def _gap(random: Random, r: float, reach: float) -> float:
    """Between neighbours: within r, hardly more, as far as a link may be, or anything."""
    far = min(reach, 30.0 * r)
    return float(
        _pick(
            random,
            r * _log(random, 1e-3, 1.0),
            r * (1.0 + _log(random, 1e-5, 0.3)),
            r * _log(random, 1.0, 20.0),
            far * (1.0 - _log(random, 1e-7, 0.1)),
        )
    )


def _in_clusters(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Some robots within r of each other, and others so, a few r apart."""
    apart = r * _log(random, 1.2, 20.0)
    centres = apart * random.normal(size=(int(random.integers(2, 4)), dim))
    offsets = r * _log(random, 1e-3, 0.9) * random.normal(size=(n, dim))
    return np.asarray(centres[np.arange(n) % len(centres)] + offsets)


def _on_ring(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    angle = 2.0 * np.pi * np.arange(n) / n
    places = np.zeros((n, dim))
    places[:, 0], places[:, 1] = np.cos(angle), np.sin(angle)
    places *= r * _log(random, 0.4, 10.0)
    return places + _pick(random, 0.0, 1e-6, 0.1) * r * random.normal(size=(n, dim))


def _in_tree(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Each at a gap from one before it, straight on or to any side."""
    places, straight = np.zeros((n, dim)), random.normal(size=dim)
    for k in range(1, n):
        towards = _pick(random, straight, random.normal(size=dim))
        at = int(_pick(random, k - 1, random.integers(k)))
        places[k] = places[at] + _gap(random, r, reach) * towards / np.linalg.norm(towards)
    return places


def _in_row(random: Random, n: int, dim: int, r: float) -> Array:
    """Robots on a line, apart, in order."""
    places = np.zeros((n, dim))
    places[:, 0] = np.cumsum([r * _log(random, 2.0, 20.0) for _ in range(n)])
    return places


def _in_tail(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robots in a row within r of each other, ever nearer, and the last one as far as it may be."""
    gaps = np.sort(random.uniform(0.6, 1.0, n - 1))[::-1] * r
    gaps[-1] = min(reach, 30.0 * r) * (1.0 - _log(random, 1e-7, 0.05))
    places = np.zeros((n, dim))
    places[1:, 0] = np.cumsum(gaps)
    return places + _pick(random, 0.0, 1e-3, 0.05) * r * random.normal(size=(n, dim))


def _in_wedge(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robot 0 between others in nearly opposite directions, so that its bearings nearly cancel."""
    angle = _log(random, 0.02, 0.8)
    places = np.zeros((n, dim))
    for k in range(1, n):
        distance = r * _log(random, 1.01, 3.0) if n > 3 else r * 1.5
        places[k, 0] = (-1.0) ** k * distance * math.cos(angle)
        places[k, 1] = -distance * math.sin(angle) - 1.2 * r * ((k - 1) // 2)
    return places


STARTS = (None, _in_box, _on_line, _in_clusters, _in_clusters, _on_ring, _in_tree, _in_wedge)


def _obstacles(random: Random, kind: Kind, r: float, places: Array | None, side: float) -> Any:
    """Where robots will merge, anywhere among them, or drawn for every episode."""
    dim, round_only = kind.dim, kind.obstacles == "round"
    if places is None or random.random() < 0.2:
        if dim == 2 and not round_only:
            length = (0.3 * side, 0.6 * side)
            layout = _pick(random, "trap", "corridor", "rooms")
            return rv.WallField(
                layout, length, (0.05 * side, 0.1 * side), 0.03 * side, side, 0.1 * r
            )
        radius = (0.02 * side, 0.1 * side)
        return rv.ObstacleField((1, 3), radius, side, 0.1 * r, bool(random.integers(2)))
    ball = rv.Disc if dim == 2 else rv.Sphere
    if random.random() < 0.6:
        found = _at_midpoints(random, ball, places)
    else:
        at = places[random.integers(len(places), size=int(random.integers(1, 4)))]
        sizes = [r * _log(random, 0.1, 5.0) for _ in at]
        found = [
            ball(tuple((place + 2.0 * size * random.normal(size=dim)).tolist()), size)
            for place, size in zip(at, sizes, strict=True)
        ]
    if not round_only:
        found.append(_angular(random, dim, r, places))
    return tuple(found)


def _angular(random: Random, dim: int, r: float, places: Array) -> Any:
    """A triangle or a capsule somewhere among the robots."""
    size = r * _log(random, 0.1, 5.0)
    at = places[int(random.integers(len(places)))] + 2.0 * size * random.normal(size=dim)
    if dim == 2 and random.random() < 0.5:
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, 3))
        corners = at + size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return rv.Polygon(tuple(map(tuple, corners.tolist())))
    other = at + size * random.normal(size=dim)
    return rv.Capsule((tuple(at.tolist()), tuple(other.tolist())), 0.3 * size)


def _at_midpoints(random: Random, ball: Any, places: Array) -> list[Any]:
    """Balls at the midpoints of the nearest pairs."""
    pairs = sorted(
        itertools.combinations(range(len(places)), 2),
        key=lambda pair: float(np.linalg.norm(places[pair[0]] - places[pair[1]])),
    )
    found = []
    for i, j in pairs[: int(random.integers(1, len(places) + 1))]:
        radius = 0.5 * float(np.linalg.norm(places[i] - places[j])) * random.uniform(0.2, 0.95)
        found.append(ball(tuple(((places[i] + places[j]) / 2.0).tolist()), radius))
    return found
