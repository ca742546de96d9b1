"""Table of frameworks: runs each script of this folder in a separate environment.

    python tests/adapters/frameworks/run_table.py [--only JAX Tianshou] [--venvs FOLDER]

Prints a row of docs/results.md for each; a frame is one decision of one robot. If a framework
cannot be installed or run, the row holds the last line of its output.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
TORCH = "torch==2.13.0"


class Framework(NamedTuple):
    """A script and its requirements."""

    script: str
    algorithm: str
    needs: tuple[str, ...] = ()
    """Pinned versions, which override those of constraints.txt."""
    frees: tuple[str, ...] = ()
    """Packages of constraints.txt in another version required by the framework."""


FRAMEWORKS = {
    "Gymnasium and NumPy": Framework("numpy_es.py", "evolution strategy"),
    "stable-baselines3": Framework("sb3_ppo.py", "PPO", ("stable-baselines3==2.9.0", TORCH)),
    "JAX": Framework("jax_pg.py", "policy gradient", ("jax==0.10.2", "optax==0.2.8")),
    "Tianshou": Framework(
        "tianshou_ppo.py", "PPO", ("tianshou==2.0.1", TORCH), ("pandas", "filelock")
    ),
    # without peft, which only its language models need, AgileRL cannot be imported
    "AgileRL": Framework(
        "agilerl_ippo.py",
        "IPPO",
        ("agilerl==2.58.0", "peft==0.21.0", TORCH),
        ("pandas", "filelock", "pettingzoo"),
    ),
    "skrl": Framework("skrl_ppo.py", "PPO", ("skrl==2.1.1", TORCH)),
}


def run(*command: str | Path) -> str:
    """Output of a command; a RuntimeError holds its last line if the command fails."""
    words = [str(word) for word in command]
    done = subprocess.run(words, capture_output=True, text=True, cwd=HERE, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip() or done.stdout.strip()).splitlines()[-1])
    return done.stdout


def install(framework: Framework, folder: Path) -> float:
    """Recreate the environment; returns the duration, s."""
    began = time.perf_counter()
    run(sys.executable, "-m", "venv", "--clear", folder)
    own = {re.split(r"[\[=<>]", pin)[0] for pin in framework.needs} | set(framework.frees)
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    constraints = folder / "constraints.txt"
    constraints.write_text("\n".join(pin for pin in pins if pin.split("==")[0] not in own) + "\n")
    pip = (folder / "bin" / "pip", "install", "--quiet", "--constraint", constraints)
    for pin in sorted(framework.needs, reverse=True):  # torch first, so that its build is kept
        run(*pip, pin)
    run(*pip, "--editable", ROOT, *framework.needs)
    return time.perf_counter() - began


def row(name: str, framework: Framework, folder: Path) -> str:
    """Row of the table."""
    text = re.sub(r'\A""".*?"""', "", (HERE / framework.script).read_text(), flags=re.DOTALL)
    lines = sum(1 for line in text.splitlines() if re.match(r"\s*[^\s#]", line))
    learning = f"{framework.algorithm}, `{framework.script}`, {lines} lines"
    try:
        installed = install(framework, folder)
        said = run(folder / "bin" / "python", HERE / framework.script)
    except RuntimeError as error:
        return f"| {name} | {error} | | {learning} | |"
    found = json.loads(re.findall(r"^{.*}$", said, flags=re.MULTILINE)[-1])
    trained = f"{found['training_seconds']:.0f} s: {found['training_frames'] / 1e3:.0f} k frames"
    return (
        f"| {name} | {installed:.0f} s | {found['frames_per_second']:,.0f} frames/s "
        f"| {learning}, {trained} | {100 * found['before']:.0f} → {found['after']:.0%} clean |"
    )


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
