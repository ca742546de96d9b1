"""The table of frameworks: each script of this folder, run in an environment of its own.

    python tests/adapters/frameworks/run_table.py [--only JAX Tianshou] [--venvs FOLDER]

Prints a row of docs/learners.md for each; a frame is a decision of one robot. What does not install
or run stands in its row with the last line of what it says.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[2]


class Framework(NamedTuple):
    """A script and what it needs."""

    script: str
    algorithm: str
    needs: tuple[str, ...] = ()
    """Pins; they hold against those of constraints.txt."""
    frees: tuple[str, ...] = ()
    """Packages of constraints.txt that the framework needs in another version."""

    @property
    def lines(self) -> int:
        """Lines of code, without blank ones, comments and the docstring."""
        text = re.sub(r'\A""".*?"""', "", (HERE / self.script).read_text(), flags=re.DOTALL)
        return sum(1 for line in text.splitlines() if re.match(r"\s*[^\s#]", line))


FRAMEWORKS = {
    "Gymnasium and NumPy": Framework("numpy_es.py", "evolution strategy"),
    "stable-baselines3": Framework(
        "sb3_ppo.py", "PPO", ("stable-baselines3==2.9.0", "torch==2.13.0")
    ),
    "JAX": Framework("jax_pg.py", "policy gradient", ("jax==0.10.2", "optax==0.2.8")),
    "Tianshou": Framework(
        "tianshou_ppo.py", "PPO", ("tianshou==2.0.1", "torch==2.13.0"), ("pandas", "filelock")
    ),
    # without peft, which only its language models need, AgileRL cannot be imported
    "AgileRL": Framework(
        "agilerl_ippo.py",
        "IPPO",
        ("agilerl==2.58.0", "peft==0.21.0", "torch==2.13.0"),
        ("pandas", "filelock", "pettingzoo"),
    ),
    "skrl": Framework("skrl_ppo.py", "PPO", ("skrl==2.1.1", "torch==2.13.0")),
}


def run(*command: str | Path) -> str:
    """What a command prints.

    Raises:
        RuntimeError: with the last line of what it says, if it fails.
    """
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, cwd=HERE, check=False
    )
    if done.returncode:
        raise RuntimeError((done.stderr.strip() or done.stdout.strip()).splitlines()[-1])
    return done.stdout


def figures(said: str) -> dict[str, Any]:
    """What a script reports, among what its framework says."""
    found: dict[str, Any] = json.loads(re.findall(r"^{.*}$", said, flags=re.MULTILINE)[-1])
    return found


def install(framework: Framework, folder: Path) -> float:
    """Make the environment anew; s."""
    began = time.perf_counter()
    run(sys.executable, "-m", "venv", "--clear", folder)
    own = {re.split(r"[\[=<>]", pin)[0] for pin in framework.needs} | set(framework.frees)
    pins = [
        line
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if line.split("==")[0] not in own
    ]
    (folder / "constraints.txt").write_text("\n".join(pins) + "\n")
    pip = (folder / "bin" / "pip", "install", "--quiet", "--constraint", folder / "constraints.txt")
    for pin in sorted(framework.needs, reverse=True):  # torch first, so that its build is kept
        run(*pip, pin)
    run(*pip, "--editable", ROOT, *framework.needs)
    return time.perf_counter() - began


def row(name: str, framework: Framework, folder: Path) -> str:
    """A row of the table."""
    learning = f"{framework.algorithm}, `{framework.script}`, {framework.lines} lines"
    try:
        installed = install(framework, folder)
        said = run(folder / "bin" / "python", HERE / framework.script)
    except RuntimeError as error:
        return f"| {name} | {error} | | {learning} | |"
    found = figures(said)
    trained = f"{found['training_seconds']:.0f} s: {found['training_frames'] / 1e3:.0f} k frames"
    cells = (
        name,
        f"{installed:.0f} s",
        f"{found['frames_per_second']:,.0f} frames/s",
        f"{learning}, {trained}",
        f"{100 * found['before']:.0f} → {found['after']:.0%} clean",
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=FRAMEWORKS, default=list(FRAMEWORKS))
    parser.add_argument("--venvs", type=Path, default=ROOT / ".venv-adapters" / "frameworks")
    given = parser.parse_args()
    print("| framework | install | random rollout | short training | held-out evaluation |")
    print("|---|---|---|---|---|")
    for chosen in given.only:
        kept = given.venvs.resolve() / re.sub(r"\W+", "-", chosen.lower())
        print(row(chosen, FRAMEWORKS[chosen], kept), flush=True)
