"""The named scenarios."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from .. import graphs
from ..checks import nearest_word, refuse, shown
from ..obstacles.disc import Disc, Sphere
from ..obstacles.fields import ObstacleField
from ..obstacles.polygon import Polygon
from ..obstacles.walls import WallField
from ..sensors.sensing import Sensing
from .scenario import Scenario

ScenarioLike = Scenario | str | os.PathLike[str]
"""A Scenario, the name of one, or the path of a TOML file."""


_AMONG_OBSTACLES: dict[str, Any] = {
    "max_speed": 1.0,
    "time_step": 0.05,
    "allow_long_step": True,
    "time_limit": 60.0,
}
"""The experiment of theory 6: the long step is meant, V still falls with it."""


def _figure(obstacle_contact: str) -> dict[str, Any]:
    """Field and start are our own choice, an obstacle in the way of every robot: the paper prints
    no coordinates.
    """
    return {
        "n_robots": 3,
        "start_positions": ((-4.0, -3.0), (4.5, -2.0), (0.5, 4.5)),
        "obstacles": (
            Disc(centre=(-1.9, -1.55), radius=0.8),
            Disc(centre=(0.6, 2.0), radius=0.7),
            Polygon(vertices=((2.0, -1.9), (2.9, -2.1), (3.1, -0.9), (2.2, -0.7))),
        ),
        "obstacle_contact": obstacle_contact,
    }


def _clutter(discs: int, robots: int = 4, passage: float = 0.0) -> dict[str, Any]:
    field = ObstacleField(discs, (0.8, 2.0), region=16.0, keep_out=0.5, passage=passage)
    return {"n_robots": robots, "obstacles": field, "spawn_size": 20.0, **_AMONG_OBSTACLES}


def _walls(
    layout: str, size: tuple[float, float], opening: tuple[float, float], spawn_size: float
) -> dict[str, Any]:
    """Walls longer than the team is wide: most ways round them raise V, which law (4) may not."""
    walls = WallField(layout, size, opening, thickness=0.5, region=2.0, keep_out=0.5)
    return {"obstacles": walls, "spawn_size": spawn_size, **_AMONG_OBSTACLES}


_corridor = partial(_walls, "corridor", (16.0, 20.0), (2.0, 4.0), 12.0)
_rooms = partial(_walls, "rooms", (10.0, 14.0), (0.8, 1.2), 14.0)


def _in_space(spheres: int, robot_model: str = "single_integrator") -> dict[str, Any]:
    return {
        "n_robots": 4,
        "dim": 3,
        "robot_model": robot_model,
        "obstacles": ObstacleField(spheres, (0.8, 2.0), region=10.0, keep_out=0.5),
        "spawn_size": 14.0,
        **_AMONG_OBSTACLES,
    }


def _walled_space(side: int, spawn_size: float, **features: Any) -> dict[str, Any]:
    walls = _beads(side, **features)
    return {**_in_space(0), "obstacles": walls, "spawn_size": spawn_size}


def _beads(side: int, rim: int = 0, window: bool = False) -> tuple[Sphere, ...]:
    """A square slab of spheres that leave no gap, so many along each side; with a rim, which makes
    a bowl of it, or without the one in its middle. Eight rays show a sphere as it is, and a long
    bar not.
    """
    places = range(-(side // 2), side // 2 + 1)
    return tuple(
        Sphere(centre=(1.1 * x, 1.1 * y, 1.1 * z), radius=0.8)
        for x in range(rim + 1)
        for y in places
        for z in places
        if (max(abs(y), abs(z)) == side // 2 if x else not window or (y, z) != (0, 0))
    )


def _turning(field: Callable[[], dict[str, Any]], turn_rate: float) -> dict[str, Any]:
    """The same for unicycles of so many rad/s, which at 1 m/s turn within a circle of 1/ω m, and
    need longer.
    """
    turns = {"robot_model": "unicycle", "max_turn_rate": turn_rate, "time_limit": 120.0}
    return {**field(), **turns}


def _wall() -> dict[str, Any]:
    box = Polygon(vertices=((-0.5, -50.0), (0.5, -50.0), (0.5, 50.0), (-0.5, 50.0)))
    starts = ((-0.6, 0.0), (0.6, 0.0))
    return {"n_robots": 2, "start_positions": starts, "obstacles": (box,), "max_speed": 1.0}


def _huettenrauch(sight: float | None = None) -> dict[str, Any]:
    """After Hüttenrauch, Šošić & Neumann (2019), with bearings alone; docs/scenarios.md says what
    is not kept. Who is far away is not seen, but is met all the same.
    """
    return {
        "n_robots": 20,
        "robot_model": "unicycle",
        "merge_radius": 1.0,
        "time_step": 0.1,
        "allow_long_step": True,
        "time_limit": 102.4,
        "max_speed": 10.0,
        "max_turn_rate": math.pi,
        "spawn_size": 90.0,
        "sensing": Sensing(range=sight),
    }


def _rotating_paths() -> dict[str, Any]:
    """Law (4) does not survive switching (guarantees, section 10): the three paths of three robots,
    one after another.

    At an end of the path f is one bearing. A heading on the edge of the cap, hᵀf = ε‖f‖, turned
    away from the other end, moves it by ε(ε g + √(1 − ε²) g⊥): mostly along the hull's outside. In
    an equilateral triangle each end adds ε(√3/2 √(1 − ε²) − 3/2 ε) to L', the middle −3ε² at least:

        L' = √3 ε √(1 − ε²) − 6 ε² > 0   for   ε < 1/√13 = 0.277

    and as the middle goes round, the triangle stays equilateral and L' the same.
    """
    paths = [[(middle, end) for end in range(3) if end != middle] for middle in range(3)]
    return {
        "n_robots": 3,
        "graph": graphs.switching([graphs.from_edges(path) for path in paths], dwell=1.0),
        "start_positions": ((0.0, 1.0), (-(0.75**0.5), -0.5), (0.75**0.5, -0.5)),
        "time_limit": 400.0,
    }


def _rssdoa() -> dict[str, Any]:
    """After the open code RSSDOA, without its signal strengths; docs/scenarios.md says what is not
    kept. No start can be certain to keep its links: 14 merges may lengthen one by 0.7 m.
    """
    return {
        "n_robots": 15,
        "graph": graphs.proximity(),
        "require_connected": False,
        "merge_radius": 0.1,
        "time_step": 0.033,
        "allow_long_step": True,
        "time_limit": 33.0,
        "max_speed": 0.075,
        "spawn_size": 2.0,
        "sensing": Sensing(range=0.8, noise=0.1),
    }


def _robotarium(robots: int) -> dict[str, Any]:
    """The Robotarium's arena of 3.2 m × 2 m and its robots, which count as colliding below 0.135 m:
    discs of 0.15 m that pack, with gains that never ask for more than 0.2 m/s.
    """
    return {
        "n_robots": robots,
        "graph": graphs.complete(0.2 / (robots - 1)),
        "merge_radius": 0.17,
        "body_radius": 0.075,
        "meeting": "pack",
        "time_step": 0.033,
        "time_limit": 60.0,
        "max_speed": 0.2,
        "spawn_size": 1.8,
    }


_FIELDS: dict[str, Callable[[], dict[str, Any]]] = {
    "fig3": partial(_figure, "ignore"),
    "fig4": partial(_figure, "slide"),
    "duo": lambda: {"n_robots": 2},
    "swarm-20": lambda: {"n_robots": 20, "time_limit": 10.0},
    "ring-12": lambda: {"n_robots": 12, "graph": graphs.cycle(), "time_limit": 60.0},
    "tree-12": lambda: {
        "n_robots": 12,
        "graph": graphs.random_tree((0.5, 2.0)),
        "time_limit": 20.0,
    },
    "random-10": lambda: {"n_robots": 10, "graph": graphs.erdos_renyi(0.3, (0.5, 1.5))},
    "unicycle-6": lambda: {"n_robots": 6, "robot_model": "unicycle"},
    "uav-6": lambda: {"n_robots": 6, "dim": 3, "robot_model": "nonholonomic_3d"},
    "cloud-8": lambda: {"n_robots": 8, "dim": 3},
    **{f"clutter-{discs}": partial(_clutter, discs) for discs in (4, 8, 12, 16, 24)},
    **{f"clutter-16-team-{robots}": partial(_clutter, 16, robots) for robots in (3, 8, 16, 32)},
    "clutter-32": partial(_clutter, 32, passage=0.2),
    "trap": partial(_walls, "trap", (7.0, 10.0), (5.0, 8.0), 12.0),
    "corridor": _corridor,
    "rooms": _rooms,
    "clutter-3d": partial(_in_space, 12),
    "clutter-3d-32": partial(_in_space, 32),
    "clutter-3d-96": partial(_in_space, 96),
    "slab-3d": partial(_walled_space, 7, 8.0),
    "bowl-3d": partial(_walled_space, 5, 8.0, rim=3),
    "window-3d": partial(_walled_space, 9, 10.0, window=True),
    "uav-clutter-16": lambda: {**_in_space(16, "nonholonomic_3d"), "max_turn_rate": 0.1},
    **{f"unicycle-clutter-{n}": partial(_turning, partial(_clutter, n), 3.0) for n in (8, 16, 24)},
    "unicycle-clutter-24-slow": partial(_turning, partial(_clutter, 24), 1.0),
    "unicycle-clutter-24-slower": partial(_turning, partial(_clutter, 24), 0.5),
    "unicycle-corridor": partial(_turning, _corridor, 1.0),
    "unicycle-rooms": partial(_turning, _rooms, 1.0),
    "rotating-paths": _rotating_paths,
    "wall": _wall,
    "noisy-8": lambda: {"n_robots": 8, "sensing": Sensing(noise=0.3, dropout=0.1)},
    "fov-8": lambda: {
        "n_robots": 8,
        "robot_model": "unicycle",
        "sensing": Sensing(field_of_view=2.0 * math.pi / 3.0),
    },
    # discs that stand in the way of sight as of robots, and robots that hide one another
    "occluded-8": lambda: {**_clutter(8, 8), "sensing": Sensing(occlusion="both")},
    "range-12": lambda: {
        "n_robots": 12,
        "graph": graphs.proximity(),
        "spawn_size": 8.0,
        "sensing": Sensing(range=4.0),
    },
    "switching-8": lambda: {
        "n_robots": 8,
        "graph": graphs.switching([graphs.path(), graphs.star(), graphs.cycle()], dwell=1.0),
        "time_limit": 60.0,
    },
    "pursuit-6": lambda: {"n_robots": 6, "graph": graphs.directed_cycle(), "time_limit": 60.0},
    "rssdoa-15": _rssdoa,
    **{f"robotarium-{robots}": partial(_robotarium, robots) for robots in (4, 10, 20)},
    "huettenrauch-20": _huettenrauch,
    "huettenrauch-20-sight-40": partial(_huettenrauch, 40.0),
}
"""What each differs in from the default; made when asked for, since polygons are slow to check."""


def names() -> list[str]:
    """Names of all scenarios."""
    return list(_FIELDS)


NAMESPACE = "rendezvous"
"""Of versioned names, in Gymnasium and PettingZoo too."""


@cache
def digests() -> dict[str, str]:
    """Of every scenario by its name and version: ``first_starts.digest`` of its first starts.

    A scenario's version is the number of its entry here. What changes the digest raises it.
    """
    path = Path(__file__).with_name("digests.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def with_versions() -> dict[str, str]:
    """The versioned name of every scenario that has one, by its plain name."""
    return {entry.rpartition("-v")[0]: f"{NAMESPACE}/{entry}" for entry in digests()}


def versioned(name: str) -> str:
    """The name with which results are quoted, such as "rendezvous/clutter-16-v1".

    Raises:
        ValueError: for the name of no scenario.
    """
    known = with_versions()
    if name not in known:
        entry = "; a new one needs an entry in scenario/digests.json" if name in _FIELDS else ""
        refuse("name", name, f"one of {', '.join(known)}{entry}")
    return known[name]


def _without_version(name: str) -> str:
    """The plain name of a versioned one; others as they are."""
    plain, version = name.removeprefix(f"{NAMESPACE}/"), ""
    if (found := re.fullmatch(r"(.+)-v(\d+)", plain)) and found[1] in _FIELDS:
        plain, version = found[1], found[0]
    elif plain != name and plain not in _FIELDS:
        return name
    if version and f"{NAMESPACE}/{version}" != versioned(plain):
        raise ValueError(
            f"scenario {shown(name)} is of another version; here it is {versioned(plain)}, and "
            "results of different versions do not compare"
        )
    return plain


def get(name: str) -> Scenario:
    """The scenario of that name, with or without namespace and version ("rendezvous/duo-v1").

    Raises:
        ValueError: for an unknown name, with the nearest known one, or a version that this is not.
    """
    name = _without_version(name) if isinstance(name, str) else name
    if not isinstance(name, str) or name not in _FIELDS:
        plain = re.sub(rf"^{NAMESPACE}/|-v\d+$", "", name) if isinstance(name, str) else name
        near = nearest_word(plain, _FIELDS)
        hint = f"did you mean {near!r}? " if near else ""
        raise ValueError(f"scenario {shown(name)} is unknown; {hint}known are {', '.join(_FIELDS)}")
    return Scenario(name=name, **_FIELDS[name]())


def resolve(scenario: ScenarioLike, **overrides: Any) -> Scenario:
    """A scenario from a Scenario, a name or the path of a TOML file, with some fields changed.

    Raises:
        ValueError: for anything else, or an unknown name or field, or an impossible value.
        FileNotFoundError: if there is no such file.
    """
    if not isinstance(scenario, Scenario | str | os.PathLike):
        refuse("scenario", scenario, "a Scenario, the name of one, or the path of a TOML file")
    if not isinstance(scenario, Scenario):
        is_file = str(scenario).endswith(".toml")
        scenario = Scenario.from_toml(scenario) if is_file else get(str(scenario))
    return scenario.replace(**overrides) if overrides else scenario
