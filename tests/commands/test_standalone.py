"""``rendezvous export --standalone``: one NumPy-only file with equal actions."""

import ast
import hashlib
import json
import py_compile
import re
import sys
import textwrap
import zipfile
from importlib import import_module
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import run_python
from parameters import first_fast, needed, slow
from robot_actions import neighbour_reading

import baselines
import rendezvous_env as rv
from baselines import RobotPolicy
from rendezvous_env.trajectory import run
from train import cli, policies, standalone
from train.standalone.bundle import Bundle, Name

POLICIES = ["learned", "learned-tank", "tangent-merged-tuned", "tangent-merged", "bearing-only"]
CLUTTER = rv.scenarios.get("clutter-12")
SPACE = [("learned-tank", name) for name in ("clutter-3d-32", "window-3d", "uav-clutter-16")]
SPACE += [("tangent-merged-tuned", "uav-clutter-16")]
LONG = [*SPACE, *product(POLICIES, ["trap"])]
LONG += product(["learned-tank", "bearing-only"], ["robotarium-10"])
LONG += [(name, "utias-5-clutter") for name in ("search-and-pursue", "learned-search")]
SHORT = [("learned", "unicycle-6"), ("learned", "uav-6"), ("search-and-pursue", "utias-5")]
SHORT += [("learned-search", "utias-5")]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Function path(policy, scenario): path of a file, written once."""
    folder = tmp_path_factory.mktemp("standalone")

    def path(policy, scenario="clutter-12"):
        file = folder / f"{policy}-{scenario}.py"
        if not file.exists():
            words = ["export", "--policy", policy, "--standalone", str(file)]
            assert cli.main([*words, "--scenario", scenario, "--checks", "150"]) == 0
        return file

    return path


def act_along(file, scenario, policy, seed, steps):
    """Largest difference between a file's robots and ``RobotPolicy`` along an episode."""
    kinds = (lambda: RobotPolicy(scenario, policy), file.RobotPolicy)
    robots = [[make() for make in kinds] for _ in range(scenario.n_robots)]
    simulator, batch, worst, moved = rv.Simulator(scenario), baselines.make(policy, scenario), 0, 0
    layout = scenario.observation_layout
    for count, step in enumerate(run(simulator, batch, simulator.reset(seed))):
        if count == steps:
            break
        seen = layout.split(step.observations[0].astype(float))
        for i, pair in enumerate(robots):
            if (reading := neighbour_reading(seen, i, layout.senses_gravity)) is None:
                continue
            bearings, told = reading
            edges = seen.obstacles[i][seen.obstacles[i].any(axis=(1, 2))]
            one, other = (robot.act(bearings, edges, scenario.tau, **told) for robot in pair)
            worst, moved = max(worst, np.abs(one - other).max()), moved + np.linalg.norm(one)
    assert count > 30 and moved > 1.0
    return worst


@pytest.mark.parametrize("policy", ["own_laws:certified", slow("learned-tank")])
def test_file_of_a_robot_with_own_limits_acts_as_in_the_team(own, policy, tmp_path):
    """By the settings of the whole team, within the robot's own limits."""
    limits = {"max_speed": [0.5, 1.0, 2.0], "max_turn_rate": [1.0, 0.5, 2.0]}
    if policy == "own_laws:certified":
        limits = {"max_speed": limits["max_speed"]}
    model = "single_integrator" if len(limits) == 1 else "unicycle"
    team = rv.Scenario(name="team", n_robots=3, robot_model=model, **limits)
    team.to_toml("team.toml")
    words = ["--policy", policy, "--standalone", "robot.py", "--checks", "30"]
    assert cli.main(["export", *words, "--scenario", "team.toml", "--robot", "2"]) == 0
    file = standalone.load(tmp_path / "robot.py").RobotPolicy()
    robot, moved = RobotPolicy(team, policies.make(policy, team), robot=2), 0.0
    for *seen, told in standalone.drawn_ticks(team.of_robot(2), 60):
        action = robot.act(*seen, **told)
        np.testing.assert_allclose(file.act(*seen, **told), action, atol=1e-6)
        moved += np.linalg.norm(action)
    assert moved > 5.0


@pytest.mark.slow
def test_example_of_the_documentation_is_exported(monkeypatch, tmp_path):
    """The file ``my_laws.py`` of the page, which uses ``baselines`` by attribute."""
    page = (Path(__file__).parents[2] / "docs/write-a-law.md").read_text(encoding="utf-8")
    found = re.search(r"```python\n(# my_laws\.py\n.*?)```", page, re.DOTALL)
    assert found and "baselines.HeadingPolicy(" in found[1]
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_laws.py").write_text(found[1], encoding="utf-8")
    words = ["--policy", "my_laws:make", "--standalone", "robot.py", "--checks", "100"]
    try:
        assert cli.main(["export", *words, "--scenario", "clutter-12"]) == 0
        robot = RobotPolicy(CLUTTER, policies.make("my_laws:make", CLUTTER))
    finally:
        sys.modules.pop("my_laws", None)
    action = standalone.load(tmp_path / "robot.py").RobotPolicy().act([[0.6, 0.8], [1.0, 0.0]])
    np.testing.assert_allclose(action, robot.act([[0.6, 0.8], [1.0, 0.0]]), atol=1e-6)
    assert np.linalg.norm(action) > 0.1


@pytest.mark.parametrize("robot", [0, 7])
def test_file_of_a_robot_of_a_mixed_team_is_that_of_its_model(robot, tmp_path, capsys):
    path = tmp_path / "robot.py"
    words = ["export", "--policy", "by-model", "--standalone", str(path), "--checks", "50"]
    assert cli.main([*words, "--scenario", "mixed-8", "--robot", str(robot)]) == 0
    assert f"robot {robot} of mixed-8" in "".join(capsys.readouterr().out.split("\n"))
    file, one = standalone.load(path), RobotPolicy("mixed-8", "by-model", robot=robot)
    command = one.act([[0.6, 0.8], [1.0, 0.0]])
    np.testing.assert_allclose(file.RobotPolicy().act([[0.6, 0.8], [1.0, 0.0]]), command, atol=1e-6)
    assert np.linalg.norm(command) > 0.1


def read_of_scenarios(text):
    """Attributes of ``scenario`` and ``self.scenario`` that a program reads."""
    owners = ("scenario", "team", "own")
    return {
        node.attr
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute)
        and getattr(node.value, "id", getattr(node.value, "attr", None)) in owners
    }


NOT_OF_ONE_ROBOT = {
    "mixes_models": "after `for_each and`, of lists of robots, or in messages",
    "sensing_graph": "in a message about other observations",
    "neighbour_slots": "in the same message",
}
"""Attributes that no robot of a file reads, and where they stand."""


@pytest.mark.parametrize(
    ("policy", "name"),
    [
        ("bearing-only", "clutter-12"),
        slow("learned-tank", "unicycle-6"),
        slow("tangent-merged", "clutter-12"),
        slow("learned", "unicycle-clutter-8"),
        slow("learned-tank", "uav-clutter-16"),
        slow("search-and-pursue", "utias-5"),
    ],
)
def test_scenario_of_a_file_has_every_attribute_that_is_read(exported, policy, name):
    path = exported(policy, name)
    read, team = read_of_scenarios(path.read_text(encoding="utf-8")), standalone.load(path).TEAM
    assert {"tau", "n_robots", "observation_layout"} <= read
    assert read - vars(team).keys() - NOT_OF_ONE_ROBOT.keys() == set()


def kind_of(scenario):
    """Robots, and whether there are obstacles: which policies there are, and most of their code."""
    return scenario.robot_model, scenario.dim, scenario.mixes_models, bool(scenario.obstacles)


NAMES = rv.scenarios.names()
FIRST = {kind_of(rv.scenarios.get(name)): name for name in reversed(NAMES)}
"""First scenario of each kind."""


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
def test_policies_of_a_robot_are_exported_for_every_scenario(name, tmp_path):
    """All of them for the first scenario of each kind, and one for each of the others."""
    scenario, count = rv.scenarios.get(name), 0
    first = FIRST[kind_of(scenario)]
    robots = [0, scenario.n_robots - 1] if scenario.mixes_models else [None]
    for robot in robots:
        own = scenario if robot is None else scenario.of_robot(robot)
        kinds = ("law", "rule", "learned")
        names = [one for one in baselines.names(own) if baselines.policy.kind_of(one) in kinds]
        assert len(names) > 1
        for policy in names if name == first else [names[NAMES.index(name) % len(names)]]:
            words = ["--policy", policy, "--standalone", str(tmp_path / f"{count}.py")]
            words += ["--checks", "20"] + ["--robot", str(robot)] * (robot is not None)
            assert cli.main(["export", *words, "--scenario", name]) == 0, policy
            count += 1
    assert count > 3 or name != first


class TestAgreement:
    @pytest.mark.parametrize(
        ("policy", "name", "steps"),
        [
            *((policy, "clutter-12", 120) for policy in POLICIES),
            *(needed(*one, 60) for one in SHORT),
            needed(*SPACE[-1], 10_000),
            *(slow(*one, 10_000) for one in LONG if one != SPACE[-1]),
        ],
    )
    def test_standalone_file_matches_policy(self, exported, policy, name, steps):
        file, scenario = standalone.load(exported(policy, name)), rv.scenarios.get(name)
        assert act_along(file, scenario, policy, 2, steps) < 1e-5
        in_space = scenario.dim == 3
        assert hasattr(file, "DifferentialDrive") == ("drive" in file.__doc__) == (not in_space)
        assert hasattr(file, "BodyReadings") == (not in_space)
        steady = "OdometryFrame:\n" in exported(policy, name).read_text(encoding="utf-8")
        assert steady == (in_space and policy.startswith("learned"))

    @pytest.mark.parametrize(
        ("policy", "name"),
        [
            *((policy, "clutter-12") for policy in POLICIES),
            *(needed(*one) for one in SHORT),
            *(slow(*one) for one in SPACE),
        ],
    )
    def test_standalone_file_matches_policy_where_net_bearing_is_zero(self, exported, policy, name):
        """No neighbour ever, neighbours lost, opposite and coincident ones."""
        file, scenario = standalone.load(exported(policy, name)).RobotPolicy(), name
        robot, worst = RobotPolicy(scenario, policy), 0.0
        episodes = standalone.corner_ticks(robot.scenario)
        silent = [all(not len(seen) for seen, *_ in episode[:3]) for episode in episodes]
        cancel = [any(np.abs(sum(seen)).max() == 0 < len(seen) for seen, *_ in e) for e in episodes]
        assert any(silent) and any(cancel)
        for episode in episodes:
            for one in (file, robot):
                one.reset()
            for *seen, told in episode:
                action = robot.act(*seen, **told)
                if not len(seen[0]) and "search" not in policy:
                    assert not action.any()
                worst = max(worst, np.abs(file.act(*seen, **told) - action).max())
        assert worst < 1e-5

    @pytest.mark.parametrize("fault", ["never", "lost", "opposite"])
    def test_export_checks_net_bearing_zero_with_any_number_of_checks(
        self, fault, monkeypatch, tmp_path, one_line
    ):
        """A file that fails there only is not written."""
        written = standalone.text_of
        conditions = {
            "never": "not len(bearings) and self._time < 0",
            "lost": "not len(bearings) and self._time > 0",
            "opposite": "len(bearings) == 2 and not np.sum(bearings, axis=0).any()",
        }
        start = "        elapsed = self.scenario.tau if dt is None"

        def wrong(*given):
            text = written(*given)
            assert start in text
            fail = f"        if {conditions[fault]}:\n            return np.full(2, 0.5)\n"
            lines = text.replace(start, fail + start).splitlines(keepends=True)
            digest = hashlib.sha256("".join(lines[:-1]).encode()).hexdigest()
            return "".join(lines[:-1]) + re.sub(r"[0-9a-f]{64}", digest, lines[-1])

        monkeypatch.setattr(standalone, "text_of", wrong)
        words = "--policy", "bearing-only", "--standalone", tmp_path / "robot.py", "--checks", "1"
        assert "the file differs from the policy by" in one_line("export", *words)
        assert not list(tmp_path.iterdir())

    def test_reset_restarts_and_bad_measurements_are_named(self, exported):
        file = standalone.load(exported("learned-tank"))
        robot, seen = file.RobotPolicy(), [[1.0, 0.0], [0.0, 1.0]]
        first = robot.act(seen)
        robot.act(seen, dt=0.3)
        robot.reset()
        np.testing.assert_array_equal(robot.act(seen), first)
        with pytest.raises(ValueError, match=r"bearings\[0\] is \[2\.0, 0\.0\]; .* a unit vector"):
            robot.act([[2.0, 0.0]])

    def test_export_rejects_differing_file(self, monkeypatch, tmp_path, one_line):
        written = standalone.text_of

        def wrong(policy, scenario, network, build, own):
            weights, settings = network
            bias = weights["action_net.bias"] + 50.0 * np.arange(len(settings.angles))
            return written(policy, scenario, ({**weights, "action_net.bias": bias}, settings))

        monkeypatch.setattr(standalone, "text_of", wrong)
        said = one_line("export", "--standalone", tmp_path / "robot.py", "--checks", "60")
        assert "the file differs from the policy by" in said
        assert not list(tmp_path.iterdir())

    def test_compare_returns_nan_for_a_file_that_returns_nan(self, monkeypatch):
        broken = SimpleNamespace(act=lambda *_, **__: np.full(2, np.nan))
        monkeypatch.setattr(
            standalone, "load", lambda _: SimpleNamespace(RobotPolicy=lambda: broken)
        )
        robot = baselines.RobotPolicy("fig3", "bearing-only")
        assert np.isnan(standalone.compare(Path("robot.py"), robot, 2))


ALONE = """
import json, sys
sys.path.append(sys.argv[1])
for name in ("numba", "scipy", "rendezvous_env", "gymnasium"):
    try:
        __import__(name)
    except ImportError:
        continue
    raise SystemExit(name + " is there")
sys.path.append(sys.argv[2])
import robot
one = robot.RobotPolicy()
acted = [one.act(*seen, **told).tolist() for *seen, told in json.loads(sys.argv[3])]
print(json.dumps(acted))
"""


def test_standalone_file_runs_with_numpy_only(exported, tmp_path):
    """An isolated interpreter without site-packages, and a folder with NumPy only."""
    library, here = Path(np.__file__).parents[1], tmp_path / "library"
    here.mkdir()
    for name in ("numpy", "numpy.libs"):
        if (library / name).exists():
            (here / name).symlink_to(library / name)
    (tmp_path / "robot.py").write_bytes(exported("learned-tank").read_bytes())
    ticks = [
        [np.asarray(part).tolist() for part in seen] + [{"weights": told["weights"].tolist()}]
        for *seen, told in standalone.drawn_ticks(CLUTTER, 40)
    ]
    words = "-I", "-S", "-B", "-c", ALONE, here, tmp_path, json.dumps(ticks)
    done = run_python(tmp_path, *words)
    own = RobotPolicy(CLUTTER, "learned-tank")
    wanted = [own.act(*seen, **told) for *seen, told in ticks]
    np.testing.assert_allclose(json.loads(done.stdout), wanted, atol=1e-5)
    assert np.abs(wanted).max() > 0.3


@pytest.mark.parametrize("policy", first_fast(POLICIES, 2))
def test_standalone_file_imports_only_numpy(exported, policy):
    found = set()
    for node in ast.walk(ast.parse(exported(policy).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module.partition(".")[0])
    assert found - sys.stdlib_module_names == {"numpy"}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_modified_standalone_file_is_rejected(exported, tmp_path, seed):
    """Any byte of weights, equations, text, and of the line that checks the digest."""
    content, path = exported("learned-tank").read_bytes(), tmp_path / "robot.py"
    random, last = np.random.default_rng(seed), content.rstrip(b"\n").rfind(b"\n") + 1
    places = [*random.integers(0, len(content), 6 + 30 * seed), last, len(content) - 2]
    places += random.integers(last, len(content), 2 + 30 * seed).tolist()
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(random.integers(8)) if place != last else 0x6A  # "#"
        path.write_bytes(damaged)
        with pytest.raises(Exception, match=r"."):
            standalone.load(path).RobotPolicy()
    place = content.index(b"WEIGHTS = ") + 5000
    path.write_bytes(content[:place] + b"B" + content[place + 1 :])
    assert content[place : place + 1] != b"B"
    with pytest.raises(ValueError, match=r"robot\.py: its content was changed: its digest"):
        standalone.load(path)


AS = {
    "zip": "import sys; sys.path.insert(0, 'robots.zip')",
    "bytecode": "import sys; sys.path.insert(0, 'compiled')",
    "bytecode in a zip": "import sys; sys.path.insert(0, 'compiled.zip')",
    "run": "import runpy; sys = runpy.run_path('robot.py')",
}


@pytest.mark.parametrize("form", AS)
def test_the_file_drives_a_robot_wherever_python_finds_it(exported, tmp_path, form):
    path = tmp_path / "robot.py"
    path.write_bytes(exported("bearing-only").read_bytes())
    (tmp_path / "compiled").mkdir()
    py_compile.compile(str(path), cfile=str(tmp_path / "compiled/robot.pyc"), doraise=True)
    with zipfile.ZipFile(tmp_path / "robots.zip", "w") as archive:
        archive.write(path, "robot.py")
    with zipfile.ZipFile(tmp_path / "compiled.zip", "w") as archive:
        archive.write(tmp_path / "compiled/robot.pyc", "robot.pyc")
    if form != "run":
        path.unlink()
        ask = "import robot; made = robot.RobotPolicy()"
    else:
        ask = "made = sys['RobotPolicy']()"
    acts = "act = made.act([[1.0, 0.0]]); assert act.dtype == 'float64' and act[0] > 0; print(act)"
    done = run_python(tmp_path, "-I", "-c", f"{AS[form]}; {ask}; {acts}")
    assert "[" in done.stdout


def test_a_changed_file_in_a_zip_is_refused(exported, tmp_path):
    text = exported("bearing-only").read_text(encoding="utf-8")
    with zipfile.ZipFile(tmp_path / "robots.zip", "w") as archive:
        archive.writestr("robot.py", text.replace("n_robots=1,", "n_robots=1 ,", 1))
    ask = """
import sys
sys.path.insert(0, "robots.zip")
try:
    import robot
except ValueError as error:
    print(error)
"""
    done = run_python(tmp_path, "-I", "-c", ask)
    assert "robot.py: its content was changed: its digest" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--standalone", "robot.txt"], "--standalone robot.txt: unknown ending; it must be .py"),
        (["--standalone", "x.py", "--checks", "0"], "--checks is 0; it must be 1 or more"),
        (["--standalone", "x.py", "--policy", "tank-merged"], "is one of the rules under an ene"),
        (["--standalone", "x.py", "--policy", "learnt"], "did you mean 'learned'?"),
        (["--standalone", "x.py", "--scenario", "cluter-8"], "did you mean 'clutter-8'?"),
        (["--standalone", "x.py", "--scenario", "double.toml"], "a RobotPolicy steers single"),
        (
            ["--standalone", "x.py", "--policy", "os:getcwd"],
            "posix is not written in a Python file",
        ),
        (
            ["--standalone", "x.py", "--scenario", "mixed-8", "--policy", "by-model"],
            "(--robot i to",
        ),
        (["--standalone", "x.py", "--robot", "8"], "--robot 8: robot is 8; it must be an integer"),
        (["--standalone", "folder.py"], "--standalone folder.py: is a folder; name a file"),
        (["--standalone", "own.py"], "--standalone own.py: exists, and was not written by this"),
        (["--standalone", "own.py/x.py"], "--standalone own.py/x.py: cannot write there: "),
    ],
)
def test_unsupported_policy_is_one_line_error(words, message, one_line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.py").mkdir()
    (tmp_path / "own.py").write_text("print('mine')")
    (tmp_path / "double.toml").write_text('robot_model = "double_integrator"')
    assert message in one_line("export", *words)
    names = ["double.toml", "folder.py", "own.py"]
    assert sorted(path.name for path in tmp_path.rglob("*")) == names
    assert (tmp_path / "own.py").read_text() == "print('mine')"


def test_older_standalone_file_is_overwritten(exported, tmp_path):
    path = tmp_path / "robot.py"
    path.write_bytes(exported("bearing-only").read_bytes().replace(b"rendezvous-env ", b"old "))
    words = ["--policy", "tangent-merged", "--standalone", str(path), "--checks", "20"]
    assert cli.main(["export", *words]) == 0
    assert path.read_text(encoding="utf-8").startswith('"""The policy \'tangent-merged\'')


def test_standalone_file_handles_any_scenario_name(tmp_path):
    team, path = tmp_path / "team.toml", tmp_path / "robot.py"
    name = '"""; a "\\ team' + "z" * 150
    rv.Scenario(name=name, n_robots=3).to_toml(team)
    words = ["export", "--policy", "bearing-only", "--standalone", str(path), "--checks", "20"]
    for _ in range(2):
        assert cli.main([*words, "--scenario", str(team)]) == 0
    assert name in standalone.load(path).__doc__


@pytest.mark.slow
def test_standalone_file_of_long_path_is_recognised(exported, tmp_path):
    text, path = exported("learned").read_text(encoding="utf-8"), tmp_path / "robot.py"
    path.write_text(text.replace("'learned'", repr("learned:" + "far/" * 200), 1), encoding="utf-8")
    assert standalone.is_written(path)
    path.write_text('"""The policy is my own."""\n# not of `rendezvous export --standalone`')
    assert not standalone.is_written(path)


class TestBundle:
    def test_stand_ins_replace_words_that_exist(self):
        chosen = (standalone._OF_OTHER_DIMENSIONS, standalone._OF_OTHER_GUIDES)
        replaced = [*standalone._STAND_INS, *standalone._WITHOUT_BODIES]
        replaced += [name for tables in chosen for table in tables.values() for name in table]
        assert len(replaced) > 10
        for name in replaced:
            assert hasattr(import_module(name.module), name.word), name

    @pytest.mark.slow
    def test_bundle_includes_steering_and_disambiguates_names(self, exported):
        """The command compares file and policy on random ticks."""
        path = exported("learned-tank", "unicycle-6")
        assert "def gated_rates" in path.read_text(encoding="utf-8")
        file = standalone.load(path)
        assert sum(name.endswith("_turn") for name in vars(file)) > 1
        turn = getattr(file, "feature_kernels_turn", None) or vars(file)["_turn"]
        assert turn(np.array([1.0, 0.0]), np.array([0.0, 1.0])) == pytest.approx(np.pi / 2)

    def test_bundle_follows_attributes_of_modules(self, own, tmp_path):
        text = """
            import rendezvous_env as rv
            import rendezvous_env.safety as safety
            from rendezvous_env.physics import vectors
            def act(h, f):
                '''As vectors.dot.'''
                return vectors.dot(h, f), rv.certified_heading.__name__, safety.heading.NO_CAP
            """
        (tmp_path / "own_laws.py").write_text(textwrap.dedent(text), encoding="utf-8")
        standalone.add_module("own_laws")
        names: dict[str, Any] = {}
        bundle = Bundle([Name("own_laws", "act")], standalone._STAND_INS)
        exec(f"from __future__ import annotations\n{bundle.text()}", names)
        assert names["act"]((1.0, 2.0), (3.0, 4.0)) == (11.0, "certified_heading", -2.0)

    def test_bundle_rejects_module_as_value(self, own, tmp_path):
        text = "from rendezvous_env import baselines\ndef whole(scenario):\n    return baselines\n"
        (tmp_path / "own_laws.py").write_text(text, encoding="utf-8")
        standalone.add_module("own_laws")
        with pytest.raises(ValueError, match=r"own_laws\.whole uses the module rendezvous_env"):
            Bundle([Name("own_laws", "whole")], {}).text()


ARENA, TICK = np.array([1.6, 1.0]), 0.033
"""Half its size, m; time step, s."""
WHEEL, BASE, FASTEST = 0.016, 0.105, 12.5
"""Radius and distance of wheels, m; maximum wheel speed, rad/s."""
AHEAD, COLLISION, NEAR = 0.025, 0.135, 0.17
"""Offset of the collision point ahead of the axle, collision distance, and range of the proximity
sensors, m."""


def simulate(file, n, seed, seconds, careful=True):
    """Simulated Robotarium robots under a file: unicycles in Euler steps with clipped wheel speeds.

    Returns the numbers of collisions, exits and clipped wheels, the smallest distance, and the
    final diameter.
    """
    random, poses = np.random.default_rng(seed), np.zeros((0, 3))
    while len(poses) < n:
        drawn = random.uniform([-1.3, -0.75, -np.pi], [1.3, 0.75, np.pi])
        if len(poses) == 0 or np.hypot(*(poses - drawn).T[:2]).min() > 0.25:
            poses = np.vstack([poses, drawn])
    robots, drives = (
        [kind() for _ in range(n)] for kind in (file.RobotPolicy, file.DifferentialDrive)
    )
    errors, closest, pairs = np.zeros(3, int), np.inf, np.triu_indices(n, 1)
    for _ in range(round(seconds / TICK)):
        heads = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
        points = poses[:, :2] + AHEAD * heads
        offsets = points - points[:, np.newaxis]
        apart = np.linalg.norm(offsets, axis=-1)
        outside = (np.abs(poses[:, :2]) > ARENA).any(axis=1)
        errors[:2] += (apart[pairs] <= COLLISION).sum(), outside.sum()
        closest = min(closest, apart[pairs].min())
        for i in range(n):
            others = np.arange(n) != i
            bearings = offsets[i, others] / apart[i, others, np.newaxis]
            wanted = robots[i].act(bearings, [], TICK)
            if careful:
                wanted = file.keep_apart(wanted, bearings[apart[i, others] < NEAR])
            v, omega = drives[i].command(wanted, poses[i, 2], TICK)
            speeds = (v + np.array([-0.5, 0.5]) * BASE * omega) / WHEEL
            errors[2] += (np.abs(speeds) > FASTEST).any()
            left, right = np.clip(speeds, -FASTEST, FASTEST)
            v, omega = 0.5 * WHEEL * (left + right), WHEEL * (right - left) / BASE
            poses[i] += TICK * np.array([v * heads[i, 0], v * heads[i, 1], omega])
    return errors.tolist(), closest, apart.max()


@pytest.mark.slow
def test_robotarium_robots_pack_without_contact(exported):
    file = standalone.load(exported("bearing-only", "robotarium-4"))
    errors, closest, diameter = simulate(file, 4, seed=0, seconds=20.0)
    assert errors == [0, 0, 0] and closest > 0.15 and diameter < 0.34
    (collisions, _, wheels), *_ = simulate(file, 4, seed=0, seconds=20.0, careful=False)
    assert collisions > 100 and wheels == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "n"),
    [
        ("learned", 4),
        ("bearing-only", 20),
        slow("learned-tank", 4),
        slow("bearing-only", 10),
        slow("learned-tank", 10),
        slow("learned", 20),
    ],
)
def test_robotarium_scenarios_are_valid(exported, policy, n):
    wide = {4: 0.34, 10: 0.75, 20: 1.25}[n]
    file = standalone.load(exported(policy, f"robotarium-{n}"))
    errors, closest, diameter = simulate(file, n, 1, seconds=20.0)
    assert errors == [0, 0, 0] and closest > 0.15
    assert diameter < wide or policy == "learned-tank"  # which takes its time


HELPER = """
import numpy as np


def unit(f):
    return f / np.maximum(np.linalg.norm(f, axis=-1, keepdims=True), 1e-9)
"""
OWN = """
import numpy as np
from baselines import HeadingPolicy
from own_helper import unit

SHARE = 0.9


def net_bearing(seen, scenario):
    return seen[..., : scenario.observation_layout.neighbour_slots, :].sum(axis=-2)


def law(scenario):
    def act(seen, time):
        return (0.5 * net_bearing(seen, scenario)).astype(np.float32)

    return act


class Smooth:
    def __init__(self, scenario):
        self.scenario = scenario
        self.reset()

    def reset(self, mask=None):
        self.last = 0.0

    def __call__(self, seen, time):
        speed = SHARE * self.scenario.speed_limit
        self.last = 0.5 * self.last + 0.5 * speed * unit(net_bearing(seen, self.scenario))
        return self.last.astype(np.float32)


def certified(scenario):
    return HeadingPolicy(scenario, lambda seen: net_bearing(seen, scenario))


def by_size(scenario):
    return lambda seen, time: (net_bearing(seen, scenario) / scenario.n_robots).astype(np.float32)


def by_room(scenario):
    return lambda seen, time: net_bearing(seen, scenario) / scenario.spawn_size


def with_scipy(scenario):
    return lambda seen, time: expm(net_bearing(seen, scenario))


from scipy.linalg import expm  # noqa: E402
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A user's file with a helper module, in the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, text in (("own_helper", HELPER), ("own_laws", OWN)):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    yield
    for name in ("own_helper", "own_laws"):
        sys.modules.pop(name, None)


@pytest.mark.slow
@pytest.mark.parametrize("function", ["law", "Smooth", "certified"])
def test_a_law_of_a_users_own_file_stands_in_one_file(own, function, tmp_path):
    words = ["--policy", f"own_laws:{function}", "--standalone", "robot.py", "--checks", "200"]
    assert cli.main(["export", *words, "--scenario", "clutter-12"]) == 0
    made = policies.make(f"own_laws:{function}", CLUTTER)
    robot, file = RobotPolicy(CLUTTER, made), standalone.load(tmp_path / "robot.py").RobotPolicy()
    for *seen, told in standalone.drawn_ticks(CLUTTER, 50):
        np.testing.assert_allclose(file.act(*seen, **told), robot.act(*seen, **told), atol=1e-6)
    script = "import robot; print(robot.RobotPolicy().act([[1.0, 0.0]]))"
    for name in ("own_helper", "own_laws"):
        (tmp_path / f"{name}.py").unlink()
    assert "[" in run_python(tmp_path, "-c", script).stdout


@pytest.mark.parametrize(
    ("function", "message"),
    [
        slow(
            "by_size",
            "the file differs from the policy by .* In one file a scenario has n_robots =",
        ),
        slow("by_room", "no attribute 'spawn_size'. In one file a scenario has n_robots = 1"),
        ("with_scipy", "it imports scipy; a standalone file may use NumPy only"),
    ],
)
def test_a_law_that_needs_more_is_refused(own, function, message, one_line, tmp_path):
    said = one_line("export", "--policy", f"own_laws:{function}", "--standalone", "robot.py")
    assert re.search(message, said), said
    assert not (tmp_path / "robot.py").exists()
