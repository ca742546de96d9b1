"""Pages generated from the code when the site is built."""

from __future__ import annotations

import base64
import inspect
import json
import re
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from attributes import fields_table, flags_table, meanings_table

import baselines
import rendezvous_env as rv
from train import recording, results
from train.cli import COMMANDS, documents
from train.compare.evaluation import Episodes

ROOT = Path(__file__).parents[2]
DATA = (
    (rv.Scenario, "Keys of a TOML file have the same names; a key that is absent has its default."),
    (rv.RewardWeights, "The table `[reward]` of a TOML file."),
    (rv.Sensing, "The table `[sensing]` of a TOML file."),
    (rv.Disc, "One of `[[obstacles]]`, in the plane."),
    (rv.Sphere, "One of `[[obstacles]]`, in 3-D."),
    (rv.Capsule, "One of `[[obstacles]]`, in the plane or in 3-D."),
    (rv.Polygon, "One of `[[obstacles]]`, in the plane."),
    (rv.Moving, "One of `[[obstacles]]`, in the plane or in 3-D; `shape` is one of the above."),
    (rv.ObstacleField, "The table `[obstacles]`: sampled for every episode."),
    (rv.WallField, "The table `[obstacles]`: sampled for every episode."),
)
"""Dataclasses that describe an experiment, and their place in a file."""
SHOWN_AS_FILES = ("fig4", "random-10", "trap")
REFERENCE = {
    "environments": ("Environments and wrappers", ("rendezvous_env/envs",)),
    "scenarios": (
        "Scenarios, graphs, obstacles, sensors",
        tuple(
            f"rendezvous_env/{room}"
            for room in (
                *("scenario", "graphs", "obstacles", "traffic", "sensors", "calibration"),
                *("rewards", "robots"),
            )
        ),
    ),
    "simulator": ("Simulator and trajectories", ("rendezvous_env",)),
    "guarantees": ("Guarantees", ("rendezvous_env/safety",)),
    "policies": (
        "Policies",
        ("baselines", "baselines/laws", "baselines/obstacle_rules", "baselines/references"),
    ),
    "learned": ("Learned policies", ("baselines/learned", "baselines/search")),
    "adapters": ("Adapters to learning libraries", ("rendezvous_env/adapters",)),
    "equations": ("Equations", ("rendezvous_env/physics",)),
    "jax": ("JAX form", ("rendezvous_env/jax", "baselines/jax")),
}
"""Pages of the reference: a title, and the folders of the modules on it."""
RENAMED = {
    "README.md": "overview.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "decisions": "decisions/README.md",
    "docs": "overview.md",
    "examples": "examples.md",
    "tutorial.ipynb": "tutorial.md",
}
"""Names in the site of files and folders that pages of docs/ link to."""
FIRST = (
    "parallel_env", "make_vec", "training_env", "rollout", "Scenario", "scenarios", "certificate",
    "make", "TrainedPolicy",
)  # fmt: skip
"""Names shown first; the others follow alphabetically."""


def data() -> str:
    """Reference of fields, columns and arrays."""
    parts = [
        "# File formats\n",
        "Generated from the code. `rendezvous_env/limits.py` holds the numeric limits of fields.\n",
    ]
    for kind, note in DATA:
        parts += [f"## `{kind.__name__}`\n", f"{note}\n", fields_table(kind)]
    parts.append("## Scenarios as files\n")
    for name in SHOWN_AS_FILES:
        parts += [f"`rv.scenarios.get({name!r}).to_toml(…)` writes\n", _toml(name)]
    episodes = {
        "scenario": "its name",
        "policy": "its name",
        "initial_condition": "k; its seed is SEED + k",
    }
    episodes |= documents(Episodes)
    parts += [
        "## `results.csv`\n",
        "One row per scenario and policy. Cells that do not apply are empty.\n",
        meanings_table("column", results.RESULTS),
        "## `episodes.csv`\n",
        "One row per scenario, policy and initial condition.\n",
        meanings_table("column", episodes),
        "## `paired.csv`\n",
        "One row per scenario and policy, except the reference policy.\n",
        meanings_table("column", results.PAIRED),
        "## `trajectories.npz`\n",
        "The first `--keep-trajectories` episodes of each policy. Keys are "
        "`scenario/policy/start/name`. T is the number of frames, at most about "
        f"{recording.MAX_FRAMES}.\n",
        meanings_table("array", recording.ARRAYS),
    ]
    return "\n".join(parts)


def _toml(name: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        rv.scenarios.get(name).to_toml(path)
        return f"```toml\n{path.read_text(encoding='utf-8')}```\n"


def commands() -> str:
    """Reference of all commands and flags."""
    parts = [
        "# Command line\n",
        "Generated from the code. `rendezvous COMMAND --help` prints the same. "
        '`eval "$(rendezvous --completion bash)"` completes commands and flags '
        "(also for `zsh` and `tcsh`).\n",
    ]
    for name, (module, line) in COMMANDS.items():
        config = import_module(f"train.{module}").Config
        parts += [f"## `rendezvous {name}`\n", f"{line[0].upper()}{line[1:]}.\n"]
        parts.append(flags_table(config))
    return "\n".join(parts)


def examples() -> str:
    """Page with the programs of examples/."""
    parts = ["# Examples\n", "Complete programs from the folder `examples/`.\n"]
    for path in sorted((ROOT / "examples").glob("*.py")):
        parts.append(f"## `{path.name}`\n\n```python\n{path.read_text(encoding='utf-8')}```\n")
    return "\n".join(parts)


def public() -> str:
    """Front page of the reference: one line per public name."""
    parts = ["# Reference\n"]
    for package, alias in ((rv, "rv"), (baselines, "baselines")):
        parts.append(f"## `{package.__name__}`\n\n{inspect.getdoc(package)}\n")
        for name in sorted(package.__all__, key=_place):
            found = getattr(package, name)
            first = (inspect.getdoc(found) or "").split("\n\n")[0]
            if isinstance(found, int):
                first = "A kind of contact; see `rendezvous_env.robots.motion`."
            parts.append(f"* {_link(f'{alias}.{name}', found)}: {' '.join(first.split())}")
        parts.append("")
    return "\n".join(parts).replace("``", "`")


def _place(name: str) -> tuple[int, str]:
    """Sort key of a name on the front page of the reference."""
    return (FIRST.index(name) if name in FIRST else len(FIRST)), name.lower()


def _link(shown: str, found: Any) -> str:
    """A name, linked to its documentation."""
    name = getattr(found, "__module__", None) or getattr(found, "__name__", "")
    target = f"{name}.{getattr(found, '__qualname__', '')}".rstrip(".")
    folder = target.replace(".", "/")
    documented = any(
        folder.startswith(f"{place}/") for _, places in REFERENCE.values() for place in places
    )
    documented &= not hasattr(found, "__path__")  # of a folder its files are
    return f"[`{shown}`][{target}]" if documented else f"`{shown}`"


def reference() -> Iterator[tuple[str, str]]:
    """Name and Markdown of one page per package."""
    for page, (title, folders) in REFERENCE.items():
        modules = []
        for folder in folders:
            deep = "*.py" if folder in ("rendezvous_env", "baselines") else "**/*.py"
            modules += [
                ".".join(path.relative_to(ROOT).with_suffix("").parts)
                for path in sorted((ROOT / folder).glob(deep))
                if not path.name.startswith("_") and "checks" not in path.name
            ]
        yield page, f"# {title}\n\n" + "\n".join(f"::: {module}\n" for module in modules)


def notebook(path: Path) -> tuple[str, dict[str, bytes]]:
    """A notebook with outputs as Markdown, and its pictures by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        said: list[str] = []
        for output in cell["outputs"]:
            shown = output.get("data", {})
            if "image/png" in shown:
                name = f"{path.stem}-{len(pictures)}.png"
                pictures[name] = base64.b64decode(shown["image/png"])
                parts.append(f"![Figure of the program]({name})")
            else:
                said.append(_plain("".join(output.get("text", shown.get("text/plain", "")))))
        if text := "\n".join(filter(None, said)):
            parts.append(f"```text\n{text}\n```")
    return "\n\n".join(parts), pictures


def _plain(text: str) -> str:
    """Output without terminal colours."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text).strip("\n")


def without_links_to_code(text: str) -> str:
    """Markdown of a subfolder of docs/, with code instead of links that leave the site."""
    return re.sub(r"\[([^\]]+)\]\(\.\./\.\./[^)]*\)", r"`\1`", text)


def for_site(text: str) -> str:
    """Markdown of the repository root or docs/, with links adapted to the site."""

    def moved(match: re.Match[str]) -> str:
        target = match[1].removeprefix("../").removeprefix("docs/").rstrip("/")
        return f"]({RENAMED.get(target, target)}{match[2]})"

    return re.sub(r"\]\((?!https?:|#|mailto:)([^)#\s]+)([^)]*)\)", moved, text)
