"""Package structure: import layers, import costs, public names, and the wheel."""

import ast
import inspect
import re
import sys
import tomllib
from functools import cache
from importlib import import_module
from pathlib import Path
from textwrap import indent

import pytest
from conftest import ROOT, run_python

import baselines
import rendezvous_env as rv

PACKAGES = {"rendezvous_env": 0, "baselines": 1, "train": 2}
"""Layers of packages; each may import from lower layers only."""
HEAVY = {"torch", "stable_baselines3", "tensorboard"}
LAZY = {
    "torch", "stable_baselines3", "matplotlib", "pygame", "shapely", "PIL", "tyro", "networkx",
    "pandas", "xarray", "safetensors", "typeguard", "minari", "onnx", "onnxruntime",
    "mujoco", "irsim", "rclpy", "jax", "jaxlib",
}  # fmt: skip
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
)
ROOMS = (
    {
        "compilation",
        "kernel_cache",
        "checks",
        "deprecation",
        "field_checks",
        "field_docs",
        "field_repr",
        "inner_code",
        "limits",
        "suggestions",
    },
    {"physics"},
    {"robots", "rewards"},
    {"obstacles"},
    {"calibration"},
    {"obstacles.maps"},
    {"traffic"},
    {"sensors"},
    {"graphs"},
    {"scenario"},
    {"outcome"},
    {"engine.memory"},
    {"engine.stages"},
    {"engine"},
    {
        *("simulator", "state_view", "trajectory", "trajectory_formats", "trajectory_views"),
        *("observation_fit", "first_initial_conditions"),
    },
    {"safety"},
    {"safety.theorems"},
    {"render"},
    {"envs"},
    {"rendezvous_v0", "vector", "safe_names"},
    {"jax.arrays"},
    {"jax.obstacles", "jax.filters"},
    {"jax"},
    {"adapters"},
)
"""Folders and files of the environment in order; each imports earlier ones only."""
LEVEL = {room: level for level, rooms in enumerate(ROOMS) for room in rooms}
MAX_MODULES = 13


def source_of(module: str) -> Path:
    path = ROOT / module.replace(".", "/")
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


@cache
def imported_names(module: str) -> set[str]:
    """Full names of all imports of a module, in functions and for types as well."""
    package = module if source_of(module).name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(source_of(module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) + 1 - node.level]
            base = ".".join([*(parents if node.level else []), *filter(None, [node.module])])
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return {re.sub(r"^rendezvous_env\.(?=(baselines|train)\b)", "", name) for name in found}


def imports(module: str) -> set[str]:
    """Top-level packages imported by a module."""
    return {name.split(".")[0] for name in imported_names(module)}


@cache
def ours(module: str) -> set[str]:
    """Imported modules of this project; a package itself if one of its names is imported."""
    names = imported_names(module)
    found = {name if name in MODULES else name.rpartition(".")[0] for name in names}
    return (found & set(MODULES)) - {module}


@cache
def all_imported(module: str) -> set[str]:
    """Modules of this project that are imported by it, directly or indirectly."""
    seen, left = set(), {module}
    while left:
        seen |= left
        left = {name for each in left for name in ours(each)} - seen
    return seen


def room_of(module: str) -> str:
    """Folder of a module; a file next to folders counts separately."""
    if source_of(module).name == "__init__.py":
        return module
    folder = module.rpartition(".")[0]
    return module if folder in PACKAGES else folder


def level_of(room: str) -> int:
    """Layer of a folder of the environment; unlisted ones export public names."""
    return LEVEL.get(room.removeprefix("rendezvous_env."), len(ROOMS))


def test_no_upward_imports():
    wrong = []
    for module in MODULES:
        floor = PACKAGES[module.split(".")[0]]
        above = {name for name in imports(module) if PACKAGES.get(name, -1) > floor} | {"tests"}
        if floor < PACKAGES["train"] and room_of(module) != "rendezvous_env.adapters":
            above |= HEAVY
        wrong += [f"{module} imports {name}" for name in imports(module) & above]
    assert wrong == []


def test_commands_print_without_markup():
    assert {m for m in MODULES if "rich.console.Console" in imported_names(m)} == set()


@pytest.mark.slow
def test_short_names_are_not_used_internally():
    """Short names may refer to a user's files; the safe names never do."""
    for module in MODULES:
        words = []
        for node in ast.walk(ast.parse(source_of(module).read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                words += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                words.append(node.module)
            elif isinstance(node, ast.Call) and node.args:
                words += re.findall(r"^f?['\"](\w+)\.", ast.unparse(node.args[0]))
        assert not {word.partition(".")[0] for word in words} & {"train", "baselines"}, module


def test_laws_do_not_read_positions():
    """Policies import the scenario and observations, not the simulator, except oracles.

    Training environments of policies wrap an environment. Policies of trained models import them;
    no others do.
    """
    environment = "baselines.learned.training_environment"
    privileged = "baselines.references.privileged"
    for module in MODULES:
        if module.startswith("baselines") and not module.startswith((privileged, environment)):
            text = source_of(module).read_text(encoding="utf-8")
            assert "Simulator" not in text and ".simulator" not in text
            assert environment not in ours(module) or module == "baselines.trained_policy"


def test_import_reader_follows_relative_imports():
    assert "rendezvous_env.physics.vectors" in ours("rendezvous_env.physics.potential")
    assert "rendezvous_env" in imports("baselines.laws.paper_laws")
    assert "train.checks" in ours("train.compare.settings")
    assert "train.figures.figures" in ours("train.compare.compare")  # in a function
    assert "rendezvous_env.scenario.scenarios" in ours("rendezvous_env.adapters.sb3")  # a type
    assert "rendezvous_env.graphs" in ours("rendezvous_env")


def test_no_import_cycles_between_files():
    circles = [(a, b) for a in MODULES for b in ours(a) if a in all_imported(b)]
    assert circles == []


def test_no_import_cycles_between_packages():
    pairs = {(room_of(a), room_of(b)) for a in MODULES for b in ours(a)}
    assert ("train.compare", "baselines.learned") in pairs
    both = {(a, b) for a, b in pairs if a < b and (b, a) in pairs}
    assert both == set()


def test_environment_packages_are_layered():
    inside = [name for name in MODULES if name.startswith("rendezvous_env")]
    wrong = [
        f"{module} imports {name}"
        for module in inside
        for name in ours(module)
        if level_of(room_of(name)) > level_of(room_of(module))
    ]
    assert wrong == []


def test_no_package_is_crowded():
    rooms = [room_of(name) for name in MODULES if source_of(name).name != "__init__.py"]
    crowded = {room: rooms.count(room) for room in set(rooms) if rooms.count(room) > MAX_MODULES}
    assert crowded == {}


@pytest.mark.parametrize(
    "face", ["envs.gymnasium_env", "envs.vector_env", "vector", "adapters.slots"]
)
def test_arrays_need_no_pettingzoo(face):
    reached = all_imported(f"rendezvous_env.{face}")
    assert "rendezvous_env.simulator" in reached or face == "adapters.slots"
    assert not [name for name in reached if "pettingzoo" in imports(name)]


@pytest.mark.slow
def test_train_import_is_light(tmp_path):
    code = (
        "import sys, train; light = not {'torch', 'stable_baselines3', 'rich'} & set(sys.modules);"
        "from train import compare, learned_policy, ppo;"
        "from train.compare import Config, compare as c; from train.learn import ppo as p;"
        "from rendezvous_env.adapters import sb3;"
        "print(light, compare.Config is c.Config, ppo is p, learned_policy.load.__name__,"
        "train.sb3_vec_env.make_robots is sb3.make_robots)"
    )
    assert run_python(tmp_path, "-c", code).stdout == "True True True load True\n"
    with pytest.raises(ImportError, match="cannot import name 'no_such_module'"):
        exec("from train import no_such_module")


def test_heavy_libraries_are_not_imported(tmp_path):
    """This includes learned policies, which read weights from files."""
    code = (
        "import sys, rendezvous_env as rv, baselines;"
        "tell = lambda: print(*{m.split('.')[0] for m in sys.modules}); tell();"
        "s = rv.scenarios.get('clutter-8').replace(time_limit=1.0);"
        "move = lambda p: abs(rv.rollout(s, p, record='actions').actions).max() > 0.5;"
        "assert move(baselines.make('bearing-only', s)); tell();"
        "learned = [n for n in baselines.names(s) if n.startswith('learned')];"
        "assert len(learned) > 2 and all(move(baselines.make(n, s)) for n in learned); tell()"
    )
    said = run_python(tmp_path, "-W", "error", "-c", code).stdout.splitlines()
    imported, used, read = (set(line.split()) for line in said)
    assert {"numpy", "numba", "rendezvous_env", "baselines"} <= imported
    assert not imported & LAZY and not used & (LAZY - {"tyro"})
    assert not read & (LAZY - {"tyro", "safetensors", "typeguard"})


BESIDE = {"PYTHONSAFEPATH": "", "PYTHONPATH": str(ROOT)}
"""Environment variables with which files next to a script shadow the packages."""
OWN_TRAIN = """
import baselines, rendezvous_env as rv
from rendezvous_env.adapters import sb3

scenario = rv.scenarios.get("clutter-8").replace(time_limit=0.5)
robots = sb3.make_robots(scenario, 2)
assert robots.reset().shape[0] == robots.num_envs == 8
own = baselines.HeadingPolicy(scenario, lambda seen: seen[..., 0, :])
for policy in (own, baselines.make("learned", scenario), baselines.make("learned-tank", scenario)):
    print(abs(rv.rollout(scenario, policy, record="actions").actions).max() > 0.1)
"""


@pytest.mark.slow
def test_user_train_script_can_use_the_library(tmp_path):
    """Also when it is imported, and thus registered under that module name."""
    for name in ("compare.py", "graphs.py", "kernels.py", "policy.py"):
        (tmp_path / name).write_text("raise RuntimeError('the wrong module was imported')\n")
    (tmp_path / "train.py").write_text(OWN_TRAIN)
    said = run_python(tmp_path, "-c", "import train", **BESIDE).stdout
    assert said.split() == ["True"] * 3


@pytest.mark.slow
def test_console_script_works_beside_train_py(tmp_path):
    """It also finds a policy in a neighbouring file."""
    (tmp_path / "train.py").write_text("raise RuntimeError('the wrong train')\n")
    (tmp_path / "mine.py").write_text(
        "import baselines\ndef make(scenario):\n    return baselines.make('learned', scenario)\n"
    )
    script = Path(sys.executable).with_name("rendezvous")
    words = "compare --scenarios clutter-4 --policies learned mine:make --episodes 2 --no-figures"
    run_python(tmp_path, script, *words.split(), "--jobs", "2", "--out", "out", **BESIDE)
    rows = (tmp_path / "out" / "results.csv").read_text(encoding="utf-8").splitlines()
    ours, theirs = (row.split(",")[3:] for row in rows[1:])
    assert ours == theirs and rows[2].startswith("clutter-4,mine:make,2,")


@pytest.mark.nightly
@pytest.mark.parametrize("script", ["main.py", "train.py"])
def test_safe_names_work_beside_user_files(script, tmp_path):
    """Also in a script of that name; workers load it under another name."""
    for name in ("train.py", "baselines.py"):
        (tmp_path / name).write_text("raise RuntimeError('the wrong module was imported')\n")
    compare = "compare --scenarios duo --episodes 2 --no-figures --jobs 2 --out out"
    export = "export --policy tangent-merged --scenario clutter-4 --standalone robot.py"
    code = "from rendezvous_env.train import cli\n" + "".join(
        f"assert cli.main({words.split()}) == 0\n"
        for words in (compare, "report out", export, "verify --trials 5 --jobs 1 --out verified")
    )
    imported = "assert __name__ != 'train', 'imported as a module of the package'\n"
    started = f"if __name__ == '__main__':\n{indent(code, ' ')}"
    (tmp_path / script).write_text(imported + started)
    run_python(tmp_path, script, **BESIDE)


def test_public_names_are_stable():
    wanted = {"Scenario", "scenarios", "rollout", "certificate", "rendezvous_v0", "parallel_env"}
    assert wanted | {"Simulator", "Trajectory"} <= set(rv.__all__)
    for home, names in {
        rv: rv.__all__,
        rv.scenarios: ("names", "get"),
        rv.rendezvous_v0: ("parallel_env", "env", "raw_env"),
        baselines: ("make", "names", "Policy", "HeadingPolicy", "TankPolicy"),
    }.items():
        assert [name for name in names if not hasattr(home, name)] == []


def test_signatures_are_stable():
    def names(function):
        return list(inspect.signature(function).parameters)

    wanted = ["scenario", "render_mode", "max_cycles", "flatten", "overrides"]
    assert names(rv.parallel_env) == wanted
    assert names(rv.rollout) == ["scenario", "policy", "seed", "num_envs", "options", "record"]
    assert names(rv.certificate) == [
        "scenario", "min_alignment", "by", "budget", "min_gain", "max_gain", "share",
        "bearing_error", "policy",
    ]  # fmt: skip
    for home in (rv, import_module("rendezvous_env.vector")):
        assert names(home.GainWrapper)[:3] == ["env", "min_gain", "max_gain"]
        assert names(home.LinkKeepingWrapper)[:3] == ["env", "share", "bearing_error"]
    defaults = inspect.signature(rv.Scenario).parameters
    for name, value in {
        "n_robots": 5, "dim": 2, "robot_model": "single_integrator", "merge_radius": 0.2,
        "time_step": None, "time_limit": 30.0, "max_speed": None, "obstacles": (),
        "obstacle_range": 2.0, "obstacle_contact": "slide", "spawn_size": 10.0,
        "local_frames": "random", "on_merge": "remove", "require_connected": True,
    }.items():  # fmt: skip
        assert defaults[name].default == value, name
    assert rv.Scenario().sensing_graph == rv.graphs.complete()


def test_project_lists_every_package():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    folders = {name for name in MODULES if source_of(name).name == "__init__.py"}
    assert set(listed["setuptools"]["packages"]) == folders
