"""``rendezvous export``: a learned policy's network as an ONNX file, for robots."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from baselines.learned import checkpoints
from baselines.learned.chooser import Chooser
from baselines.learned.onnx_network import SUFFIX, OnnxNetwork
from baselines.learned.perception_layout import PerceptionLayout
from baselines.learned.policy_settings import PolicySettings

from . import onnx_graph, policies
from .errors import UserError
from .results import atomic, prepare_folder

_MOST_CHECKS = 10**7
_SLOTS = ((3, 12), (1, 0), (31, 24), (7, 1))
"""Neighbours and obstacles of the tables on which a file is checked."""
_AT_ONCE = 512
_CLOSE = 1e-4
"""Share of the largest preference by which the file may differ: sums are in another order."""


@dataclass(frozen=True)
class Config:
    """Write the network of a learned policy as an ONNX file, and check it against the policy."""

    policy: str = "learned"
    """Name of a shipped policy, or learned:PATH of a run or a checkpoint."""
    out: Path = Path("out/policy.onnx")
    """File to write."""
    checks: int = 10_000
    """Drawn inputs on which the file is compared with the policy before it takes its place."""


def run(config: Config) -> int:
    """Read, write, compare.

    Raises:
        UserError: for an unknown or scripted policy, a file that cannot be written, a missing
            extra, or a file that does not do what the policy does.
    """
    weights, settings = _check(config)
    prepare_folder(config.out.parent)
    with atomic(config.out) as temporary:
        temporary.write_bytes(onnx_graph.model_of(weights, settings).SerializeToString())
        apart = _compare(temporary, weights, settings, config.checks)
        size = temporary.stat().st_size
    Console().print(
        f"{config.out}: {config.policy}, {size / 1e3:.0f} kB; on {config.checks} drawn inputs it "
        f"differs by {apart:.1e} of the largest preference at most"
    )
    return 0


def _check(config: Config) -> tuple[dict[str, NDArray[np.float32]], PolicySettings]:
    """Weights and settings, once everything is known to be right."""
    if config.out.suffix != SUFFIX:
        raise UserError(f"--out {config.out}: unknown ending; it must be {SUFFIX}")
    if not 1 <= config.checks <= _MOST_CHECKS:
        raise UserError(f"--checks is {config.checks}; it must be from 1 to {_MOST_CHECKS}")
    for package in ("onnx", "onnxruntime"):
        if importlib.util.find_spec(package) is None:
            raise UserError(f"export needs {package}; pip install 'rendezvous-env[export]'")
    policies.check_names([config.policy])
    path = policies.learned_path(config.policy)
    if path is None:
        raise UserError(
            f"--policy {config.policy}: is scripted and has no network; baselines.RobotPolicy runs "
            "it as it is"
        )
    if path.suffix == SUFFIX:
        raise UserError(f"--policy {config.policy}: is exported already")
    about, tables = checkpoints.read(checkpoints.find(path), ["network"])
    return tables["network"], PolicySettings.from_plain(about["policy"])


def _compare(
    path: Path, weights: dict[str, NDArray[np.float32]], settings: PolicySettings, checks: int
) -> float:
    """The largest difference between file and policy, as a share of the largest preference.

    Raises:
        UserError: if it is more than rounding.
    """
    random, written, worst = np.random.default_rng(0), OnnxNetwork(path), 0.0
    for first in range(0, checks, _AT_ONCE):
        robots = min(_AT_ONCE, checks - first)
        layout = settings.layout(*_SLOTS[first // _AT_ONCE % len(_SLOTS)])
        ours = Chooser(weights, settings, layout)
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
    layout: PerceptionLayout, robots: int, random: np.random.Generator
) -> NDArray[np.float32]:
    """Tables as robots could be shown, (N, layout.size), each row of a set absent at random."""
    shown = random.normal(size=(robots, layout.size)).astype(np.float32)
    seen, likely = layout.split(shown), random.random((robots, 1))
    for rows in (seen.neighbours, seen.obstacles):
        rows[random.random(rows.shape[:2]) > likely] = 0.0
    return shown
