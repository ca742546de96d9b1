"""Command line interface."""

import importlib
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import tyro
from conftest import ROOT, run_python
from parameters import slow

import baselines
from baselines import policy
from rendezvous_env.obstacles.obstacle_set import distance_to, world_of
from rendezvous_env.scenario import scenarios
from train import cli, results, tasks
from train.checks import UserError
from train.compare import Config
from train.listing import columns_of
from train.policies import resolve_scenario


def run(*words):
    """Exit status of a command run in this process."""
    try:
        return cli.main(words)
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize("words", [[], ["compair"], ["compare", "--episode", "many"]])
def test_usage_errors_exit_with_status_2(words):
    assert run(*words) == 2


@pytest.mark.slow
def test_output_works_without_unicode_terminal():
    words = "-m", "train.cli", "list", "policies"
    said = run_python(ROOT, *words, PYTHONIOENCODING="ascii").stdout
    assert said.isascii() and r"\u03c9" in said


@pytest.mark.slow
def test_broken_pipe_does_not_stop_command(tmp_path):
    words = "-m train.cli compare --scenarios duo --policies zero --episodes 1 --no-figures"
    words = [sys.executable, *words.split(), "--details", "--out", tmp_path / "out"]
    command = subprocess.Popen(words, stdout=subprocess.PIPE)
    command.stdout.close()
    assert command.wait(120) == 0
    assert (tmp_path / "out" / "run.json").exists()


class TestHelp:
    @pytest.mark.parametrize("name", cli.COMMANDS)
    def test_help_describes_every_flag(self, name, capsys):
        assert run(name, "--help") == 0
        said = capsys.readouterr().out
        assert said.startswith(f"usage: rendezvous {name}") and "{None}" not in said
        for flag, told in re.findall(r"^  (--[^ ,\n]+|[A-Z]+)[^\n]*\n((?: {6}.*\n?)+)", said, re.M):
            text = " ".join(told.split())
            assert text[0].isupper() or text.startswith(("λ", "ε")), flag
            assert text.endswith((".", "…")), flag

    def test_help_shows_examples_and_groups(self, capsys):
        assert run("compare", "--help") == 0
        said = capsys.readouterr().out
        assert "  rendezvous compare --scenario clutter-8 trap" in said
        assert said.index("\nFlags:\n") < said.index("\nOutput:\n") < said.index("\nWorkers:\n")
        for flags in (
            "--overwrite, --fresh\n",
            "--keep-trajectories, --keep INTEGER\n",
            "--oracle-runs, --ceiling INTEGER\n",
            "--backend, --on {here,ray}\n",
        ):
            assert flags in said

    def test_help_examples_parse(self):
        for name, (module, _) in cli.COMMANDS.items():
            config = importlib.import_module(f"train.{module}").Config
            for words in getattr(sys.modules[config.__module__], "EXAMPLES", ()):
                assert tyro.cli(config, args=words.split()), (name, words)


@pytest.mark.slow
def test_names_and_paths_are_not_markup(tmp_path, monkeypatch, capsys):
    """Every command prints names unchanged."""
    monkeypatch.chdir(tmp_path)
    policy, scenario, out = "runs/[s1]", "m[red]:cat:", "o[/b]"
    shutil.copytree(Path(baselines.__file__).parent / "learned" / "pretrained", policy)
    Path("m.toml").write_text(f'name = "{scenario}"\ntime_limit = 1.0\n')
    both = ("--scenario", "m.toml", "--policy", f"learned:{policy}")
    words = ("--episodes", 2, "--no-figures", "--jobs", 1, "--details", "--out", out)
    for command, shown in (
        (("compare", *both, "zero", *words, "--against", "zero"), (scenario, policy, out)),
        (("report", out), (f"{out}/report.html",)),
        (("render", *both, "--out", f"{out}.png", "--set", "n_robots=2"), (policy, f"{out}.png")),
        (("verify", "--trials", 3, "--jobs", 1, "--out", out + "v"), (f"{out}v/verify.csv",)),
    ):
        assert run(*map(str, command)) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert all(one in said for one in shown), said


@pytest.mark.parametrize(
    ("command", "old", "new"),
    [
        ("train", "--eval-starts 7", "--eval-episodes 7"),
        ("train", "--eval_starts=7", "--eval-episodes=7"),
        ("train", "--num-teams 3 --touch-penalty 0.5", "--num-envs 3 --contact-penalty 0.5"),
        ("leaderboard", "--tier smoke --starts 9", "--tier smoke --episodes 9"),
    ],
)
def test_former_flags_warn_once_and_are_hidden(command, old, new, monkeypatch, capsys):
    module, given = importlib.import_module(f"train.{cli.COMMANDS[command][0]}"), []
    monkeypatch.setattr(module, "run", given.append)
    assert run(command, *old.split()) == 0
    said = capsys.readouterr().err.splitlines()
    assert run(command, *new.split()) == 0
    assert given[0] == given[1] and not capsys.readouterr().err
    flags = [word.partition("=")[0] for word in old.split() if word.startswith("--")]
    renamed = [flag for flag in flags if flag not in new]
    assert [line.split()[1] for line in said] == renamed and "is called --" in said[0]
    assert run(command, "--help") == 0
    assert not set(renamed) & set(re.findall(r"--[\w-]+", capsys.readouterr().out))


def test_former_policy_names_warn(monkeypatch, capsys):
    given = []
    monkeypatch.setattr(importlib.import_module("train.compare.compare"), "run", given.append)
    assert run("compare", "--policies", "tank-joined", "best=tangent-joined-tuned", "learned") == 0
    assert capsys.readouterr().err.splitlines() == [
        "warning: policy 'tank-joined' is called 'tank-merged' now",
        "warning: policy 'tangent-joined-tuned' is called 'tangent-merged-tuned' now",
    ]
    assert given[0].policies == ("tank-merged", "best=tangent-merged-tuned", "learned")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("compare", "--policies tank-merged --out tank-joined"),
        ("train", "--out=tank-joined"),
        ("leaderboard", "--tier smoke --out tank-joined"),
    ],
)
def test_paths_like_former_policy_names_are_kept(command, words, monkeypatch, capsys):
    module, given = importlib.import_module(f"train.{cli.COMMANDS[command][0]}"), []
    monkeypatch.setattr(module, "run", given.append)
    assert run(command, *words.split()) == 0
    assert given[0].out == Path("tank-joined") and not capsys.readouterr().err


def test_old_flag_names_are_accepted(monkeypatch):
    monkeypatch.setattr(tasks, "check_installed", lambda *needs: None)
    old = "--scenarios duo --policies zero --fresh --keep 2 --ceiling 3 --on ray"
    new = "--scenario duo --policy zero --overwrite --keep-trajectories 2 --oracle-runs 3 "
    new += "--backend ray"
    assert tyro.cli(Config, args=old.split()) == tyro.cli(Config, args=new.split()) != Config()


def test_set_overrides_scenario_fields():
    found = resolve_scenario("clutter-8", ("n_robots=3", "graph=cycle"))
    assert (found.n_robots, found.name) == (3, "clutter-8-n-robots-3-graph-cycle")
    assert found.sensing_graph.kind == "cycle"
    assert resolve_scenario("duo") == scenarios.get("duo")
    with pytest.raises(UserError, match="no field 'speed_limit'; did you mean 'max_speed'"):
        resolve_scenario("duo", ("speed_limit=1",))
    with pytest.raises(UserError, match=r"--set sensing.noise=0.1: write sensing={noise=0.1}"):
        resolve_scenario("duo", ("sensing.noise=0.1",))


@pytest.mark.parametrize("step", [1e-9, 6e8])
def test_compare_accepts_any_time_step(step, tmp_path):
    """Kernels are compiled in two steps of the scenario itself, for any step length."""
    limit = min(3 * step, 1e9)  # the longest time that a scenario takes
    words = ["--policy", "zero", "--episodes", "1", "--no-figures", "--out", str(tmp_path / "out")]
    words += ["--set", f"time_step={step}", f"time_limit={limit}", "allow_long_step=true"]
    assert run("compare", "--scenario", "duo", *words) == 0


class TestList:
    def lines(self, what, capsys):
        assert run("list", what) == 0
        return " ".join(capsys.readouterr().out.split())

    def test_list_describes_every_scenario(self, capsys):
        said = self.lines("scenarios", capsys)
        for name in scenarios.names():
            assert f"{name} {scenarios.get(name).n_robots} robots" in said
        assert "3 fixed obstacles, which robots pass through, given initial condition" in said
        assert "random tree graph with gains of 0.5 to 2 m/s" in said
        assert "rooms 5 robots in the plane, complete graph, rooms of drawn walls" in said
        assert "complete graph, sensing with noise = 0.3, dropout = 0.1" in said

    def test_list_shows_every_policy_with_scenarios(self, capsys):
        said = self.lines("policies", capsys)
        fitting = {name: baselines.names(scenarios.get(name)) for name in scenarios.names()}
        columns = columns_of(fitting)
        assert sorted(name for own in columns.values() for name in own) == sorted(fitting)
        for name in baselines.names():
            marks = ["●" if name in fitting[own[0]] else "·" for own in columns.values()]
            about = policy.about(name).split(":")[0]
            assert f"{name} {' '.join(marks)} {about}" in said and about
        for letter, own in columns.items():
            assert f"{letter} {', '.join(own)}" in said
            assert len({tuple(fitting[scenario]) for scenario in own}) == 1
        assert said.index("tangent ") < said.index("privileged-planner ") < said.index("zero ")

    def test_list_shows_other_objects(self, capsys):
        assert run("list", "robots") == 2
        both = self.lines("scenarios", capsys), self.lines("policies", capsys)
        assert run("list") == 0
        assert " ".join(capsys.readouterr().out.split()) == " ".join(both)


def test_version_is_printed(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"rendezvous {metadata.version('rendezvous-env')}\n"


def test_completion_covers_all_commands_and_flags(tmp_path, capsys):
    assert run("--completion", "bash") == 0
    script = capsys.readouterr().out
    assert all(f"--{flag}" in script for flag in ("oracle-runs", "against", "total-steps"))
    path = tmp_path / "completion.bash"
    path.write_text(script)
    code = f"source {path}; complete -p rendezvous"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.startswith("complete -F"), done.stderr
    assert run("--completion", "ksh") == 2


@pytest.mark.parametrize(("figure", "through"), [("fig3", True), slow("fig4", False)])
def test_reproduce_writes_figure_and_data(figure, through, tmp_path):
    """Robots pass through obstacles in figure 3, and around them in figure 4."""
    assert run("reproduce", figure, "--out", str(tmp_path)) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {f"{figure}.{suffix}" for suffix in ("png", "pdf", "npz", "csv")}
    with np.load(tmp_path / f"{figure}.npz") as found:
        data = dict(found)
    names = ("lyapunov", "lyapunov_before_merge", "lyapunov_after_merge")
    value, before, after = (data[name] for name in names)
    jumps = ~np.isnan(before)
    assert (np.where(jumps, before, value)[1:] <= value[:-1]).all()  # between merges V falls
    assert jumps.sum() == 2 and (after[jumps] < before[jumps]).all()
    assert data["contacts"].sum() == 0 and data["active"][-1].sum() == 1
    rows = results.read_csv(tmp_path / f"{figure}.csv")
    assert [float(row["lyapunov"]) for row in rows] == value.tolist()
    assert [row["robots"] for row in rows][-1] == "1.0"
    world, places = world_of(data["obstacles"]), data["positions"].reshape(-1, 2)
    for m in range(len(data["obstacles"])):
        least = min(distance_to(world, m, (x, y, 0.0)) for x, y in places.tolist())
        assert least < -0.2 if through else least > -1e-6


@pytest.mark.parametrize(
    ("words", "heavy"),
    [
        ("--help", {"numba", "numpy", "tyro", "torch"}),
        slow("compare --scenarios duo --episodes 2 --no-figures --policies bearing-only random",
             {"torch", "stable_baselines3", "matplotlib", "pygame"}),
        slow("render --out a.png", {"pygame", "torch"}),
        slow("render --size 120 --fps 5 --speed 2 --out a.gif", {"torch", "matplotlib.pyplot"}),
    ],
)  # fmt: skip
def test_command_imports_nothing_heavy(words, heavy, tmp_path, monkeypatch):
    code = (
        "import os, sys, train.cli as c\n"
        f"try: assert c.main({words.split()}) == 0\n"
        "except SystemExit: pass\n"
        f"bad = {heavy} & set(sys.modules)\n"
        "assert not bad, bad\n"
        "assert os.environ['OMP_WAIT_POLICY'] == 'PASSIVE'"
    )
    monkeypatch.delenv("OMP_WAIT_POLICY")
    run_python(tmp_path, "-c", code)
