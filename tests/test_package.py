"""The house: who imports whom, what an import costs, what is public, and the wheel."""

from __future__ import annotations

import ast
import inspect
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from conftest import ROOT

import baselines
import rendezvous_env as rv

PACKAGES = {"rendezvous_env": 0, "baselines": 1, "train": 2}
"""Each may import what stands on a lower floor."""
HEAVY = {"torch", "stable_baselines3", "safetensors", "tensorboard"}
LAZY = {"torch", "stable_baselines3", "matplotlib", "pygame", "shapely", "PIL", "tyro", "networkx"}
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
)
CORE = [name for name in MODULES if not name.startswith("train")]


def source_of(module: str) -> Path:
    path = ROOT / module.replace(".", "/")
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def imports(module: str) -> set[str]:
    """Top-level packages that a module imports anywhere in its source."""
    found = set()
    for node in ast.walk(ast.parse(source_of(module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module).split(".")[0])
    return found


def run_python(code: str, cwd: Path, *flags: str, **environment: str) -> str:
    found = subprocess.run(
        [sys.executable, *flags, "-c", code],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, **environment},
        timeout=300,
    )
    assert found.returncode == 0, found.stderr
    return found.stdout


# ---- layers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", MODULES)
def test_nothing_points_back(module):
    floor = PACKAGES[module.split(".")[0]]
    wrong = {name for name in imports(module) if PACKAGES.get(name, -1) > floor}
    assert not wrong
    if floor < PACKAGES["train"]:
        assert not imports(module) & HEAVY
    assert "tests" not in imports(module)


def test_the_reader_of_imports_reads_them():
    assert {"numpy", "numba"} <= imports("rendezvous_env.compilation") | imports(
        "rendezvous_env.simulator"
    )
    assert "rendezvous_env" in imports("baselines.laws")
    assert len(CORE) > 25


def test_a_law_reads_no_position():
    """Policies know the scenario and what their robots see, not the simulator."""
    for module in CORE:
        if module.startswith("baselines"):
            text = source_of(module).read_text(encoding="utf-8")
            assert "Simulator" not in text and ".simulator" not in text


# ---- importing ----------------------------------------------------------------------------------


def test_an_import_pulls_in_nothing_heavy(tmp_path):
    code = "import sys, rendezvous_env, baselines; print(*{m.split('.')[0] for m in sys.modules})"
    loaded = set(run_python(code, tmp_path, "-W", "error").split())
    assert {"numpy", "numba", "rendezvous_env", "baselines"} <= loaded
    assert not loaded & LAZY


def test_a_rollout_needs_nothing_heavy_either(tmp_path):
    code = (
        "import sys, rendezvous_env as rv, baselines;"
        "s = rv.scenarios.get('duo'); t = rv.rollout(s, baselines.make('bearing-only', s));"
        "assert t.success.all(); print(*{m.split('.')[0] for m in sys.modules})"
    )
    assert not set(run_python(code, tmp_path).split()) & (LAZY - {"tyro"})


def test_a_folder_that_holds_a_train_py_is_no_obstacle(tmp_path):
    for name in ("train.py", "compare.py", "graphs.py", "kernels.py", "policy.py"):
        (tmp_path / name).write_text("raise RuntimeError('the wrong module was imported')\n")
    code = "import rendezvous_env as rv, baselines; env = rv.parallel_env('duo'); env.reset(seed=0)"
    printed = run_python(code + "; print(env.agents)", tmp_path, PYTHONSAFEPATH="")
    assert "robot_1" in printed


# ---- public names -------------------------------------------------------------------------------


def test_the_public_names_of_the_design():
    wanted = (
        "Scenario scenarios rollout certificate rendezvous_v0 parallel_env Simulator Trajectory"
    )
    for name in wanted.split():
        assert hasattr(rv, name) and name in rv.__all__, name
    for name in rv.__all__:
        assert hasattr(rv, name), name
    assert callable(rv.scenarios.names) and callable(rv.scenarios.get)
    for name in ("parallel_env", "env", "raw_env"):
        assert callable(getattr(rv.rendezvous_v0, name))
    for name in ("make", "names", "Policy"):
        assert hasattr(baselines, name)
    assert {
        "bearing-only", "unicycle", "unicycle-cosine", "nonholonomic-3d", "random", "zero",
        "tangent", "tangent-blocking", "tangent-joined",
    } <= set(baselines.names())  # fmt: skip


def test_the_signatures_of_the_design():
    def names(function):
        return list(inspect.signature(function).parameters)

    assert names(rv.parallel_env) == ["scenario", "render_mode", "max_cycles", "overrides"]
    assert names(rv.rollout) == ["scenario", "policy", "seed", "num_envs", "options"]
    assert names(rv.certificate) == ["scenario", "min_alignment"]
    defaults = inspect.signature(rv.Scenario).parameters
    for name, value in {
        "n_robots": 5, "dim": 2, "robot_model": "single_integrator", "merge_radius": 0.2,
        "time_step": None, "time_limit": 30.0, "max_speed": None, "obstacles": (),
        "obstacle_range": 2.0, "obstacle_contact": "slide", "spawn_size": 10.0,
        "local_frames": "random", "on_merge": "remove", "require_connected": True,
    }.items():  # fmt: skip
        assert defaults[name].default == value, name
    assert rv.Scenario().sensing_graph == rv.graphs.complete()


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert rv.__version__ == project["version"]


# ---- documentation ------------------------------------------------------------------------------


def is_public(node: ast.AST) -> bool:
    """Whether its name is public, if it has one; a setter is told by its property."""
    if isinstance(node, ast.Module):
        return True
    if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
        return False
    return not any(ast.unparse(mark).endswith(".setter") for mark in node.decorator_list)


@pytest.mark.parametrize("module", MODULES)
def test_modules_and_what_is_public_in_them_are_documented(module):
    tree = ast.parse(source_of(module).read_text(encoding="utf-8"))
    if module != "train" or tree.body:
        assert ast.get_docstring(tree), f"{module} has no docstring"
    bare = [
        f"{getattr(parent, 'name', module)}.{node.name}"
        for parent in ast.walk(tree)
        if isinstance(parent, ast.Module | ast.ClassDef) and is_public(parent)
        for node in parent.body
        if is_public(node) and not ast.get_docstring(node)
    ]
    assert bare == []


# ---- the wheel ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_wheel_in_an_empty_environment_compares_without_the_train_extra(tmp_path):
    def call(*command: object, cwd: Path = tmp_path) -> str:
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        done = subprocess.run(
            [str(part) for part in command],
            capture_output=True,
            text=True,
            cwd=cwd,
            env=environment,
            timeout=900,
        )
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        return done.stdout

    call(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path / "dist", ROOT)
    (wheel,) = (tmp_path / "dist").glob("rendezvous_env-*.whl")
    call(sys.executable, "-m", "venv", tmp_path / "venv")
    scripts = tmp_path / "venv" / "bin"
    call(scripts / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", wheel)
    installed = call(scripts / "python", "-m", "pip", "list").lower()
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
    assert any(row.startswith("duo,bearing-only,4,1") for row in rows)
