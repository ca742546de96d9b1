"""Named scenarios."""

import dataclasses
import json
import math
import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ..checks import raise_invalid, short_repr
from ..sensors.sensing import Sensing
from ..suggestions import closest_match
from .scenario import Scenario

ScenarioLike = Scenario | str | os.PathLike[str] | Mapping[str, Any]
"""A Scenario, the name of one, the path of a TOML file, or plain data (``Scenario.to_plain``)."""
Fields = dict[str, Any]
"""Non-default fields of a scenario as plain data, validated on access."""

# The experiment of theory 6: the long step is intended; V still decreases.
_AMONG_OBSTACLES: Fields = {
    "max_speed": 1.0,
    "time_step": 0.05,
    "allow_long_step": True,
    "time_limit": 60.0,
}
# The paper gives no coordinates: obstacles and initial positions are our choice, with an obstacle
# in the path of every robot.
_FIGURE: Fields = {
    "n_robots": 3,
    "start_positions": [[-4.0, -3.0], [4.5, -2.0], [0.5, 4.5]],
    "obstacles": [
        {"centre": [-1.9, -1.55], "radius": 0.8},
        {"centre": [0.6, 2.0], "radius": 0.7},
        {"vertices": [[2.0, -1.9], [2.9, -2.1], [3.1, -0.9], [2.2, -0.7]]},
    ],
}


def _field(count: int, region: float, **more: Any) -> Fields:
    return {"count": count, "radius": [0.8, 2.0], "region": region, "keep_out": 0.5, **more}


def _clutter(discs: int, robots: int = 4, **more: Any) -> Fields:
    field = _field(discs, 16.0, **more)
    return {"n_robots": robots, "obstacles": field, "spawn_size": 20.0, **_AMONG_OBSTACLES}


def _walls(layout: str, size: list[float], opening: list[float], spawn_size: float) -> Fields:
    """Walls longer than the team: most paths around them increase V, which law (4) cannot do."""
    walls = {"layout": layout, "size": size, "opening": opening, "thickness": 0.5}
    placed = {**walls, "region": 2.0, "keep_out": 0.5}
    return {"obstacles": placed, "spawn_size": spawn_size, **_AMONG_OBSTACLES}


_CORRIDOR = _walls("corridor", [16.0, 20.0], [2.0, 4.0], 12.0)
_ROOMS = _walls("rooms", [10.0, 14.0], [0.8, 1.2], 14.0)


def _in_space(obstacles: Any, spawn_size: float = 14.0, **more: Any) -> Fields:
    team = {"n_robots": 4, "dim": 3, "spawn_size": spawn_size, **_AMONG_OBSTACLES}
    return {**team, "obstacles": obstacles, **more}


def _beads(side: int, rim: int = 0, window: bool = False) -> list[Fields]:
    """Square slab of overlapping spheres, with an optional rim (bowl) or central opening (window).

    Spheres are used because eight rays represent them exactly, unlike long bars.
    """
    places = range(-(side // 2), side // 2 + 1)
    return [
        {"centre": [1.1 * x, 1.1 * y, 1.1 * z], "radius": 0.8}
        for x in range(rim + 1)
        for y in places
        for z in places
        if (max(abs(y), abs(z)) == side // 2 if x else not window or (y, z) != (0, 0))
    ]


def _turning(fields: Fields, turn_rate: float) -> Fields:
    """Variant for unicycles, which need more time: at 1 m/s their turning radius is 1/ω m."""
    turns = {"robot_model": "unicycle", "max_turn_rate": turn_rate, "time_limit": 120.0}
    return {**fields, **turns}


# After Hüttenrauch, Šošić & Neumann (2019), with bearings only; docs/scenarios.md lists the
# differences. Distant robots are not observed, but must be met.
_HUETTENRAUCH: Fields = {
    "n_robots": 20,
    "robot_model": "unicycle",
    "merge_radius": 1.0,
    "time_step": 0.1,
    "allow_long_step": True,
    "time_limit": 102.4,
    "max_speed": 10.0,
    "max_turn_rate": math.pi,
    "spawn_size": 90.0,
}
# Law (4) can fail on switching graphs (guarantees, section 10): the three paths of three robots in
# sequence.
#
# At an end of the path f is one bearing. A heading on the edge of the cap, hᵀf = ε‖f‖, turned away
# from the other end, moves it by ε(ε g + √(1 − ε²) g⊥): mostly along the hull's outside. In an
# equilateral triangle each end adds ε(√3/2 √(1 − ε²) − 3/2 ε) to L', the middle −3ε² at least:
#
#     L' = √3 ε √(1 − ε²) − 6 ε² > 0   for   ε < 1/√13 = 0.277
#
# and as the middle alternates, the triangle stays equilateral and L' the same.
_PATHS = [[[middle, end] for end in range(3) if end != middle] for middle in range(3)]
_ROTATING_PATHS: Fields = {
    "n_robots": 3,
    "graph": {"kind": "switching", "graphs": [{"edges": path} for path in _PATHS]},
    "start_positions": [[0.0, 1.0], [-(0.75**0.5), -0.5], [0.75**0.5, -0.5]],
    "time_limit": 400.0,
}
# After the open code RSSDOA, without its signal strengths; docs/scenarios.md lists the differences.
# No initial condition is certain to keep its links: 14 merges may lengthen one by 0.7 m.
_RSSDOA: Fields = {
    "n_robots": 15,
    "graph": "proximity",
    "require_connected": False,
    "merge_radius": 0.1,
    "time_step": 0.033,
    "allow_long_step": True,
    "time_limit": 33.0,
    "max_speed": 0.075,
    "spawn_size": 2.0,
    "sensing": {"range": 0.8, "noise": 0.1},
}


def _robotarium(robots: int) -> Fields:
    """The Robotarium: an arena of 3.2 m × 2 m and robots that collide below 0.135 m.

    Robots are packing discs of 0.15 m with edge weights that keep speeds below 0.2 m/s.
    """
    return {
        "n_robots": robots,
        "graph": {"weight_range": 0.2 / (robots - 1)},
        "merge_radius": 0.17,
        "body_radius": 0.075,
        "meeting": "pack",
        "time_step": 0.033,
        "time_limit": 60.0,
        "max_speed": 0.2,
        "spawn_size": 1.8,
    }


def _utias(robots: int, spawn_size: float | list[float], **more: Any) -> Fields:
    """Robots of the MRCLAM logs, with their speeds, turn rates and measured cameras."""
    return {
        "n_robots": robots,
        "robot_model": "unicycle",
        "merge_radius": 0.35,
        "time_step": 0.1,
        "allow_long_step": True,
        "time_limit": 1300.0,
        "max_speed": 0.075,
        "max_turn_rate": 0.4,
        "spawn_size": spawn_size,
        "sensing": Sensing.mrclam(),
        **more,
    }


# Discs that occlude robots, as the barriers of MRCLAM data set 9 do; their sizes are our choice.
_UTIAS_DISCS: Fields = {
    "obstacles": {"count": 8, "radius": [0.2, 0.5], "region": 6.0, "keep_out": 0.3},
    "sensing": dataclasses.replace(Sensing.mrclam(), occlusion="obstacles"),
}
# The team of docs/worlds.md as unicycles, with forward cameras.
_CAMERA: Fields = {
    "n_robots": 8,
    "robot_model": "unicycle",
    "merge_radius": 0.4,
    "time_step": 0.05,
    "allow_long_step": True,
    "time_limit": 120.0,
    "max_speed": 1.0,
    "max_turn_rate": 3.0,
    "sensing": dataclasses.replace(Sensing.camera(), field_of_view=math.radians(66.0)),
}


def _crossing(y: float, x: float, seconds: float, shape: Fields) -> Fields:
    """Obstacle that crosses from x to −x at height y and back, in twice ``seconds``."""
    rows = [[0.0, 0.0, 0.0], [seconds, -2.0 * x, 0.0], [2.0 * seconds, 0.0, 0.0]]
    return {
        "kind": "moving",
        "shape": {key: _moved(key, at, x, y) for key, at in shape.items()},
        "waypoints": rows,
    }


def _moved(key: str, value: Any, x: float, y: float) -> Any:
    """Centre, ends or vertices of a shape, moved to a place; other values unchanged."""
    if key == "centre":
        return [value[0] + x, value[1] + y]
    if key in ("ends", "vertices"):
        return [[corner[0] + x, corner[1] + y] for corner in value]
    return value


# Three lanes of traffic across the area, one with a long vehicle, and a disc on a random walk.
_VEHICLE: Fields = {"vertices": [[-1.2, -0.5], [1.2, -0.5], [1.2, 0.5], [-1.2, 0.5]]}
_BAR: Fields = {"ends": [[0.0, -0.8], [0.0, 0.8]], "radius": 0.4}
_CROSSING_TRAFFIC: Fields = {
    "n_robots": 8,
    "spawn_size": 14.0,
    "obstacles": [
        _crossing(4.0, -8.0, 20.0, _VEHICLE),
        _crossing(4.0, 4.0, 20.0, {"centre": [0.0, 0.0], "radius": 0.7}),
        _crossing(0.0, 8.0, 24.0, _BAR),
        _crossing(0.0, -3.0, 15.0, {"centre": [0.0, 0.0], "radius": 0.8}),
        _crossing(-4.0, -8.0, 16.0, {"centre": [0.0, 0.0], "radius": 0.9}),
        _crossing(-4.0, 5.0, 25.0, _VEHICLE),
        {
            "kind": "moving",
            "shape": {"centre": [0.0, 2.0], "radius": 0.6},
            "speed": 0.4,
            "box": [[-6.0, -6.0], [6.0, 6.0]],
            "interval": 4.0,
        },
    ],
    **_AMONG_OBSTACLES,
}


_FIELDS: dict[str, Fields] = {
    "fig3": {**_FIGURE, "obstacle_contact": "ignore"},
    "fig4": {**_FIGURE, "obstacle_contact": "slide"},
    "duo": {"n_robots": 2},
    "swarm-20": {"n_robots": 20, "time_limit": 10.0},
    "ring-12": {"n_robots": 12, "graph": "cycle", "time_limit": 60.0},
    "tree-12": {
        "n_robots": 12,
        "graph": {"kind": "random_tree", "weight_range": [0.5, 2.0]},
        "time_limit": 20.0,
    },
    "random-10": {
        "n_robots": 10,
        "graph": {"kind": "erdos_renyi", "probability": 0.3, "weight_range": [0.5, 1.5]},
    },
    "unicycle-6": {"n_robots": 6, "robot_model": "unicycle"},
    "mixed-8": {
        "n_robots": 8,
        "robot_model": ["single_integrator"] * 4 + ["unicycle"] * 4,
        "max_speed": [1.0] * 4 + [0.5] * 4,
        "max_turn_rate": 3.0,
        "time_limit": 60.0,
    },
    "uav-6": {"n_robots": 6, "dim": 3, "robot_model": "nonholonomic_3d"},
    "cloud-8": {"n_robots": 8, "dim": 3},
    **{f"clutter-{discs}": _clutter(discs) for discs in (4, 8, 12, 16, 24)},
    **{f"clutter-16-team-{robots}": _clutter(16, robots) for robots in (3, 8, 16, 32)},
    "clutter-32": _clutter(32, passage=0.2),
    "trap": _walls("trap", [7.0, 10.0], [5.0, 8.0], 12.0),
    "corridor": _CORRIDOR,
    "rooms": _ROOMS,
    "clutter-3d": _in_space(_field(12, 10.0)),
    "clutter-3d-32": _in_space(_field(32, 10.0)),
    "clutter-3d-96": _in_space(_field(96, 10.0)),
    "slab-3d": _in_space(_beads(7), 8.0),
    "bowl-3d": _in_space(_beads(5, rim=3), 8.0),
    "window-3d": _in_space(_beads(9, window=True), 10.0),
    "uav-clutter-16": _in_space(_field(16, 10.0), robot_model="nonholonomic_3d", max_turn_rate=0.1),
    **{f"unicycle-clutter-{discs}": _turning(_clutter(discs), 3.0) for discs in (8, 16, 24)},
    "unicycle-clutter-24-slow": _turning(_clutter(24), 1.0),
    "unicycle-clutter-24-slower": _turning(_clutter(24), 0.5),
    "unicycle-corridor": _turning(_CORRIDOR, 1.0),
    "unicycle-rooms": _turning(_ROOMS, 1.0),
    "rotating-paths": _ROTATING_PATHS,
    "wall": {
        "n_robots": 2,
        "start_positions": [[-0.6, 0.0], [0.6, 0.0]],
        "obstacles": {"vertices": [[-0.5, -50.0], [0.5, -50.0], [0.5, 50.0], [-0.5, 50.0]]},
        "max_speed": 1.0,
    },
    "noisy-8": {"n_robots": 8, "sensing": {"noise": 0.3, "dropout": 0.1}},
    "fov-8": {
        "n_robots": 8,
        "robot_model": "unicycle",
        "sensing": {"field_of_view": 2.0 * math.pi / 3.0},
    },
    "failures-8": {
        "n_robots": 8,
        "activation": {"kind": "bounded", "max_wait": 3},
        "hold": "stop",
        "events": {"n_crashed": 1, "slip": 0.2},
        "time_limit": 60.0,
    },
    # discs and robots that occlude other robots
    "occluded-8": {**_clutter(8, 8), "sensing": {"occlusion": "both"}},
    "range-12": {
        "n_robots": 12,
        "graph": "proximity",
        "spawn_size": 8.0,
        "sensing": {"range": 4.0},
    },
    "crossing-traffic-8": _CROSSING_TRAFFIC,
    "switching-8": {
        "n_robots": 8,
        "graph": {"kind": "switching", "graphs": ["path", "star", "cycle"]},
        "time_limit": 60.0,
    },
    "pursuit-6": {"n_robots": 6, "graph": "directed_cycle", "time_limit": 60.0},
    "rssdoa-15": _RSSDOA,
    **{f"robotarium-{robots}": _robotarium(robots) for robots in (4, 10, 20)},
    "huettenrauch-20": _HUETTENRAUCH,
    "huettenrauch-20-sight-40": {**_HUETTENRAUCH, "sensing": {"range": 40.0}},
    "utias-5": _utias(5, [5.0, 9.5]),
    "utias-10": _utias(10, 12.0),
    "utias-5-clutter": _utias(5, [5.0, 9.5], **_UTIAS_DISCS),
    "utias-5-pack": _utias(5, [5.0, 9.5], body_radius=0.17, meeting="pack"),
    "camera-8": _CAMERA,
}


def names() -> list[str]:
    """Names of all scenarios."""
    return list(_FIELDS)


NAMESPACE = "rendezvous"  # of versioned names, in Gymnasium and PettingZoo too
_NAME = re.compile(rf"(?:{NAMESPACE}/)?(?P<plain>.+?)(?P<version>-v\d+)?")


@cache
def digests() -> dict[str, str]:
    """Digests of the first initial conditions by name and version.

    The number of entries is the version of a scenario; a changed digest requires a new version.
    """
    path = Path(__file__).with_name("digests.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def with_versions() -> dict[str, str]:
    """Versioned names by plain name."""
    return {entry.rpartition("-v")[0]: f"{NAMESPACE}/{entry}" for entry in digests()}


def versioned(name: str) -> str:
    """Versioned name for citing results, such as "rendezvous/clutter-16-v1".

    Raises:
        ValueError: for an unknown name.
    """
    known = with_versions()
    if name not in known:
        entry = "; a new one needs an entry in scenario/digests.json" if name in _FIELDS else ""
        raise_invalid("name", name, f"one of {', '.join(known)}{entry}")
    return known[name]


def get(name: str) -> Scenario:
    """Scenario by name, with or without namespace and version ("rendezvous/duo-v1").

    Raises:
        ValueError: for an unknown name (with the closest match) or another version.
    """
    parts = _NAME.fullmatch(name) if isinstance(name, str) else None
    plain = parts["plain"] if parts else name
    if parts is None or plain not in _FIELDS:
        hint = closest_match(plain, _FIELDS, after=" ")
        raise ValueError(
            f"scenario {short_repr(name)} is unknown; {hint}known are {', '.join(_FIELDS)}"
        )
    if parts["version"] and f"{NAMESPACE}/{plain}{parts['version']}" != versioned(plain):
        raise ValueError(
            f"scenario {short_repr(name)} is of another version; the current one is "
            f"{versioned(plain)}, "
            "and "
            "results of different versions do not compare"
        )
    return Scenario(name=plain, **_FIELDS[plain])


def resolve(scenario: ScenarioLike, **overrides: Any) -> Scenario:
    """Scenario from a Scenario, a name, a TOML path or plain data, with some fields changed.

    Raises:
        ValueError: for anything else, or an unknown name or field, or an invalid value.
        FileNotFoundError: if there is no such file.
    """
    if isinstance(scenario, Mapping):
        scenario = Scenario.from_plain(scenario)
    if not isinstance(scenario, Scenario | str | os.PathLike):
        wanted = "a Scenario, its plain data, the name of one, or the path of a TOML file"
        raise_invalid("scenario", scenario, wanted)
    if not isinstance(scenario, Scenario):
        is_file = str(scenario).lower().endswith(".toml")
        scenario = Scenario.from_toml(scenario) if is_file else get(str(scenario))
    return scenario.replace(**overrides) if overrides else scenario
