"""Random scenarios over all fields of ``Scenario`` and all wrappers.

Sampling prefers critical cases: robots within r of each other, nearly opposite or coincident; links
at their maximum length; obstacles at merge points; very different weights; long steps of slow
robots.
"""

import dataclasses
import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.safety.theorems.delay import longest_held_step
from rendezvous_env.safety.theorems.theorem import CHOICES

from . import random_initial_conditions as places_of
from .random_initial_conditions import log_uniform, pick

Array = NDArray[np.float64]
Random = np.random.Generator
Given = dict[str, dict[str, Any]]  # arguments for each of CHOICES
Starts = tuple[rv.Scenario, ...]

STARTS = 6
"""Number of initial conditions per sampled scenario, simulated as one batch."""
DRAWS = 50  # scenarios of a task, of one kind, with common compiled code
_KINDS = 10**9  # first random stream of kinds, after those of scenarios
_TRIES = 40
_CORNERS = 0.25  # fraction of critical scenarios
_TOLERABLE = 0.8
"""Fraction of scenarios with one sensor imperfection small enough for some theorem."""
_BY_CHANCE = 0.35
"""Fraction of these with detection by chance, for which a mean time is bounded."""
_CLOCKED = 0.08  # fraction of scenarios with asynchronous activation
_EVENTFUL = 0.08  # fraction of scenarios with failures or disturbances
_VARIED = 0.12  # fraction of scenarios with different models or sensors, or another spawn area
_CLIMBING = 0.15  # fraction of trials whose initial conditions are optimised
_SIZES = (2, 3, 3, 3, 4, 4, 4, 5, 6)
_MODELS = (
    *[("single_integrator", 2)] * 11,
    *[("single_integrator", 3)] * 6,
    *[("unicycle", 2)] * 2,
    *[("nonholonomic_3d", 3)] * 2,
    ("double_integrator", 2),
)
GRAPHS = {
    "fixed": (
        *["complete", "matrix"] * 3,
        *("path", "cycle", "star", "random_tree", "erdos_renyi"),
    ),
    "changing": ("directed", "directed", "directed_cycle", "switching", "switching"),
    "proximity": ("proximity",),
}


@dataclass(frozen=True)
class Trial:
    """A scenario with its safety filter and simulation settings."""

    scenario: rv.Scenario
    by: str
    arguments: dict[str, Any]  # of the certificate, and of the wrapper
    frame: str = "local"
    period: int = 1  # base steps per choice
    seed: int = 0  # environment b has this seed + b; adversaries use it, too
    generations: int = 0  # number of optimisation rounds of initial conditions, see ``climb``
    starts: Starts = ()  # given initial conditions, distributed over the environments
    policy: str = ""  # name of the policy if ``by`` is "policy"
    numbers: tuple[str, ...] = ()  # quantities of monitors.SEARCHED to violate in that case


class Kind(NamedTuple):
    """Properties that determine the compiled kernels."""

    robot_model: str
    dim: int
    graphs: str  # which of GRAPHS
    exact: bool  # whether the sensor is exact; never for a proximity graph
    obstacles: str  # none, round or any


def draw_kind(random: Random) -> Kind:
    """Sample a kind; mostly planar single integrators without obstacles, which have most bounds."""
    model, dim = pick(random, *_MODELS)
    graphs = pick(random, "fixed", "fixed", "changing", "proximity")
    exact = graphs != "proximity" and random.random() < 0.4
    return Kind(model, dim, graphs, exact, pick(random, "none", "none", "round", "any"))


def trials_of(seed: int, number: int, kind_number: int | None = None) -> list[Trial]:
    """Trials of one sampled scenario under each of CHOICES."""
    kind_number = number // DRAWS if kind_number is None else kind_number
    kind = draw_kind(np.random.default_rng([seed, _KINDS + kind_number]))
    random = np.random.default_rng([seed, number])
    scenario, arguments, starts = _draw(random, kind)
    return [
        Trial(
            scenario=scenario,
            by=by,
            arguments=arguments[by],
            frame="net_bearing" if random.random() < 0.3 else "local",
            period=3 if by != "law" and random.random() < 0.15 else 1,
            seed=int(random.integers(2**31)),
            generations=3 if random.random() < _CLIMBING else 0,
            starts=starts,
        )
        for by in CHOICES
    ]


def _draw(random: Random, kind: Kind) -> tuple[rv.Scenario, Given, Starts]:
    """Sample a valid scenario, its options and, if any, its initial conditions."""
    for _ in range(_TRIES):
        try:
            scenario = _scenario(random, kind)
            given = {by: _arguments(random, scenario, by) for by in CHOICES}
            if not kind.exact and kind.graphs != "proximity" and random.random() < _TOLERABLE:
                scenario = _tolerable(random, scenario, given)
        except ValueError:
            continue  # inconsistent fields
        scenario = _with_clocks(random.spawn(1)[0], scenario)
        scenario = _with_events(random.spawn(1)[0], scenario)
        scenario = _varied(random.spawn(1)[0], scenario)
        _vary_gains(random.spawn(1)[0], scenario, given)
        if scenario.start_positions is None:
            return scenario, given, ()
        # half of the others are sampled again without obstacles between the robots
        own, anew = np.array(scenario.start_positions), 0.0 if scenario.obstacles else 0.5
        others = other_starts(random, scenario, own[None], anew)[1:]
        return scenario, given, (scenario, *others)
    return rv.Scenario(), {by: _arguments(random, rv.Scenario(), by) for by in CHOICES}, ()


def _with_clocks(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Usually the scenario itself, otherwise with asynchronous activation.

    For half of the latter a theorem exists: exact bearings, no obstacles, short holds of commands.
    """
    if random.random() >= _CLOCKED:
        return scenario
    n, kind = scenario.n_robots, str(pick(random, "periodic", "random", "bounded", "bounded"))
    own: dict[str, Any] = {"max_wait": int(random.integers(1, 6))}
    if kind == "periodic":
        periods = random.integers(1, 6, n)
        phases = random.integers(0, periods)
        own = {"period": periods.tolist(), "phase": phases.tolist()}
    elif kind == "random":
        own = {"probability": log_uniform(random, 0.05, 1.0)}
    hold = str(pick(random, "command", "stop"))
    clocked = scenario.replace(activation=rv.Activation(kind=kind, **own), hold=hold)
    lasting = scenario.sensing_graph.kind not in (*GRAPHS["changing"], "proximity")
    if not lasting or random.random() < 0.5:
        return clocked
    passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
    clocked = clocked.replace(sensing=rv.Sensing(), obstacles=passed)
    if hold == "command" and kind != "random":
        step = longest_held_step(clocked) * random.uniform(0.3, 1.05)
        clocked = clocked.replace(time_step=step, time_limit=1000.0 * step)
    return clocked


def _with_events(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Usually the scenario itself, otherwise with one or two failures or disturbances.

    For half of the latter a theorem exists.
    """
    if random.random() >= _EVENTFUL:
        return scenario
    n, tau = scenario.n_robots, scenario.tau
    robot, times = int(random.integers(n)), np.sort(tau * random.integers(0, 40, 2))
    pull = 2.0 * scenario.bottleneck_weight / n
    events: dict[str, dict[str, Any]] = {
        "crash": {"crashes": [[robot, float(times[0])]]},
        "crashes": {"n_crashed": int(random.integers(1, n + 1))},
        "blind": {"sensor_failures": [[robot, float(times[0]), float(times[1] + tau)]]},
        "blinded": {"n_blind": int(random.integers(1, n + 1))},
        "adversary": {"adversaries": [[robot, float(times[0])]]},
        "adversaries": {"n_adversarial": int(random.integers(1, n + 1))},
        "drift": {"compass_drift": float(random.normal() * 0.3 / tau)},
        "walk": {"compass_walk": float(0.3 * random.random() / math.sqrt(tau))},
        "slip": {"slip": random.random()},
        "disturbance": {"disturbance": pull * log_uniform(random, 0.05, 2.0)},
        "noise": {"disturbance_noise": pull * log_uniform(random, 0.05, 2.0)},
    }
    names = [*events, "crash", "blind", "slip", "disturbance", "disturbance", "drift"]
    chosen: dict[str, Any] = {}
    for _ in range(pick(random, 1, 1, 2)):
        chosen |= events[str(pick(random, *names))]
    with suppress(ValueError):  # inconsistent fields
        eventful = scenario.replace(events=rv.Events(**chosen))
        lasting = scenario.sensing_graph.kind not in (*GRAPHS["changing"], "proximity")
        if not lasting or random.random() < 0.5:
            return eventful
        passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
        plain = {"sensing": rv.Sensing(), "obstacles": passed, "activation": rv.Activation()}
        step = scenario.certified_step * random.uniform(0.1, 1.0)
        speed = scenario.max_degree * random.uniform(1.0, 1.5)
        clock = {"time_step": step, "time_limit": 1000.0 * step, "max_speed": speed}
        return eventful.replace(**plain, **clock)
    return scenario


def _varied(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Usually the scenario itself, otherwise with several models, sensors or another area.

    The area of initial positions is a rectangle, a box or a region.
    """
    if random.random() >= _VARIED:
        return scenario
    change = pick(random, _of_several_models, _of_several_sensors, _in_an_area, _in_an_area)
    with suppress(ValueError):  # inconsistent fields
        return cast(rv.Scenario, change(random, scenario))
    return scenario


def _vary_gains(random: Random, scenario: rv.Scenario, given: Given) -> None:
    """Rarely give each robot its own limits of gains, within those of all."""
    limits = given["gains"]
    if random.random() < _VARIED and {*limits} == {"min_gain", "max_gain"}:
        low, high = limits["min_gain"], limits["max_gain"]
        own = np.sort(random.uniform(low, high, (2, scenario.n_robots)), axis=0)
        own[0, 0], own[1, -1] = low, high
        given["gains"] = {"min_gain": own[0].tolist(), "max_gain": own[1].tolist()}


def _of_several_models(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Scenario with several robot models.

    For half of them a theorem exists: no double integrators, exact bearings, no obstacles.
    """
    turning = "unicycle" if scenario.dim == 2 else "nonholonomic_3d"
    models = [turning, "single_integrator", "double_integrator"]
    drawn = [models[int(k)] for k in random.integers(0, 3, scenario.n_robots)]
    if random.random() < 0.5:
        return scenario.replace(robot_model=drawn)
    own = [turning, "single_integrator"]
    own += [own[int(k)] for k in random.integers(0, 2, scenario.n_robots - 2)]
    passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
    return scenario.replace(
        robot_model=random.permutation(own).tolist(), sensing=rv.Sensing(), obstacles=passed
    )


def _of_several_sensors(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Scenario with sensors that differ between robots.

    For half of them a bound is known: they miss neighbours at random only, are delayed, or err by
    bounded angles.
    """
    n, r = scenario.n_robots, scenario.merge_radius
    if random.random() < 0.5 and scenario.sensing_graph.kind != "proximity":
        sensing, step = _with_a_bound(random, scenario)
        passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
        return scenario.replace(
            sensing=sensing,
            obstacles=passed,
            max_speed=None,
            time_step=step,
            time_limit=1000.0 * step,
            activation=rv.Activation(),
            events=rv.Events(),
        )
    lists = {
        "range": [r * log_uniform(random, 3.0, 100.0) for _ in range(n - 1)] + [None],
        "field_of_view": random.uniform(0.5, 2.0 * np.pi, n).tolist(),
        "noise": [log_uniform(random, 0.001, 1.0) for _ in range(n)],
        "dropout": random.uniform(0.0, 0.9, n).tolist(),
        "min_range": [r * log_uniform(random, 0.3, 30.0) for _ in range(n)],
        "observer_bias": random.uniform(0.0, 1.0, n).tolist(),
        "outliers": random.uniform(0.0, 0.5, n).tolist(),
        "bias": random.uniform(0.0, 1.0, n).tolist(),
        "delay": random.integers(0, 6, n).tolist(),
        "delay_time": [log_uniform(random, 0.1, 4.0) * scenario.tau for _ in range(n)],
        "detection": [_table(random, r) for _ in range(n - 1)] + [[]],
        "persistence": [log_uniform(random, 0.1, 30.0) * scenario.tau for _ in range(n - 1)] + [0],
        "noise_correlation": [log_uniform(random, 0.01, 10.0) for _ in range(n - 1)] + [0],
        "sample_period": [log_uniform(random, 0.3, 9.0) * scenario.tau for _ in range(n - 1)] + [0],
        "view_falloff": random.uniform(0.0, 1.0, n).tolist(),
        "error": (np.pi / n * random.uniform(0.0, 1.2, n)).tolist(),
        "sectors": [*random.integers(2, 200, n - 1).tolist(), None],
        "occlusion": random.choice(["none", "obstacles", "robots", "both"], n).tolist(),
        "outlier_kind": random.permutation(np.resize(["uniform", "robot"], n)).tolist(),
    }
    names = random.permutation([*lists])[: pick(random, 1, 3, 5)]
    own = {name: lists[name] for name in names}
    if {"delay", "delay_time"} & {*own}:
        late = random.random(n) < 0.5  # some by steps, the others by seconds
        own = {"delay": 0, "delay_time": 0.0} | own
        for name, is_late in (("delay", late), ("delay_time", ~late)):
            if isinstance(own[name], list):
                own[name] = np.where(is_late, own[name], 0).tolist()
    for name, other in (("noise_correlation", "noise"), ("outlier_kind", "outliers")):
        if name in own and not scenario.sensing.largest(other):
            own.setdefault(other, lists[other])
    if "view_falloff" in own and scenario.sensing.smallest("field_of_view") > 6.0:
        own.setdefault("field_of_view", lists["field_of_view"])
    return scenario.replace(sensing=dataclasses.replace(scenario.sensing, **own))


def _with_a_bound(random: Random, scenario: rv.Scenario) -> tuple[rv.Sensing, float]:
    """Sensors for which a theorem may hold, and a step, s.

    Robots miss neighbours by chance alone, are late, err by bounded angles, or occlude each other.
    """
    n, r, longest = scenario.n_robots, scenario.merge_radius, scenario.certified_step
    step = longest * log_uniform(random, 0.1, 1.0)
    own: dict[str, Any] = {"dropout": random.uniform(0.0, 0.8, n).tolist(), "noise": 0.0}
    more = random.random()
    if more < 0.2:
        delays = random.integers(0, 5, n)
        late = longest * random.uniform(0.3, 1.05) / (delays.max() + 1)
        return rv.Sensing(delay=delays.tolist()), float(late)
    if more < 0.35:
        errors = np.pi / n * log_uniform(random, 0.001, 1.0) * random.random(n)
        return rv.Sensing(error=errors.tolist()), step
    if more < 0.45:
        hidden = random.choice(["none", "robots"], n).tolist()
        return rv.Sensing(occlusion=hidden, error=float(pick(random, 0.0, 0.1 / n))), step
    if more < 0.6:
        own["persistence"] = [step * log_uniform(random, 0.03, 30.0) for _ in range(n)]
    elif more < 0.75:
        own["detection"] = [_table(random, r) for _ in range(n - 1)] + [[]]
    return dataclasses.replace(by_chance(random, r, step), **own), step


def _in_an_area(random: Random, scenario: rv.Scenario) -> rv.Scenario:
    """Scenario with initial positions in a rectangle or box, or in two convex parts of it."""
    r, dim = scenario.merge_radius, scenario.dim
    edges = [r * log_uniform(random, 16.0, 60.0) for _ in range(dim)]
    changes: dict[str, Any] = {"spawn_size": edges, "start_positions": None}
    if dim == 2 and random.random() < 0.5:
        x, y = 0.5 * edges[0], 0.5 * edges[1]
        a, b = random.uniform(0.0, 0.4, 2)
        left = [[-x, -y], [-a * x, -y], [-b * x, y], [-x, y]]
        right = [[a * x, -y], [x, b * y], [a * x, y]]
        changes["start_region"] = [left, right][: pick(random, 1, 2)]
    passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
    return scenario.replace(**changes, obstacles=passed)


def other_starts(random: Random, scenario: rv.Scenario, places: Array, anew: float = 0.0) -> Starts:
    """The scenario with ``STARTS`` variations of initial positions (k, n, d), m."""
    n, dim, r = scenario.n_robots, scenario.dim, scenario.merge_radius
    reach, found = reach_of(scenario.sensing.smallest("range"), n, r), list[rv.Scenario]()
    for k in range(4 * STARTS):
        start = (
            places_of.random_positions(random, n, dim, r, reach) if random.random() < anew else None
        )
        if start is None:
            start = places_of.changed(random, places[k % len(places)], r)
        with suppress(ValueError):  # robots would be in an obstacle, or coincide
            found.append(scenario.replace(start_positions=start))
        if len(found) == STARTS:
            break
    return tuple(found)


def reach_of(sight: float | None, n: int, r: float) -> float:
    """Maximum initial link length, m, so that links stay visible after n − 1 merges."""
    return math.inf if sight is None else sight - (n - 1) * r / 2.0


def _arguments(random: Random, scenario: rv.Scenario, by: str) -> dict[str, float]:
    """Arguments of the certificate apart from ``by``, and of the wrapper."""
    if by in ("heading", "tank"):
        margin = {"min_alignment": float(1.0 - log_uniform(random, 0.02, 0.95))}
        budget = {"budget": float(log_uniform(random, 0.01, 10.0) * random.integers(2))}
        return margin if by == "heading" else margin | budget
    if by == "links":
        return {"share": log_uniform(random, 1e-3, 1.0)}
    if by == "gains" and random.random() < 0.6:
        most = min(scenario.max_degree, scenario.merge_radius / scenario.tau)
        low, high = sorted(most * random.uniform(0.05, 1.0, 2))
        return {"min_gain": float(low), "max_gain": float(high if random.random() < 0.7 else low)}
    return {}


def _tolerable(random: Random, scenario: rv.Scenario, given: Given) -> rv.Scenario:
    """Variant with bearing errors, noise, delay or missed detections that some theorem tolerates.

    Gains are equal if that theorem requires it.
    """
    n, step = scenario.n_robots, scenario.certified_step * log_uniform(random, 0.1, 1.0)
    passed = scenario.obstacles if scenario.obstacle_contact == "ignore" else ()
    exact = scenario.replace(sensing=rv.Sensing(), max_speed=None, obstacles=passed)
    lasting = exact.sensing_graph.kind not in GRAPHS["changing"]
    flaw = pick(random, "error", "error", "noise", "delay") if lasting else "error"
    chance = random.spawn(1)[0]  # other samples are then as without missed detections
    if chance.random() < _BY_CHANCE:
        sensing = by_chance(chance, scenario.merge_radius, step)
    elif flaw == "noise":
        sensing = rv.Sensing(noise=log_uniform(random, 0.01, 0.6))
    elif flaw == "delay":
        late = int(random.integers(1, 5))
        sensing = rv.Sensing(delay=late)
        step = exact.certified_step * random.uniform(0.3, 1.05) / (late + 1)
    else:
        by = pick(random, *CHOICES, "heading", "law")  # the lowest tolerance
        if by == "gains":
            gain = min(exact.max_degree, exact.merge_radius / step) * random.uniform(0.05, 0.5)
            given[by] = {"min_gain": float(gain), "max_gain": float(gain)}
        if by == "law" and random.random() < 0.7:
            graph = pick(random, rv.graphs.complete, rv.graphs.cycle) if n > 2 else rv.graphs.path
            exact = exact.replace(graph=graph(float(exact.max_degree / n)))
            step = exact.certified_step * log_uniform(random, 0.1, 0.7)
        exact = exact.replace(time_step=step, time_limit=1000.0 * step)
        found = rv.certificate(exact, by=by, **given[by])
        error = found.tolerated_bearing_error * random.uniform(0.1, 0.99)
        if random.random() < 0.6:  # rotated by an adversary, not only outward
            for own in given.values():
                own["bearing_error"] = error
            return exact
        sensing = rv.Sensing(error=error)
    return exact.replace(sensing=sensing, time_step=step, time_limit=1000.0 * step)


def by_chance(random: Random, r: float, tau: float) -> rv.Sensing:
    """Sensor that misses neighbours at random, for a merge radius r, m, and a step τ, s.

    Half have persistence or held rows, few have noise.
    """
    fields: dict[str, Any] = {}
    if random.random() < 0.5:
        fields["detection"] = _table(random, r)
    if not fields or random.random() < 0.3:
        fields["dropout"] = random.uniform(0.0, 0.8)
    if random.random() < 0.3:
        fields["persistence"] = tau * log_uniform(random, 0.03, 30.0)
    if random.random() < 0.3:
        fields["sample_period"] = tau * log_uniform(random, 0.5, 8.0)
    if random.random() < 0.1:
        fields["noise"] = log_uniform(random, 0.01, 0.6)
    return rv.Sensing(**fields)


def _table(random: Random, r: float) -> list[list[float]]:
    """Table of ``detection`` for a merge radius r, m."""
    distances = r * np.sort(random.uniform(0.3, 30.0, int(random.integers(1, 4))))
    chances = random.uniform(random.random(), 1.0, len(distances))
    return cast(list[list[float]], np.stack([distances, chances], axis=1).tolist())


def _scenario(random: Random, kind: Kind) -> rv.Scenario:
    n, dim = pick(random, *_SIZES), kind.dim
    r = pick(random, 0.2, 0.2, log_uniform(random, 0.05, 1.0))
    graph = pick(random, *GRAPHS[kind.graphs])
    sight = r * log_uniform(random, 0.6 * n + 2.0, 20.0 + n) if graph == "proximity" else None
    reach = reach_of(sight, n, r)
    fields: dict[str, Any] = {
        "n_robots": n,
        "dim": dim,
        "robot_model": kind.robot_model,
        "graph": random_graph(random, graph, n, r),
        "merge_radius": r,
        "allow_long_step": True,
        "obstacle_contact": pick(random, "slide", "stop", *["ignore"] * 4),
        "local_frames": pick(random, "random", "global"),
        "sensing": rv.Sensing() if kind.exact else _sensing(random, n, r, sight),
    }
    if random.random() < _CORNERS:
        return _corner(random, kind, fields, reach)
    fields["start_positions"] = places = places_of.random_positions(random, n, dim, r, reach)
    fields["spawn_size"] = side = r * log_uniform(random, 4.0, 25.0)
    fields["on_merge"] = pick(random, "remove", "follow")
    if kind.obstacles != "none":
        round_only = kind.obstacles == "round"
        fields["obstacles"] = places_of.obstacles(random, dim, round_only, r, places, side)
    scenario = rv.Scenario(**fields)
    return scenario.replace(**_clock(random, scenario))


def _corner(random: Random, kind: Kind, fields: dict[str, Any], reach: float) -> rv.Scenario:
    """Critical scenario: longest links, occluded light links, or nearly cancelling bearings.

    The last have long steps and slow robots.
    """
    n, dim, r, at = fields["n_robots"], kind.dim, fields["merge_radius"], places_of
    place = {"fixed": at.on_line, "changing": at.in_wedge, "proximity": at.in_tail}[kind.graphs]
    fields["start_positions"] = places = place(random, n, dim, r, reach)
    fields["local_frames"] = "global"
    if kind.graphs == "fixed" and not kind.exact:
        fields["sensing"] = rv.Sensing(occlusion="robots")
        fields["graph"] = _fixed(random, n, False, 1.0)
        if random.random() < 0.5:  # in a row; the next robot has the light link
            gaps = [r * log_uniform(random, 2.0, 20.0) for _ in range(n)]
            fields["start_positions"] = at.along_x(gaps, dim)
            far = np.abs(np.arange(n)[:, None] - np.arange(n)) > 1
            light = log_uniform(random, 0.003, 0.3) * (1.0 - np.eye(n))
            fields["graph"] = rv.graphs.from_matrix(np.where(far, 1.0, light))
    if kind.graphs == "changing":
        heavy = np.full((n, n), log_uniform(random, 0.003, 1.0))
        heavy[0] = 1.0
        fields["graph"] = rv.graphs.directed(heavy * (1.0 - np.eye(n)))
    if kind.obstacles != "none":
        balls = at.at_midpoints(random, places)
        if kind.obstacles == "any":
            balls.append(at.angular(random, dim, r, places + 100.0 * r))
        fields["obstacles"] = tuple(balls)
    scenario = rv.Scenario(**fields)
    if kind.graphs != "changing":
        return scenario.replace(**_clock(random, scenario))
    tau = scenario.certified_step * log_uniform(random, 1.0, 20.0)
    slow = r / tau * random.uniform(0.3, 1.0)
    return scenario.replace(time_step=tau, max_speed=slow, time_limit=1000.0 * tau)


def _clock(random: Random, scenario: rv.Scenario) -> dict[str, Any]:
    """Time step and speed limits: 0.1 to 20 times the certified values."""
    fields: dict[str, Any] = {}
    if random.random() < 0.6:
        longest = pick(random, 20.0, 20.0, 0.3)  # theorem N tolerates only short steps
        fields["time_step"] = scenario.certified_step * log_uniform(random, 0.1, longest)
    tau = fields.get("time_step", scenario.tau)
    if random.random() < 0.35:
        fields["max_speed"] = scenario.max_degree * log_uniform(random, 0.02, 2.0)
        if tau > scenario.certified_step and random.random() < 0.6:
            fields["max_speed"] = scenario.merge_radius / tau * random.uniform(0.3, 1.0)
    if random.random() < 0.3:
        fields["max_turn_rate"] = log_uniform(random, 0.1, 100.0)
    for name in fields.keys() & {"max_speed", "max_turn_rate"}:
        if random.random() < 0.3:
            shares = random.uniform(0.1, 1.0, scenario.n_robots)
            fields[name] = [float(share) * fields[name] for share in shares]
    if (dwell := getattr(scenario.sensing_graph, "dwell", math.inf)) <= tau:
        fields["time_step"] = dwell
    return fields | {"time_limit": 1000.0 * fields.get("time_step", scenario.tau)}


def _weight(random: Random) -> Any:
    """One weight, or a range of them."""
    low = pick(random, 1.0, log_uniform(random, 0.01, 100.0))
    return low if random.random() < 0.7 else (low, low * pick(random, 2.0, 100.0))


def _fixed(random: Random, n: int, directed: bool, density: float | None = None) -> Any:
    """Fixed links with equal weights, two weights, or weights over four decades, m/s."""
    density = density or pick(random, 1.0, 1.0, 0.6)
    kind, scale = int(random.integers(4)), log_uniform(random, 0.1, 10.0)
    weights = np.ones((n, n))
    if kind == 1:
        weights = np.where(random.random((n, n)) < 0.5, 1.0, log_uniform(random, 0.003, 0.3))
    elif kind == 2:
        weights = 10.0 ** random.uniform(-2.0, 2.0, (n, n))
    elif kind == 3:
        weights = random.uniform(0.5, 2.0, (n, n))
    weights = scale * weights * (random.random((n, n)) < density) * (1.0 - np.eye(n))
    if directed:
        return rv.graphs.directed(weights)
    return rv.graphs.from_matrix(np.triu(weights) + np.triu(weights).T)


def random_graph(random: Random, kind: str, n: int, r: float) -> Any:
    """A graph of one of GRAPHS for n robots, with random weights."""
    graphs = rv.graphs
    if kind in ("matrix", "directed"):
        return _fixed(random, n, kind == "directed")
    if kind == "switching":
        listed = [
            pick(random, _fixed(random, n, True), _fixed(random, n, False), graphs.complete())
            for _ in range(int(random.integers(1, 4)))
        ]
        if n > 3 and random.random() < 0.3:  # two sides with mutual links, then all
            side = np.arange(n) % 2
            across = (side[:, None] != side).astype(float)
            listed = [graphs.from_matrix(across), graphs.complete()]
        if (heaviest := max(graph.max_degree(n) for graph in listed)) == 0.0:
            raise ValueError("no graph of the list has an edge")
        dwell = r / (2.0 * heaviest) * log_uniform(random, 1.0, 20.0)
        return graphs.switching(listed, dwell, pick(random, "cyclic", "random"))
    if kind == "erdos_renyi":
        return graphs.erdos_renyi(random.uniform(0.2, 0.9), _weight(random))
    return getattr(graphs, "path" if kind == "cycle" and n == 2 else kind)(_weight(random))


def _sensing(random: Random, n: int, r: float, sight: float | None) -> rv.Sensing:
    """Sensor with one imperfection, rarely several."""
    fields: dict[str, Any] = {} if sight is None else {"range": sight}
    flaws = {
        "error": np.pi / n * log_uniform(random, 0.001, 1.5),
        "occlusion": pick(random, "robots", "robots", "obstacles", "both"),
        "noise": log_uniform(random, 0.001, 1.0),
        "bias": log_uniform(random, 0.001, 1.0),
        "dropout": random.uniform(0.0, 0.9),
        "delay": int(random.integers(1, 5)),
        "sectors": int(random.integers(2, 200)),
        "range": r * log_uniform(random, 3.0, 100.0),
        "field_of_view": random.uniform(0.5, 2.0 * np.pi),
    }
    names = [*flaws, *["error", "occlusion"] * 4]
    while (not fields or random.random() < 0.2) and (sight is None or random.random() < 0.4):
        name = str(pick(random, *names))
        fields.setdefault(name, flaws[name])
    own = random.spawn(1)[0]  # other samples are then as without effects of measured sensors
    if own.random() < 0.5:
        fields = {key: value for key, value in fields.items() if key == "range"}
        effects = _effects(own, r)
        fields |= {
            name: effects[name] for name in own.permutation([*effects])[: pick(own, 1, 1, 2)]
        }
    return rv.Sensing(**_completed(fields, own, n))


def _effects(random: Random, r: float) -> dict[str, Any]:
    """Effects of measured sensors."""
    return {
        "min_range": r * log_uniform(random, 0.3, 30.0),
        "sample_period": log_uniform(random, 0.001, 1.0),
        "delay_time": log_uniform(random, 0.001, 0.1),
        "observer_bias": log_uniform(random, 0.001, 1.0),
        "noise_correlation": log_uniform(random, 0.01, 10.0),
        "detection": [[r, random.random()], [20.0 * r, random.random()]],
        "persistence": log_uniform(random, 0.01, 10.0),
        "outliers": log_uniform(random, 0.001, 0.5),
    }


def _completed(fields: dict[str, Any], random: Random, n: int) -> dict[str, Any]:
    """Fields completed by those that depend on others."""
    if "delay" in fields:
        fields.pop("delay_time", None)
    if "noise_correlation" in fields:
        fields.setdefault("noise", log_uniform(random, 0.001, 1.0))
    if "persistence" in fields:
        fields.setdefault("dropout", random.uniform(0.0, 0.9))
    if "noise" in fields and random.random() < 0.2:
        fields["noise"] = [float(share) * fields["noise"] for share in random.random(n)]
    if fields.get("field_of_view", 2.0 * np.pi) < 2.0 * np.pi and random.random() < 0.3:
        fields["view_falloff"] = random.uniform(0.0, 0.5) * fields["field_of_view"]
    if "outliers" in fields:
        fields["outlier_kind"] = str(pick(random, "uniform", "robot"))
    return fields
