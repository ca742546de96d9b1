"""Export of a policy as one NumPy-only Python file (``rendezvous export --standalone``)."""

import base64
import hashlib
import pprint
import runpy
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines import policy as registry
from rendezvous_env.baselines.learned.policy_settings import PolicySettings
from rendezvous_env.baselines.robot_policy import (
    RobotPolicy,
    check_kind,
    check_one_robot,
    common_gain,
)

from rendezvous_env import __version__
from rendezvous_env.scenario.scenario import Scenario

from .bundle import Bundle, Name, add_module, module_of

Network = tuple[Mapping[str, NDArray[Any]], PolicySettings]
"""Weights and settings of a learned policy."""
CLOSE = 1e-5
"""Maximum difference between a file and its policy, m/s."""
_ACTOR = ("features_extractor.", "mlp_extractor.policy_net.", "action_net.", "memory.")
_STAND_INS = {
    Name("rendezvous_env.compilation", "kernel"): '''
def kernel(function, inline="never"):
    """Nothing is compiled here."""
    return function
''',
    Name("rendezvous_env.compilation", "entry_point"): '''
def entry_point(function, arguments):
    """As ``kernel``."""
    return function
''',
    Name("rendezvous_env.safety.robot_lanes", "LANES"): "\nLANES = 1\n",
    Name("rendezvous_env.safety.safety_filter", "over_teams"): '''
def over_teams(calls_of, num_envs, n_robots, num_threads):
    """One team, one thread."""
    for call in calls_of((0, 1, 0)):
        call()
''',
    Name("rendezvous_env.safety.settings", "levels_follow_v"): '''
def levels_follow_v(scenario):
    """Stored energy follows V at observed merges only; a robot alone observes none."""
    return False
''',
    Name("rendezvous_env.scenario.scenarios", "resolve"): '''
def resolve(scenario, **overrides):
    """Scenario of this file."""
    return scenario
''',
    Name("rendezvous_env.field_checks", "check_fields"): '''
def check_fields(made):
    """Values were checked when this file was written."""
''',
}
_OF_OTHER_DIMENSIONS = {
    dim: {
        Name("rendezvous_env.baselines.steady_frames", word): f'''
class {word}:
    """This file is for robots of {where}."""
'''
    }
    for dim, word, where in ((2, "OdometryPlane", "the plane"), (3, "OdometryFrame", "space"))
}
_WITHOUT_BODIES = {
    Name(f"rendezvous_env.safety.{module}", word): f'''
def {word}(axes, teams, constants, arrays, work):
    """Filters in this file are for holonomic robots."""
    raise NotImplementedError
'''
    for module, word in (("heading", "_turn_bodies"), ("tank", "_spend_bodies"))
}
_OF_MIXED_TEAMS = {
    Name(f"rendezvous_env.safety.{module}", word): f'''
def {word}(axes, teams, constants, arrays, work):
    """This file is for one robot."""
    raise NotImplementedError
'''
    for module, word in (
        ("heading", "_steer_or_turn"),
        ("tank", "_spend_by_model"),
        ("safety_filter", "_look_of_some"),
    )
}
_OF_OTHER_GUIDES = {
    is_filtered: {
        Name(f"rendezvous_env.baselines.{module}", word): f'''
class {word}:
    """The policy of this file is {what} a filter."""
'''
    }
    for is_filtered, module, word, what in (
        (True, "search.direct_control", "DirectController", "under"),
        (False, "learned.base_controller", "BaseController", "without"),
    )
}
_ROOTS = (
    Name("rendezvous_env.baselines.robot_policy", "OneRobot"),
    Name("rendezvous_env.scenario.observation_layout", "ObservationLayout"),
)
_NETWORK = (
    Name("rendezvous_env.baselines.learned.learned_policy", "LearnedPolicy"),
    Name("rendezvous_env.baselines.learned.policy_settings", "PolicySettings"),
)
_WHEELS = (
    Name("rendezvous_env.baselines.robot_readings", "BodyReadings"),
    Name("rendezvous_env.robots.differential_drive", "DifferentialDrive"),
    Name("rendezvous_env.robots.differential_drive", "keep_apart"),
)
NUMBERS = (
    "name", "dim", "robot_model", "merge_radius", "tau", "certified_step", "dead_zone",
    "max_degree", "speed_limit", "min_speed_limit", "max_turn_rate", "min_turn_limit",
    "scales_velocity", "drops_neighbours", "action_size",
)  # fmt: skip
"""Scenario quantities used by single-robot policies."""

_MADE_BY = "rendezvous export --standalone"
_HEAD = '''"""The policy {policy} for a robot of the scenario {scenario}: bearings in, velocity out.

    robot = RobotPolicy()
    velocity = robot.act(bearings, obstacles, dt=0.03)     # as rendezvous_env's RobotPolicy.act
{drive}
It needs NumPy and nothing else. `{made_by}` of rendezvous-env {version} wrote
it, of the functions of that package, word for word; change them there. It refuses to be imported
once a byte of its text has changed. It may lie in a folder, in a zip archive or, unchecked, as
bytecode (.pyc).
"""

from __future__ import annotations

import base64
import hashlib
from types import SimpleNamespace
'''
_DRIVE = """    drive = DifferentialDrive()
    v, omega = drive.command(velocity, yaw, dt=0.03)
"""
_TEAM = '''

# ---- the team ---------------------------------------------------------------------------------

TEAM = SimpleNamespace(
    n_robots=1,  # that are steered from here; the numbers below are those of the whole team
    observation_layout=ObservationLayout({layout}),
    action_bounds=np.array({bounds}),
    robot_bounds=np.array([{least}]),  # lowest of the team
    per_robot=(),
    nonholonomic_robots=np.array([{nonholonomic}]),
    models=(SimpleNamespace(**{model}),),
    model=SimpleNamespace(**{model}),
    **{numbers},
)
ROBOT = SimpleNamespace(**vars(TEAM) | {{"action_bounds": np.array({own})}})


class RobotPolicy(OneRobot):
    """One robot with its policy, see ``OneRobot.act``; ``reset`` makes it forget everything."""

    def __init__(self):
        policy = {make}
        super().__init__(ROBOT, policy if IS_UNCHANGED else None, {gain!r})
'''
_LEARNED = '''
SETTINGS = {settings}
SHAPES = {shapes}


def weights_of(shapes, text):
    """The arrays (float32, little-endian, one after another) of a text, by name."""
    numbers, arrays, first = np.frombuffer(base64.b64decode(text), "<f4"), {{}}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        arrays[name] = numbers[first : first + size].reshape(shape)
        first += size
    return arrays


WEIGHTS = """
{weights}
"""


def learned_policy():
    """The network with its weights, and what stands around it."""
    settings = PolicySettings.from_plain(SETTINGS)
    return LearnedPolicy(TEAM, weights_of(SHAPES, WEIGHTS), settings)
'''
_LAST = '''

def text_of_this_file(names):
    """Text of this file as bytes, from a folder or a zip archive.

    None for bytecode (.pyc) and compiled programs.
    """
    path, loader = names.get("__file__"), names.get("__loader__")
    if path is None or path.endswith((".pyc", ".so", ".pyd")):
        return None
    try:
        if hasattr(loader, "get_data"):
            return loader.get_data(path)
        with open(path, "rb") as file:
            return file.read()
    except OSError:
        return None


def check_unchanged(names, digest):
    """Compare the text above the last line with its digest; True if equal or without text.

    Raises:
        ValueError: naming the file, if the text was changed.
    """
    text = text_of_this_file(names)
    if text is None:
        return True
    lines = text.replace(b"\\r\\n", b"\\n").splitlines(keepends=True)
    if hashlib.sha256(b"".join(lines[:-1])).hexdigest() != digest:
        raise ValueError(
            f"{names['__file__']}: its content was changed: its digest does not match"
        )
    return True


'''


def text_of(
    policy: str,
    scenario: Scenario,
    network: Network | None,
    build: Callable[..., Any] | None = None,
    own: Scenario | None = None,
) -> str:
    """Content of the file of a policy, by name, for a robot of a scenario.

    Without a network it is a law, a rule, or the result of a user's function ``build`` of a
    scenario. ``own`` is the scenario of the robot if limits of robots differ. A ValueError names
    robots or a policy that ``RobotPolicy`` does not support either, or code that cannot be in one
    file.
    """
    own = own or scenario
    check_one_robot(own)
    stand_ins = _STAND_INS | _OF_MIXED_TEAMS | _OF_OTHER_DIMENSIONS[scenario.dim]
    roots, extra = list(_ROOTS), ""
    if scenario.dim == 2:
        roots += _WHEELS
    if not scenario.model.nonholonomic:
        stand_ins |= _WITHOUT_BODIES
    if build is not None:
        roots.append(_own_root(build))
        make = f"{build.__name__}(TEAM)"
    elif network is None:
        registry.make(policy, scenario)
        check_kind(policy)
        build = registry.builder_of(policy)
        root = Name(build.__module__, build.__name__)
        if not root.is_ours:
            raise ValueError(f"policy {policy!r} is in {build.__module__}, not in this project")
        roots.append(root)
        make = f"{build.__name__}(TEAM)"
    else:
        roots += _NETWORK
        stand_ins |= _OF_OTHER_GUIDES[network[1].guarantee != "none"]
        make, extra = "learned_policy()", _learned(*network)
    head = _HEAD.format(
        policy=_in_docstring(policy),
        scenario=_in_docstring(scenario.name),
        version=__version__,
        made_by=_MADE_BY,
        drive=_DRIVE if scenario.dim == 2 else "",
    )
    about = ("name", "nonholonomic", "n_angles", "bounded", "theorem", "action")
    team = _TEAM.format(
        layout=", ".join(f"{key}={v}" for key, v in vars(scenario.observation_layout).items()),
        bounds=scenario.action_bounds.tolist(),
        least=scenario.robot_bounds.min(axis=0).tolist(),
        own=own.action_bounds.tolist(),
        nonholonomic=scenario.model.nonholonomic,
        model=_written({name: getattr(scenario.model, name) for name in about}),
        numbers=_written({name: getattr(scenario, name) for name in NUMBERS}),
        make=make,
        gain=common_gain(scenario),
    )
    content = head + _bundle(roots, stand_ins).text() + extra + team + _LAST
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f'{content}IS_UNCHANGED = check_unchanged(globals(), "{digest}")\n'


def _own_root(build: Callable[..., Any]) -> Name:
    """Name of a user's function, whose module is included from now on."""
    root = Name(build.__module__, getattr(build, "__name__", ""))
    add_module(root.module)
    try:
        found = module_of(root.module).definitions
    except (OSError, TypeError) as error:
        raise ValueError(f"{root.module} is not written in a Python file") from error
    if root.word not in found:
        raise ValueError(f"{root.module} does not define {root.word or build!r} by def or class")
    return root


def _bundle(roots: Sequence[Name], stand_ins: Mapping[Name, str]) -> Bundle:
    """Bundle that needs only NumPy; modules next to the user's are included."""
    bundle = Bundle(roots, stand_ins)
    while bundle.foreign:
        beside = [name for name in bundle.foreign if _lies_beside(name, roots)]
        if not beside:
            raise ValueError(
                f"it imports {', '.join(bundle.foreign)}; a standalone file may use NumPy only. A "
                "trained network is exported with --out FILE.onnx"
            )
        for name in beside:
            add_module(name)
        bundle = Bundle(roots, stand_ins)
    return bundle


def _lies_beside(module: str, roots: Sequence[Name]) -> bool:
    """True if a module is a file in a folder with a user's module."""
    place, own = sys.modules.get(module), sys.modules[roots[-1].module]
    files = [getattr(one, "__file__", None) for one in (place, own)]
    return None not in files and Path(files[0] or "").parent == Path(files[1] or "").parent


def _learned(weights: Mapping[str, NDArray[Any]], settings: PolicySettings) -> str:
    actor = {name: array for name, array in sorted(weights.items()) if name.startswith(_ACTOR)}
    numbers = np.concatenate([array.astype("<f4").ravel() for array in actor.values()])
    text = base64.b64encode(numbers.tobytes()).decode()
    return _LEARNED.format(
        settings=_written(settings.to_plain()),
        shapes=_written({name: array.shape for name, array in actor.items()}),
        weights="\n".join(textwrap.wrap(text, 100)),
    )


def _written(plain: Any) -> str:
    """Plain data as a Python literal, with numbers that round-trip."""
    return pprint.pformat(plain, width=96, sort_dicts=False)


def _in_docstring(name: str) -> str:
    """Name as a Python literal, without a quote that would end its docstring."""
    return repr(name).replace('"', r"\"")


def is_written(path: Path) -> bool:
    """True if a file is a standalone file, of any version, and may be overwritten."""
    begin, text = _HEAD.partition("{")[0].encode(), path.read_bytes()
    return text.startswith(begin) and _MADE_BY.encode() in text[: text.find(b'"""', len(begin))]


def load(path: Path) -> Any:
    """Load a file as a separate module."""
    return SimpleNamespace(**runpy.run_path(str(path), run_name="_robot"))


def compare(path: Path, robot: RobotPolicy, ticks: int) -> float:
    """Largest difference, m/s, of a file from a policy in ``corner_ticks`` and random ticks."""
    file, worst = load(path), 0.0
    for episode in (*corner_ticks(robot.scenario), drawn_ticks(robot.scenario, ticks)):
        written = file.RobotPolicy()
        robot.reset()
        for *seen, told in episode:
            apart = written.act(*seen, **told) - robot.act(*seen, **told)
            worst = np.maximum(worst, np.abs(apart).max())  # keeps NaN
    return float(worst)


def corner_ticks(scenario: Scenario) -> list[list[tuple[Any, ...]]]:
    """Short episodes as ``drawn_ticks``, in which f = 0 at first, later, or to the end.

    No neighbour is visible, or two opposite ones cancel, with an obstacle ahead or without. In
    others the only neighbour changes sides, and two neighbours have the same bearing.
    """
    layout, d = scenario.observation_layout, scenario.dim
    ahead, left = np.eye(d)[:1], np.eye(d)[1:2]
    pairs = [(left, -left), (ahead, -ahead), (ahead, ahead)]
    neighbours = [np.zeros((0, d)), -ahead, *map(np.concatenate, pairs)]
    obstacles = [np.zeros((0, layout.rows_per_obstacle, d))]
    if layout.obstacle_slots:
        obstacles.append(_silhouettes(ahead, np.full((1, 1, 1), 0.5)))
    told = {"gravity": -np.eye(3)[2]} if layout.senses_gravity else {}
    weight, episodes = scenario.max_degree / max(1, layout.neighbour_slots), []
    for rows, edges in product(neighbours, obstacles):
        if len(rows) <= layout.neighbour_slots:
            for order in ((rows, rows, rows, ahead), (ahead, rows, ahead, rows, rows)):
                weights = [{"weights": np.full(len(seen), weight)} for seen in order]
                ticks = zip(order, weights, strict=True)
                episodes.append([(seen, edges, scenario.tau, told | own) for seen, own in ticks])
    return episodes


def drawn_ticks(scenario: Scenario, ticks: int) -> Iterator[tuple[Any, ...]]:
    """Random bearings, obstacles, dt, and further arguments of ``act`` by name.

    The scene moves as a robot could measure it; from time to time it is replaced.
    """
    random, layout = np.random.default_rng(0), scenario.observation_layout
    most = layout.neighbour_slots, layout.obstacle_slots
    for tick in range(ticks):
        if tick % 100 == 0:
            counts = [random.integers(slots + 1) for slots in most]
            bearings, middles = (random.normal(size=(count, layout.dim)) for count in counts)
            widths = random.uniform(0.05, 1.0, (counts[1], 1, 1))
            told = {"weights": np.full(counts[0], scenario.max_degree / max(1, most[0]))}
        bearings, middles = (
            _units(rows + random.normal(0.0, 0.02, rows.shape)) for rows in (bearings, middles)
        )
        if layout.senses_gravity:
            told["gravity"] = _units(np.array([random.normal(0.0, 0.02), 0.0, -1.0]))
        dt = scenario.tau * random.uniform(0.3, 1.0)
        yield bearings, _silhouettes(middles, widths), dt, told


def _silhouettes(middles: NDArray[np.float64], widths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges (m, S, d) of round obstacles in directions (m, d), of half angles (m, 1, 1), rad."""
    if middles.shape[1] == 2:
        left = np.stack([-middles[:, 1], middles[:, 0]], axis=-1)
        rims = np.stack([left, -left], axis=1)
    else:
        first = _units(np.cross(middles, np.roll(middles, 1, axis=1)))
        second, azimuth = np.cross(middles, first), 0.25 * np.pi * np.arange(8)[:, np.newaxis]
        rims = np.cos(azimuth) * first[:, np.newaxis] + np.sin(azimuth) * second[:, np.newaxis]
    return np.cos(widths) * middles[:, np.newaxis] + np.sin(widths) * rims


def _units(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
