"""The command line, as a user meets it."""

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import baselines
from baselines import policy
from rendezvous_env.experiment import scenarios
from train import cli, results

SCRIPT = Path(sys.executable).with_name("rendezvous")


def run(*words):
    """Exit status of a command run in this process."""
    try:
        return cli.main(words)
    except SystemExit as end:
        return end.code


class TestMistakes:
    @pytest.mark.parametrize(
        ("flags", "message"),
        [
            (["--scenarios", "fig5"], "did you mean 'fig4'"),
            (["--scenarios", "no-such.toml"], "no-such.toml"),
            (["--scenarios"], "names none"),
            (["--scenarios", "duo", "duo"], "two scenarios"),
            (["--policies", "bearing-onyl"], "did you mean 'bearing-only'"),
            (["--policies", "foo"], "'foo' is unknown; known are bearing-only"),
            (["--scenarios", "duo", "--policies", "unicycle"], "no policy of those named fits duo"),
            (["--episodes", "0"], "--episodes is 0"),
            (["--seed", "-1"], "--seed is -1"),
            (["--seed", str(2**63)], "too large"),
            (["--keep", "-1"], "--keep is -1"),
        ],
    )
    def test_one_line_and_status_2(self, flags, message, capsys, tmp_path):
        assert run("compare", "--out", str(tmp_path / "out"), *flags) == 2
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1 and "Traceback" not in said
        assert not (tmp_path / "out").exists()

    def test_unwritable_folder(self, tmp_path, capsys):
        (tmp_path / "file").write_text("")
        assert run("compare", "--scenarios", "duo", "--out", str(tmp_path / "file" / "out")) == 2
        assert "cannot write there" in capsys.readouterr().err

    def test_no_room_for_a_start(self, tmp_path, capsys):
        path = tmp_path / "crowd.toml"
        path.write_text('name = "crowd"\nn_robots = 30\nspawn_size = 0.5\n')
        flags = ["--policies", "zero", "--out", str(tmp_path / "out")]
        assert run("compare", "--scenarios", str(path), *flags) == 2
        assert "crowd: no room for the start" in capsys.readouterr().err

    @pytest.mark.parametrize("words", [[], ["compair"], ["compare", "--episode", "many"]])
    def test_usage(self, words, capsys):
        assert run(*words) == 2

    def test_policy_that_does_not_fit_a_figure(self, tmp_path, capsys):
        assert run("reproduce", "fig3", "--policy", "unicycle", "--out", str(tmp_path)) == 2
        assert "does not fit" in capsys.readouterr().err


def test_interrupt(monkeypatch, capsys, tmp_path):
    from train.comparing import playing

    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(playing, "play", interrupted)
    assert run("compare", "--scenarios", "duo", "--out", str(tmp_path)) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_every_command_has_a_config_and_help(capsys):
    for name in cli.COMMANDS:
        assert run(name, "--help") == 0
        assert f"rendezvous {name}" in capsys.readouterr().out


class TestList:
    def lines(self, what, capsys):
        assert run("list", what) == 0
        return " ".join(capsys.readouterr().out.split())

    def test_every_scenario_is_described(self, capsys):
        said = self.lines("scenarios", capsys)
        for name in scenarios.names():
            assert f"{name} {scenarios.get(name).n_robots} robots" in said
        assert "3 fixed obstacles, which robots pass through, one start" in said
        assert "random tree graph with gains of 0.5 to 2 m/s" in said
        assert "rooms 5 robots in the plane, complete graph, rooms of drawn walls" in said
        assert "complete graph, sensing with noise = 0.3, dropout = 0.1" in said

    def test_every_policy_has_its_line_and_its_scenarios(self, capsys):
        said = self.lines("policies", capsys)
        for name in baselines.names():
            assert f"{name} {policy.about(name).split(':')[0]}" in said and policy.about(name)
        assert "Fits unicycle-6, fov-8, " in said and "random Actions drawn" in said
        assert "law (1) would go, with friction; not of the paper. Fits none of" in said
        assert said.index("tangent ") < said.index("privileged-planner ") < said.index("zero ")

    def test_what_else_there_is(self):
        assert run("list", "robots") == 2


def test_version(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"rendezvous {metadata.version('rendezvous-env')}\n"


def test_completion_knows_every_command_and_flag(tmp_path, capsys):
    assert run("--completion", "bash") == 0
    script = capsys.readouterr().out
    assert all(f"--{flag}" in script for flag in ("ceiling", "against", "total-steps"))
    path = tmp_path / "completion.bash"
    path.write_text(script)
    code = f"source {path}; complete -p rendezvous"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.startswith("complete -F"), done.stderr
    assert run("--completion", "ksh") == 2


class TestReproduce:
    @pytest.mark.parametrize("figure", ["fig3", "fig4"])
    def test_writes_picture_and_data(self, figure, tmp_path):
        assert run("reproduce", figure, "--out", str(tmp_path)) == 0
        written = {path.name for path in tmp_path.iterdir()}
        assert written == {f"{figure}.{suffix}" for suffix in ("png", "pdf", "npz", "csv")}
        with np.load(tmp_path / f"{figure}.npz") as data:
            value, before = data["lyapunov"], data["lyapunov_before_merge"]
            after = data["lyapunov_after_merge"]
            ends = np.where(np.isnan(before), value, before)
            assert (ends[1:] <= value[:-1]).all()  # between merges V falls
            jumps = ~np.isnan(before)
            assert jumps.sum() == 2 and (after[jumps] < before[jumps]).all()
            assert data["contacts"].sum() == 0 and data["active"][-1].sum() == 1
        rows = results.read_csv(tmp_path / f"{figure}.csv")
        assert [float(row["lyapunov"]) for row in rows] == value.tolist()
        assert [row["robots"] for row in rows][-1] == "1.0"

    def test_fig3_goes_through_and_fig4_round_every_obstacle(self, tmp_path):
        from rendezvous_env.equations.shapes.obstacles import distance_to
        from rendezvous_env.experiment.packing import world_of

        depths = {}
        for figure in ("fig3", "fig4"):
            run("reproduce", figure, "--out", str(tmp_path))
            with np.load(tmp_path / f"{figure}.npz") as data:
                world, places = world_of(data["obstacles"]), data["positions"].reshape(-1, 2)
                depths[figure] = [
                    min(distance_to(world, m, (x, y, 0.0)) for x, y in places.tolist())
                    for m in range(len(data["obstacles"]))
                ]
        assert max(depths["fig3"]) < -0.2 and min(depths["fig4"]) > -1e-6

    def test_the_figure(self, tmp_path):
        from matplotlib.colors import to_rgb
        from matplotlib.image import imread

        from rendezvous_env import rollout
        from rendezvous_env.experiment import scenarios
        from train import policies
        from train.pictures import figures, path_figures, reproduce, style

        scenario = scenarios.get("fig4")
        recording = reproduce.one_team(rollout(scenario, policies.make("tangent-joined", scenario)))
        figure = path_figures.team_figure(scenario, recording, "tangent-joined")
        paths, value = figure.axes[:2]
        assert paths.get_aspect() == 1 and len(paths.patches) == 3
        assert paths.get_xlabel() == "x / m" and value.get_ylabel() == "V / (m²/s)"
        assert {patch.get_facecolor()[:3] for patch in paths.patches} == {to_rgb(figures.ORANGE)}
        style.save(figure, tmp_path / "figure.png")
        pixels = imread(tmp_path / "figure.png")[..., :3]
        orange = np.abs(pixels - to_rgb(figures.ORANGE)).max(axis=-1) < 0.02
        assert pixels.shape[1] == 700 and 0.005 < orange.mean() < 0.2


class TestInstalled:
    def test_runs_beside_a_train_py(self, tmp_path):
        (tmp_path / "train.py").write_text("raise RuntimeError('the wrong train')")
        flags = ["--scenarios", "duo", "--episodes", "2", "--no-figures"]
        done = subprocess.run(
            [SCRIPT, "compare", *flags], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        assert "bearing-only" in done.stdout and "Traceback" not in done.stderr
        assert (tmp_path / "out" / "compare" / "results.csv").exists()

    def test_loads_no_torch_and_no_drawing(self, tmp_path):
        code = (
            "import sys, train.cli as c; c.main(['compare', '--scenarios', 'duo', '--episodes', "
            "'2', '--no-figures', '--policies', 'bearing-only', 'random']); import os; "
            "assert os.environ['OMP_WAIT_POLICY'] == 'PASSIVE'; "
            "bad = {'torch', 'stable_baselines3', 'matplotlib', 'pygame'} & set(sys.modules); "
            "assert not bad, bad"
        )
        environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr

    def test_help_loads_nothing_heavy(self):
        code = (
            "import sys, train.cli as c\n"
            "try: c.main(['--help'])\n"
            "except SystemExit: pass\n"
            "assert not {'numba', 'numpy', 'tyro', 'torch'} & set(sys.modules)"
        )
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, timeout=60)
