"""The scripts of the table of frameworks run, those of frameworks that are installed."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from run_table import FRAMEWORKS, Framework, figures, row

HERE = Path(__file__).parent
SMALL = {
    "numpy_es.py": ("--generations", "1", "--pairs", "2", "--teams", "2"),
    "sb3_ppo.py": ("--frames", "2048", "--teams", "8"),
    "jax_pg.py": ("--updates", "1", "--teams", "4"),
    "tianshou_ppo.py": ("--epochs", "1", "--teams", "4"),
    "agilerl_ippo.py": ("--updates", "1", "--teams", "4"),
    "skrl_ppo.py": ("--steps", "32", "--teams", "4"),
}
NEEDS = {
    "sb3_ppo.py": "stable_baselines3",
    "jax_pg.py": "jax",
    "tianshou_ppo.py": "tianshou",
    "agilerl_ippo.py": "agilerl",
    "skrl_ppo.py": "skrl",
}


def test_every_framework_has_a_small_setting():
    assert {framework.script for framework in FRAMEWORKS.values()} == set(SMALL)
    assert all((HERE / script).is_file() for script in SMALL)


def test_lines_leave_out_what_is_no_code(tmp_path, monkeypatch):
    monkeypatch.setattr("run_table.HERE", tmp_path)
    (tmp_path / "one.py").write_text(
        '"""Says\n\nmuch."""\n\n# why\na = 1  # here\n\n  # or\nb = 2\n'
    )
    assert Framework("one.py", "none").lines == 2


def test_what_does_not_run_stands_in_its_row(tmp_path, monkeypatch):
    monkeypatch.setattr("run_table.HERE", tmp_path)
    monkeypatch.setattr("run_table.install", lambda framework, folder: 12.3)
    (tmp_path / "venv" / "bin").mkdir(parents=True)
    (tmp_path / "venv" / "bin" / "python").symlink_to(sys.executable)
    one = Framework("one.py", "PPO")
    (tmp_path / "one.py").write_text("raise ValueError('no such door')\n")
    failed = row("One", one, tmp_path / "venv")
    assert failed == "| One | ValueError: no such door | | PPO, `one.py`, 1 lines | |"
    told = {"frames_per_second": 5000.4, "training_frames": 2000, "training_seconds": 3.2}
    said = json.dumps({**told, "before": 0.03, "after": 0.92})
    (tmp_path / "one.py").write_text(f"print('hello')\nprint('{said}')\nprint('bye')\n")
    assert row("One", one, tmp_path / "venv") == (
        "| One | 12 s | 5,000 frames/s | PPO, `one.py`, 3 lines, 3 s: 2 k frames | 3 → 92% clean |"
    )


@pytest.mark.parametrize("script", [one for one in SMALL if find_spec(NEEDS.get(one, "numpy"))])
def test_script(script):
    done = subprocess.run(
        [sys.executable, str(HERE / script), *SMALL[script], "--starts", "2"],
        capture_output=True,
        text=True,
        cwd=HERE,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = figures(done.stdout)
    assert list(found) == [
        "frames_per_second", "training_frames", "training_seconds", "before", "after",
    ]  # fmt: skip
    assert found["frames_per_second"] > 0 and found["training_frames"] > 0
    assert {found["before"], found["after"]} <= {0.0, 0.5, 1.0}
