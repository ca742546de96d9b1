"""``rendezvous export``: a policy for robots, as one Python file or its network as an ONNX file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.learned import checkpoints
from rendezvous_env.baselines.learned.features import (
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    FeatureLayout,
)
from rendezvous_env.baselines.learned.numpy_actor import (
    Layer,
    NumpyActor,
    linear_layer,
    linear_layers,
)
from rendezvous_env.baselines.learned.onnx_network import (
    DIGEST_KEY,
    NO_DIGEST,
    SETTINGS_KEY,
    SUFFIX,
    OnnxNetwork,
    digest_of,
)
from rendezvous_env.baselines.learned.policy_settings import PolicySettings
from rendezvous_env.baselines.robot_policy import RobotPolicy
from rich.console import Console

from . import policies, standalone
from .checks import UserError, check_installed
from .results import atomic, prepare_folder

_MOST_CHECKS = 10**7
_SLOTS = ((3, 12), (1, 0), (31, 24), (7, 1))
"""Neighbours and obstacles of the tables on which a file is checked."""
_AT_ONCE = 512
_CLOSE = 1e-4
"""Share of the largest preference by which the file may differ: sums are in another order."""

EXAMPLES = (
    "--policy learned --out out/policy.onnx",
    "--policy learned-tank --standalone robot.py --scenario clutter-8",
)


@dataclass(frozen=True)
class Config:
    """Write the network of a learned policy as an ONNX file, or a policy as one Python file that
    needs NumPy alone, and check it against the policy.
    """

    policy: str = "learned"
    """The name of a shipped policy, or learned:PATH of a run or a checkpoint; with --standalone
    also of a law or a rule."""
    out: Path = Path("out/policy.onnx")
    """The ONNX file to write."""
    standalone: Path | None = None
    """The Python file to write, instead of an ONNX file."""
    scenario: str = "clutter-8"
    """Whose robot it is for: the name of a scenario or a TOML file. An ONNX file is for all robots
    of that model."""
    checks: int = 10_000
    """On how many random inputs the file is compared with the policy before it takes its place."""


def run(config: Config) -> int:
    """Read, write, compare.

    Raises:
        UserError: also for a file that does not do what the policy does.
    """
    if config.standalone is not None:
        return _run_standalone(config, config.standalone)
    weights, settings = _check(config)
    prepare_folder(config.out.parent, f"--out {config.out}")
    with atomic(config.out) as temporary:
        temporary.write_bytes(model_of(weights, settings).SerializeToString())
        apart = _compare(temporary, weights, settings, config.checks)
        size = temporary.stat().st_size
    Console().print(
        f"{config.out}: {config.policy}, {size / 1e3:.0f} kB; on {config.checks} drawn inputs it "
        f"differs by {apart:.1e} of the largest preference at most"
    )
    return 0


def _run_standalone(config: Config, path: Path) -> int:
    """The same for one Python file."""
    _check_target("--standalone", path, ".py")
    if path.exists() and not standalone.is_written(path):
        raise UserError(f"--standalone {path}: is there already, and not of this command's making")
    _check_count(config.checks)
    if policies.is_user_policy(config.policy):
        raise UserError(
            f"--policy {config.policy}: is a function of your own; it must be a law, a rule or a "
            "learned policy of this project"
        )
    policies.check_names([config.policy])
    scenario = policies.resolve_scenario(config.scenario)
    folder, network = policies.learned_path(config.policy, scenario), None
    if folder is not None:
        network = _network_in(folder, config.policy)
    prepare_folder(path.parent, f"--standalone {path}")
    with atomic(path) as temporary:
        try:
            text = standalone.text_of(config.policy, scenario, network)
        except ValueError as error:
            raise UserError(f"--policy {config.policy}: {error}") from error
        temporary.write_text(text, encoding="utf-8")
        robot = RobotPolicy(scenario, policies.make(config.policy, scenario))
        apart = standalone.compare(temporary, robot, config.checks)
        if not apart <= standalone.CLOSE:
            raise UserError(
                f"the file differs from the policy by {apart:.1e} m/s, more than "
                f"{standalone.CLOSE:g}; nothing was written"
            )
    Console().print(
        f"{path}: {config.policy} for {scenario.name}, {len(text) / 1e3:.0f} kB, needs NumPy; on "
        f"{config.checks} drawn ticks it differs by {apart:.1e} m/s at most"
    )
    return 0


def _check_target(flag: str, path: Path, ending: str) -> None:
    if path.suffix != ending:
        raise UserError(f"{flag} {path}: unknown ending; it must be {ending}")
    if path.is_dir():
        raise UserError(f"{flag} {path}: is a folder; it must be a file")


def _check_count(checks: int) -> None:
    if not 1 <= checks <= _MOST_CHECKS:
        raise UserError(f"--checks is {checks}; it must be from 1 to {_MOST_CHECKS}")


def _network_in(path: Path, name: str) -> tuple[dict[str, NDArray[np.float32]], PolicySettings]:
    """Weights and settings of a policy that is not exported yet."""
    if path.suffix == SUFFIX:
        raise UserError(f"--policy {name}: is exported already")
    about, tables = checkpoints.read(checkpoints.find(path), ["network"])
    return tables["network"], PolicySettings.from_plain(about["policy"])


def _check(config: Config) -> tuple[dict[str, NDArray[np.float32]], PolicySettings]:
    """Weights and settings, once everything is known to be right."""
    _check_target("--out", config.out, SUFFIX)
    _check_count(config.checks)
    check_installed("export", "export", "onnx", "onnxruntime")
    policies.check_names([config.policy])
    path = policies.learned_path(config.policy, policies.resolve_scenario(config.scenario))
    if path is None:
        raise UserError(
            f"--policy {config.policy}: is scripted and has no network; --standalone robot.py "
            "writes it as it is"
        )
    return _network_in(path, config.policy)


def _compare(
    path: Path, weights: dict[str, NDArray[np.float32]], settings: PolicySettings, checks: int
) -> float:
    """The largest difference between file and policy, as a share of the largest preference; one
    that is more than rounding is refused.
    """
    random, written, worst = np.random.default_rng(0), OnnxNetwork(path), 0.0
    for first in range(0, checks, _AT_ONCE):
        robots = min(_AT_ONCE, checks - first)
        layout = settings.layout(*_SLOTS[first // _AT_ONCE % len(_SLOTS)])
        ours = NumpyActor(weights, settings, layout)
        written.fit(layout)
        shown = drawn_tables(layout, robots, random)
        hidden = [np.zeros((robots, settings.units), dtype=np.float32) for _ in range(2)]
        for _ in range(2):  # once more, with what is remembered then
            wanted = ours.preferences(shown, hidden[0])
            found = written.preferences(shown, hidden[1])
            worst = max(worst, float(np.abs(found - wanted).max() / np.abs(wanted).max()))
    if not worst <= _CLOSE:
        raise UserError(
            f"the file differs from the policy by {worst:.1e} of the largest preference, more than "
            f"{_CLOSE:g}; nothing was written"
        )
    return worst


def drawn_tables(
    layout: FeatureLayout, robots: int, random: np.random.Generator
) -> NDArray[np.float32]:
    """Tables as robots could be shown, (N, layout.size), each row of a set absent at random."""
    shown = random.normal(size=(robots, layout.size)).astype(np.float32)
    seen, likely = layout.split(shown), random.random((robots, 1))
    for rows in (seen.neighbours, seen.obstacles):
        rows[random.random(rows.shape[:2]) > likely] = 0.0
    return shown


_OPSET = 18
_IR_VERSION = 8
"""Old ones, so that old runtimes on robots read them, too."""
_INPUTS = {
    "neighbours": "Unit bearing x, y; gain, m/s; zero rows are absent",
    "obstacles": "Counter-clockwise edge x, y; clockwise edge x, y; how fast each turns, rad/s; "
    "zero rows are absent",
    "context": "What belongs to no set; CONTEXT_COLUMNS of baselines.learned.features",
    "hidden": "What is remembered; zeros at first",
}
"""What each input is, in the frame with x along f."""


def model_of(weights: Mapping[str, NDArray[Any]], settings: PolicySettings) -> Any:
    """The actor as ``onnx.ModelProto``: any number of robots, neighbours and obstacles.

        (mean φ(g), max φ(g), mean ψ(s), max ψ(s), context) → preferences

    Inputs: neighbours (N, K, 3), obstacles (N, M, 6), context (N, columns) and, with a recurrent
    unit, hidden (N, units), all float32; N, K and M are free. Outputs: preferences (N, choices)
    and hidden_next. Its metadata holds the settings, the angles of the choices, rad,
    and a digest of all of it.

    Args:
        weights: of the network's state, by name.
        settings: that it was trained with.

    Raises:
        ValueError: naming an array that is missing, of another shape or not finite.
    """
    from onnx import checker, helper

    graph, units = _Graph(), settings.units
    context = settings.layout(0, 0).context_columns
    _connect(graph, weights, settings, context)
    shapes: dict[str, list[int | str]] = {
        "neighbours": ["robots", "neighbour_slots", NEIGHBOUR_COLUMNS],
        "obstacles": ["robots", "obstacle_slots", OBSTACLE_COLUMNS],
        "context": ["robots", context],
    }
    results: dict[str, list[int | str]] = {"preferences": ["robots", len(settings.angles)]}
    if units:
        shapes["hidden"] = results["hidden_next"] = ["robots", units]
    made = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "rendezvous_policy",
            [graph.value(*entry) for entry in shapes.items()],
            [graph.value(*entry) for entry in results.items()],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
        producer_name="rendezvous-env",
        doc_string="Which heading to take. Guide and guarantee follow: see baselines.RobotPolicy.",
    )
    checker.check_model(made, full_check=True)
    return _signed(made, settings)


def _connect(
    graph: _Graph, weights: Mapping[str, NDArray[Any]], settings: PolicySettings, context: int
) -> None:
    """All layers, from the inputs to "preferences" and "hidden_next"."""
    width, units, choices = settings.set_width, settings.units, len(settings.angles)
    features = 4 * width + context
    pooled: list[str] = []
    for rows, net, columns in (
        ("neighbours", "neighbour_net", NEIGHBOUR_COLUMNS),
        ("obstacles", "obstacle_net", OBSTACLE_COLUMNS),
    ):
        layers = linear_layers(weights, f"features_extractor.{net}", (columns, width, width))
        pooled += _pooled(graph, rows, layers)
    seen = graph.add("Concat", [*pooled, "context"], axis=1)
    if units:
        hidden = _remembered(graph, weights, seen, features, units)
        seen = graph.add("Concat", [hidden, seen], axis=1)
    sizes = (units + features, *settings.hidden)
    for layer in linear_layers(weights, "mlp_extractor.policy_net", sizes):
        seen = graph.add("Relu", [graph.linear(seen, layer)])
    last = linear_layer(weights, "action_net.weight", "action_net.bias", sizes[-1], choices)
    graph.add("Identity", [graph.linear(seen, last)], name="preferences")


def _signed(made: Any, settings: PolicySettings) -> Any:
    """The model with its metadata: settings, angles, and the digest of everything."""
    from onnx import helper

    about = {
        SETTINGS_KEY: json.dumps(settings.to_plain()),
        "angles": json.dumps(settings.angles.tolist()),
        DIGEST_KEY: json.dumps(NO_DIGEST),
    }
    helper.set_model_props(made, about)
    about[DIGEST_KEY] = json.dumps(digest_of(made.SerializeToString()))
    helper.set_model_props(made, about)
    return made


class _Graph:
    """Nodes and constants of a graph, and names for what they give."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, inputs: Sequence[str], name: str = "", **options: Any) -> str:
        """A node with one output; the output's name."""
        from onnx import helper

        name = name or f"{operator}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name=name, **options))
        return name

    def constant(self, value: Any, dtype: type[np.generic] = np.float32) -> str:
        """A constant; its name."""
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        array = np.ascontiguousarray(value, dtype=dtype)
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def linear(self, values: str, layer: Layer) -> str:
        """W x + b over the last axis."""
        weight, bias = layer
        product = self.add("MatMul", [values, self.constant(weight.T)])
        return self.add("Add", [product, self.constant(bias)])

    def value(self, name: str, shape: Sequence[int | str]) -> Any:
        """What goes in or comes out."""
        from onnx import TensorProto, helper

        about = _INPUTS.get(name, "")
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape, about)


def _pooled(graph: _Graph, rows: str, layers: list[Layer]) -> tuple[str, str]:
    """Mean and largest feature over the rows that are present.

    An absent row's features become zeros, which no feature is below, as all end in a ReLU. One row
    more is appended, absent: a set without any slot has no largest element.
    """
    along, last = (graph.constant([axis], np.int64) for axis in (1, 2))
    padded = graph.add("Pad", [rows, graph.constant([0, 0, 0, 0, 1, 0], np.int64)])
    size = graph.add("ReduceMax", [graph.add("Abs", [padded]), last], keepdims=1)
    is_present = graph.add("Greater", [size, graph.constant(0.0)])
    present = graph.add("Cast", [is_present], to=1)  # to float32
    features = padded
    for layer in layers:
        features = graph.add("Relu", [graph.linear(features, layer)])
    kept = graph.add("Mul", [features, present])
    counted = graph.add("ReduceSum", [present, along], keepdims=0)
    count = graph.add("Max", [counted, graph.constant(1.0)])
    total = graph.add("ReduceSum", [kept, along], keepdims=0)
    mean = graph.add("Div", [total, count])
    return mean, graph.add("ReduceMax", [kept, along], keepdims=0)


def _remembered(
    graph: _Graph, weights: Mapping[str, NDArray[Any]], features: str, inputs: int, units: int
) -> str:
    """The equations of ``RecurrentUnit``, from "hidden" to "hidden_next"."""
    seen = linear_layer(weights, "memory.weight_ih", "memory.bias_ih", inputs, 3 * units)
    kept = linear_layer(weights, "memory.weight_hh", "memory.bias_hh", units, 3 * units)

    def part(values: str, layer: Layer, gate: int) -> str:
        rows = slice(gate * units, (gate + 1) * units)
        return graph.linear(values, (layer[0][rows], layer[1][rows]))

    def both(gate: int) -> str:
        parts = [part(features, seen, gate), part("hidden", kept, gate)]
        return graph.add("Sigmoid", [graph.add("Add", parts)])

    r, z = both(0), both(1)
    faded = graph.add("Mul", [r, part("hidden", kept, 2)])
    m = graph.add("Tanh", [graph.add("Add", [part(features, seen, 2), faded])])
    stays = graph.add("Mul", [z, graph.add("Sub", ["hidden", m])])
    return graph.add("Add", [m, stays], name="hidden_next")
