"""``rendezvous export``: a policy as one Python file, or its network as an ONNX file."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines import trained_policy
from rendezvous_env.baselines.learned import checkpoints
from rendezvous_env.baselines.learned.features import (
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    FeatureLayout,
)
from rendezvous_env.baselines.learned.numpy_actor import Layer, NumpyActor, RecurrentUnit
from rendezvous_env.baselines.learned.onnx_network import (
    DIGEST_KEY,
    NO_DIGEST,
    SETTINGS_KEY,
    SUFFIX,
    OnnxNetwork,
    digest_of,
)
from rendezvous_env.baselines.learned.policy_settings import PolicySettings
from rendezvous_env.baselines.robot_policy import RobotPolicy, check_one_robot, of_one_robot
from rendezvous_env.baselines.trained_policy import TrainedPolicy

from rendezvous_env.scenario.scenario import Scenario

from . import policies, standalone, trained_onnx
from .checks import Bounds, Flags, UserError, check_installed, user_error
from .console import Console
from .results import atomic, prepare_file

_SLOTS = ((3, 12), (1, 0), (31, 24), (7, 1))
"""Numbers of neighbours and obstacles in the inputs of the check."""
_AT_ONCE = 512
_CLOSE = 1e-4
"""Relative tolerance of the check, which allows for another summation order."""

EXAMPLES = (
    "--policy learned --out out/policy.onnx",
    "--policy learned-tank --standalone robot.py --scenario clutter-8",
    "--policy by-model --standalone robot_0.py --scenario mixed-8 --robot 0",
)


@dataclass(frozen=True)
class Config(Flags):
    """Export a learned network as ONNX, or a policy as one NumPy-only Python file, and check it."""

    policy: str = "learned"
    """Name of a policy, learned:PATH of a run or a checkpoint, or module:function of a custom one.
    An ONNX file needs a shipped policy, a checkpoint, or a custom TrainedPolicy of a model of
    stable-baselines3 or torch. With --standalone, laws, rules and custom policies that need only
    NumPy are possible as well."""
    out: Path = Path("out/policy.onnx")
    """ONNX file to write. An older one is replaced; any other kind of file is kept."""
    standalone: Path | None = None
    """Python file to write instead of an ONNX file; replaced under the same condition."""
    scenario: str = "clutter-8"
    """Name or TOML file of the scenario that defines the robot. An ONNX file fits all robots of
    that robot model."""
    robot: Annotated[int | None, Bounds(0, 10**4)] = None
    """Index of the robot, needed where models of robots differ; with --standalone also where their
    limits differ."""
    checks: Annotated[int, Bounds(1, 10**7)] = 10_000
    """Number of random inputs on which the file is compared with the policy before it is
    written."""


def run(config: Config) -> int:
    """Write and check the file; a UserError also if its output differs from the policy's."""
    flag, path, ending, is_written = "--out", config.out, SUFFIX, _is_written
    if config.standalone is not None:
        flag, path, ending = "--standalone", config.standalone, ".py"
        is_written = standalone.is_written
    if path.suffix.lower() != ending:
        raise UserError(f"{flag} {path}: unknown ending; it must be {ending}")
    with user_error(f"{flag} {path}: cannot be read: ", OSError):
        others = path.is_file() and not is_written(path)
    if others:
        raise UserError(f"{flag} {path}: exists, and was not written by this command")
    said = _write_onnx(config, path) if ending == SUFFIX else _write_python(config, path)
    Console().print(f"{path}: {config.policy}{said} at most")
    return 0


def _is_written(path: Path) -> bool:
    """True if a file is an ONNX file written by any version of this command."""
    content = path.read_bytes()
    return SETTINGS_KEY.encode() in content or trained_policy.ARGUMENTS_KEY.encode() in content


def _write_onnx(config: Config, path: Path) -> str:
    """Write and check an ONNX file; returns a message with size and error."""
    check_installed("export", "export", "onnx", "onnxruntime")
    policies.check_names([config.policy])
    _, scenario, name = _of_robot(config)
    network = _network_of(name, scenario)
    if network is None:
        return _write_model(config, path, scenario)
    with user_error(f"--policy {config.policy}: ", ValueError):
        check_one_robot(scenario if scenario.mixes_models else scenario.of_robot(0))
    prepare_file(path, "--out")
    with atomic(path) as temporary:
        temporary.write_bytes(model_of(*network).SerializeToString())
        apart = _compare(temporary, network, config.checks)
        _check_close(apart, _CLOSE, "of the largest preference")
        size = temporary.stat().st_size
    return (
        f", {size / 1e3:.0f} kB; on {config.checks} random inputs it differs by {apart:.1e} of "
        "the largest preference"
    )


def _of_robot(config: Config) -> tuple[Scenario, Scenario, str]:
    """As ``of_one_robot``, for the robot of the command."""
    team = policies.resolve_scenario(config.scenario)
    with user_error(f"--robot {config.robot}: ", ValueError):
        return of_one_robot(team, config.policy, config.robot)


def _write_model(config: Config, path: Path, scenario: Scenario) -> str:
    """As ``_write_onnx`` for the model of a custom policy."""
    with user_error(f"--policy {config.policy}: ", ValueError):
        policy = policies.make(config.policy, scenario)
    if not isinstance(policy, TrainedPolicy):
        raise UserError(
            f"--policy {config.policy}: is scripted and has no network; use --standalone robot.py"
        )
    check_installed("export of a model", "train", "torch")
    prepare_file(path, "--out")
    with atomic(path) as temporary:
        temporary.write_bytes(trained_onnx.content_of(policy))
        written = trained_policy.load(temporary, scenario)
        assert isinstance(written, TrainedPolicy)
        apart = trained_onnx.compare(policy, written, config.checks)
        _check_close(apart, _CLOSE, "of an action")
        size = temporary.stat().st_size
    return f", {size / 1e3:.0f} kB; on {config.checks} random inputs it differs by {apart:.1e}"


def _write_python(config: Config, path: Path) -> str:
    """Write and check a standalone Python file; returns a message."""
    policies.check_names([config.policy])
    own, scenario, name = _of_robot(config)
    network, build = _network_of(name, scenario), None
    if policies.is_user_policy(name):
        build = policies.find_function(name)
    prepare_file(path, "--standalone")
    with atomic(path) as temporary:
        with user_error(f"--policy {config.policy}: ", ValueError):
            text = standalone.text_of(name, scenario, network, build, own)
            robot = RobotPolicy(scenario, policies.make(name, scenario), robot=config.robot)
        temporary.write_text(text, encoding="utf-8")
        with _on_board(build is not None):
            apart = standalone.compare(temporary, robot, config.checks)
            _check_close(apart, standalone.CLOSE, "m/s")
    whose = scenario.name if config.robot is None else f"robot {config.robot} of {scenario.name}"
    return (
        f" for {whose}, {len(text) / 1e3:.0f} kB, needs NumPy; on {config.checks} random ticks it "
        f"differs by {apart:.1e} m/s"
    )


@contextmanager
def _on_board(is_own: bool) -> Iterator[None]:
    """Report which scenario quantities a custom policy's file contains."""
    try:
        yield
    except Exception as error:
        if not is_own:
            raise
        kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
        known = ", ".join(standalone.NUMBERS)
        raise UserError(
            f"{kind}{error}. In one file a scenario has n_robots = 1, observation_layout, "
            f"action_bounds, model, {known}"
        ) from error


def _check_close(apart: float, most: float, unit: str) -> None:
    if not apart <= most:
        raise UserError(
            f"the file differs from the policy by {apart:.1e} {unit}, more than {most:g}; nothing "
            "was written"
        )


def _network_of(name: str, scenario: Scenario) -> standalone.Network | None:
    """Weights and settings of a learned policy; None for a scripted one."""
    path = policies.learned_path(name, scenario)
    if path is None:
        return None
    if path.suffix.lower() == SUFFIX:
        raise UserError(f"--policy {name}: is exported already")
    about, tables = checkpoints.read(checkpoints.find(path), ["network"])
    return tables["network"], PolicySettings.from_plain(about["policy"])


def _compare(path: Path, network: standalone.Network, checks: int) -> float:
    """Largest difference between file and policy, relative to the largest logit."""
    weights, settings = network
    random, written, worst = np.random.default_rng(0), OnnxNetwork(path), 0.0
    for first in range(0, checks, _AT_ONCE):
        robots = min(_AT_ONCE, checks - first)
        layout = settings.layout(*_SLOTS[first // _AT_ONCE % len(_SLOTS)])
        ours = NumpyActor(weights, settings, layout)
        written.layout = layout
        shown = drawn_tables(layout, robots, random)
        hidden = [np.zeros((robots, settings.units), dtype=np.float32) for _ in range(2)]
        for _ in range(2):  # a second time with the resulting hidden state
            wanted = ours.preferences(shown, hidden[0])
            found = written.preferences(shown, hidden[1])
            largest = float(np.abs(wanted).max()) or 1.0
            worst = np.maximum(worst, np.abs(found - wanted).max() / largest)  # keeps NaN
    return float(worst)


def drawn_tables(
    layout: FeatureLayout, robots: int, random: np.random.Generator
) -> NDArray[np.float32]:
    """Random network inputs (N, layout.size) with randomly absent rows."""
    shown = random.normal(size=(robots, layout.size)).astype(np.float32)
    seen, likely = layout.split(shown), random.random((robots, 1))
    for rows in (seen.neighbours, seen.obstacles):
        rows[random.random(rows.shape[:2]) > likely] = 0.0
    return shown


_OPSET, _IR_VERSION = 18, 8
"""Opset and IR version, old enough for old runtimes on robots."""
_INPUTS = {
    "neighbours": "Unit bearing x, y; gain, m/s; zero rows are absent",
    "obstacles": "Counter-clockwise edge x, y; clockwise edge x, y; rotation rate of each, rad/s; "
    "zero rows are absent",
    "context": "Context features; CONTEXT_COLUMNS of baselines.learned.features",
    "hidden": "Recurrent state; zeros initially",
}
"""Descriptions of the inputs, in the frame with x along f."""


def model_of(weights: Mapping[str, NDArray[Any]], settings: PolicySettings) -> Any:
    """Actor as ``onnx.ModelProto``, for any number of robots, neighbours and obstacles.

        (mean φ(g), max φ(g), mean ψ(s), max ψ(s), context) → preferences

    Inputs: neighbours (N, K, 3), obstacles (N, M, 6), context (N, columns) and, with a recurrent
    unit, hidden (N, units), all float32; N, K and M are free. Outputs: preferences (N, choices) and
    hidden_next. The metadata contain the settings, a digest of the whole file, and the choices:
    their angles, rad, or their speeds and turn rates in units of the limits.

    Raises:
        ValueError: naming an array that is missing, of another shape or not finite.
    """
    from onnx import TensorProto, checker, helper

    graph, layout, units = _Graph(), settings.layout(0, 0), settings.units
    actor = NumpyActor(weights, settings, layout)
    pooled = [
        part
        for rows, layers in zip(("neighbours", "obstacles"), actor.sets, strict=True)
        for part in _pooled(graph, rows, layers)
    ]
    seen = graph.add("Concat", *pooled, "context", axis=1)
    if actor.memory is not None:
        seen = graph.add("Concat", _remembered(graph, actor.memory, seen), seen, axis=1)
    for layer in actor.layers:
        seen = graph.add("Relu", graph.linear(seen, layer))
    graph.add("Identity", graph.linear(seen, actor.last), name="preferences")
    given: dict[str, list[int | str]] = {
        "neighbours": ["robots", "neighbour_slots", NEIGHBOUR_COLUMNS],
        "obstacles": ["robots", "obstacle_slots", OBSTACLE_COLUMNS],
        "context": ["robots", layout.context_columns],
    }
    found: dict[str, list[int | str]] = {"preferences": ["robots", settings.choices]}
    if units:
        given["hidden"] = found["hidden_next"] = ["robots", units]
    inputs, outputs = (
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape, _INPUTS.get(name, ""))
            for name, shape in shapes.items()
        ]
        for shapes in (given, found)
    )
    made = helper.make_model(
        helper.make_graph(graph.nodes, "rendezvous_policy", inputs, outputs, graph.constants),
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="rendezvous-env",
        doc_string="Choice of a heading. Base controller and filter: see baselines.RobotPolicy.",
    )
    checker.check_model(made, full_check=True)
    about = {
        SETTINGS_KEY: json.dumps(settings.to_plain()),
        "angles": json.dumps(settings.angles.tolist()),
        "commands": json.dumps(settings.commands),
        DIGEST_KEY: json.dumps(NO_DIGEST),
    }
    helper.set_model_props(made, about)
    about[DIGEST_KEY] = json.dumps(digest_of(made.SerializeToString()))
    helper.set_model_props(made, about)
    return made


class _Graph:
    """Builder of ONNX nodes and constants."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, *inputs: Any, name: str = "", **options: Any) -> str:
        """Add a node over names and constant arrays; returns the name of its output."""
        from onnx import helper, numpy_helper

        named = []
        for value in inputs:
            if not isinstance(value, str):
                constant = f"constant_{len(self.constants)}"
                self.constants.append(
                    numpy_helper.from_array(np.ascontiguousarray(value), constant)
                )
                value = constant
            named.append(value)
        name = name or f"{operator}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, named, [name], name=name, **options))
        return name

    def linear(self, values: str, layer: Layer) -> str:
        """W x + b over the last axis."""
        weight, bias = layer
        return self.add("Add", self.add("MatMul", values, weight.T), bias)


def _pooled(graph: _Graph, rows: str, layers: list[Layer]) -> tuple[str, str]:
    """Mean and maximum feature over the present rows.

    Features are non-negative (ReLU), so those of absent rows are set to zero. An absent row is
    appended so that the maximum over zero slots is defined.
    """
    along, last = np.array([1]), np.array([2])
    features = padded = graph.add("Pad", rows, np.array([0, 0, 0, 0, 1, 0]))
    size = graph.add("ReduceMax", graph.add("Abs", padded), last, keepdims=1)
    is_present = graph.add("Greater", size, np.zeros(1, np.float32))
    present = graph.add("Cast", is_present, to=1)  # to float32
    for layer in layers:
        features = graph.add("Relu", graph.linear(features, layer))
    kept = graph.add("Mul", features, present)
    counted = graph.add("ReduceSum", present, along, keepdims=0)
    count = graph.add("Max", counted, np.ones(1, np.float32))
    mean = graph.add("Div", graph.add("ReduceSum", kept, along, keepdims=0), count)
    return mean, graph.add("ReduceMax", kept, along, keepdims=0)


def _remembered(graph: _Graph, unit: RecurrentUnit, features: str) -> str:
    """Equations of ``RecurrentUnit``, from "hidden" to "hidden_next"."""
    gates = [
        [graph.linear(values, part) for part in zip(*(np.split(a, 3) for a in layer), strict=True)]
        for values, layer in ((features, unit.seen), ("hidden", unit.kept))
    ]
    (r_x, z_x, m_x), (r_h, z_h, m_h) = gates
    r, z = (graph.add("Sigmoid", graph.add("Add", *both)) for both in ((r_x, r_h), (z_x, z_h)))
    m = graph.add("Tanh", graph.add("Add", m_x, graph.add("Mul", r, m_h)))
    stays = graph.add("Mul", z, graph.add("Sub", "hidden", m))
    return graph.add("Add", m, stays, name="hidden_next")
