"""The package as a user installs it: a wheel, not the folder that it is written in."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from conftest import ROOT

KERNELS = ROOT / "rendezvous_env" / "__pycache__"  # what other tests compiled is the same code


def call(*command: object, cwd: Path) -> str:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment.setdefault("NUMBA_CACHE_DIR", str(KERNELS))
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True, text=True, cwd=cwd, env=environment, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    dist = tmp_path_factory.mktemp("dist")
    options = ["-q", "--no-deps", "--no-build-isolation", "-w", dist]
    call(sys.executable, "-m", "pip", "wheel", *options, ROOT, cwd=dist)
    (made,) = dist.glob("rendezvous_env-*.whl")
    return made


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """An interpreter with the wheel, and all else from where the tests run."""
    venv = tmp_path_factory.mktemp("installed") / "venv"
    call(sys.executable, "-m", "venv", "--without-pip", venv, cwd=venv.parent)
    made = venv / "bin" / "python"
    purelib = "import sysconfig; print(sysconfig.get_paths()['purelib'])"
    site = Path(call(made, "-c", purelib, cwd=venv).strip())
    options = ["-q", "--no-deps", "--target", site]
    call(sys.executable, "-m", "pip", "install", *options, wheel, cwd=venv)
    # a path that is added so runs no .pth file of its own: the editable install stays outside
    (site / "rest.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return made


USE = """
import numpy as np
import rendezvous_env as rv
from rendezvous_env import baselines

teams = rv.vector.training_env("clutter-4", 2)
teams.reset(seed=0)
teams.step(np.zeros(teams.action_space.shape, np.float32))
SHORT = rv.scenarios.get("clutter-4").replace(time_limit=1.0)
ahead = baselines.TrainedPolicy("clutter-4", lambda seen: np.zeros((len(seen), 2)))
for policy in (ahead, baselines.make("learned", SHORT), baselines.make("tank-joined", SHORT)):
    print(len(rv.rollout(SHORT, policy).times) > 10)
print(baselines.__name__, rv.__file__)
"""


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True])
def test_names_of_a_users_own_files_hide_nothing(python, hidden, tmp_path):
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
    assert str(python.parent.parent) in printed[3]
    assert printed[4:] == ["True"] * hidden
    again = call(python, script, cwd=tmp_path)  # from the kernels' cache
    assert again.splitlines() == printed


@pytest.mark.slow
def test_a_wheel_in_an_empty_environment_compares_without_the_train_extra(wheel, tmp_path):
    call(sys.executable, "-m", "venv", tmp_path / "venv", cwd=tmp_path)
    scripts = tmp_path / "venv" / "bin"
    call(
        scripts / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", wheel,
        cwd=tmp_path,
    )  # fmt: skip
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
