"""Installed package: a wheel, independent of the source folder."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

NO_REGISTRY = re.compile("NewConnectionError|NameResolutionError|ConnectTimeoutError")
FEWER = {"--total-steps": "4096", "--episodes": "4", "--steps": "4096"}
"""Smaller values for flags of the README's commands."""
KERNELS = ROOT / "rendezvous_env" / "__pycache__"  # what other tests compiled is the same code


def run(*command: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command without access to the test folder."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment.setdefault("NUMBA_CACHE_DIR", str(KERNELS))
    return subprocess.run(
        [str(part) for part in command],
        capture_output=True, text=True, cwd=cwd, env=environment, timeout=1800,
    )  # fmt: skip


def call(*command: object, cwd: Path) -> str:
    """Output of a command, which must succeed."""
    done = run(*command, cwd=cwd)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    dist = tmp_path_factory.mktemp("dist")
    options = ["-q", "--no-deps", "--no-build-isolation", "-w", dist]
    call(sys.executable, "-m", "pip", "wheel", *options, ROOT, cwd=dist)
    (made,) = dist.glob("rendezvous_env-*.whl")
    return made


def install(scripts, *requirements):
    """Install packages and their dependencies into an environment, given by its scripts folder.

    Everything comes from the package registry; without one the test is skipped.
    """
    options = ["-q", "--no-compile", "-c", ROOT / "constraints.txt"]
    python = scripts / "python"
    done = run(python, "-m", "pip", "install", *options, *requirements, cwd=scripts)
    if NO_REGISTRY.search(done.stderr) and not os.environ.get("CI"):
        pytest.skip("the package registry cannot be reached")
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.fixture(scope="module")
def scripts(wheel, tmp_path_factory):
    """Scripts folder of a new environment with the wheel, without access to the test folder."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    call(sys.executable, "-m", "venv", folder, cwd=folder.parent)
    install(folder / "bin", wheel)
    return folder / "bin"


@pytest.fixture(scope="module")
def training_scripts(wheel, scripts):
    """The same with the extra ``train``, for the last tests of this file."""
    install(scripts, "torch==2.13.0", f"{wheel}[train]")
    return scripts


USE = """
import numpy as np
import rendezvous_env as rv
from rendezvous_env import baselines

teams = rv.vector.training_env("clutter-4", 2)
teams.reset(seed=0)
teams.step(np.zeros(teams.action_space.shape, np.float32))
SHORT = rv.scenarios.get("clutter-4").replace(time_limit=1.0)
ahead = baselines.TrainedPolicy("clutter-4", lambda seen: np.zeros((len(seen), 2)))
for policy in (ahead, baselines.make("learned", SHORT), baselines.make("tank-merged", SHORT)):
    print(len(rv.rollout(SHORT, policy).times) > 10)
print(baselines.__name__, rv.__file__)
"""


@pytest.mark.nightly
@pytest.mark.parametrize("hidden", [False, True])
def test_user_files_do_not_shadow_modules(scripts, hidden, tmp_path):
    python = scripts / "python"
    script = tmp_path / "main.py"
    script.write_text(USE)
    if hidden:
        (tmp_path / "train.py").write_text("raise RuntimeError('the wrong train')\n")
        (tmp_path / "baselines").mkdir()
        (tmp_path / "baselines" / "__init__.py").write_text("mine = True\n")
        script.write_text(USE + "import baselines as own; print(own.mine)\n")
    printed = call(python, "-W", "error", script, cwd=tmp_path).splitlines()
    assert printed[:3] == ["True"] * 3
    assert printed[3].startswith("rendezvous_env.baselines" if hidden else "baselines ")
    assert str(scripts.parent) in printed[3]
    assert printed[4:] == ["True"] * hidden
    again = call(python, script, cwd=tmp_path)  # from the kernels' cache
    assert again.splitlines() == printed


@pytest.mark.nightly
def test_wheel_compares_without_train_extra(scripts, tmp_path):
    installed = call(scripts / "python", "-m", "pip", "list", cwd=tmp_path).lower()
    assert "rendezvous-env" in installed
    assert not any(line.startswith(("torch ", "stable")) for line in installed.splitlines())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "train.py").write_text("raise RuntimeError('the wrong train')\n")
    out = elsewhere / "out"
    shown = call(
        scripts / "rendezvous", "compare", "--scenarios", "duo", "--episodes", "4", "--out", out,
        cwd=elsewhere,
    )  # fmt: skip
    assert "duo" in shown and "bearing-only" in shown
    call(scripts / "rendezvous", "report", out, cwd=elsewhere)
    assert "uPlot" in (out / "report.html").read_text(encoding="utf-8")
    rows = (out / "results.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("scenario,policy,episodes,success")
    for policy in ("bearing-only", "learned", "learned-tank"):
        assert any(row.startswith(f"duo,{policy},4,1") for row in rows)


@pytest.mark.slow
def test_readme_runs_in_an_empty_environment(training_scripts, tmp_path):
    """All Python blocks as one program, then the commands, with fewer steps and episodes."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = {
        language: re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)
        for language in ("python", "bash")
    }
    (tmp_path / "readme.py").write_text("\n".join(blocks["python"]), encoding="utf-8")
    call(training_scripts / "python", "readme.py", cwd=tmp_path)
    lines = "\n".join(blocks["bash"]).replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines]
    for name, *words in filter(None, commands):
        if name == "rendezvous":
            smaller = [
                FEWER.get(flag, word) for flag, word in zip(["", *words], words, strict=False)
            ]
            call(training_scripts / name, *smaller, cwd=tmp_path)
    assert any(words[0] == "rendezvous" for words in commands if words)
