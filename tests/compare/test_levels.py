"""``compare --sensing``: equal initial conditions at every level of a sensor field."""

import pytest
from matplotlib.image import imread

import rendezvous_env as rv
from rendezvous_env.scenario import scenarios
from train import cli, results
from train.compare import sweep as levels

DUO = scenarios.get("duo")


class TestLevels:
    def test_sweep_scenarios_differ_in_one_field(self):
        words = ["noise=0,0.25", "range=none,4,2.5", "occlusion=none,robots"]
        noise, sight, hidden = levels.sweeps([DUO], words)
        assert noise.levels == (0, 0.25) and noise.labels == ["0", "0.25"]
        assert sight.levels == (None, 4, 2.5) and sight.labels == ["none", "4", "2.5"]
        assert noise.scenarios[0] is sight.scenarios[0] is DUO
        assert noise.scenarios[1].sensing == rv.Sensing(noise=0.25)
        assert [one.name for one in sight.scenarios] == ["duo", "duo-range-4", "duo-range-2.5"]
        assert sight.scenarios[2].replace(name="duo", sensing=rv.Sensing()) == DUO
        assert [one.sensing.occlusion for one in hidden.scenarios] == ["none", "robots"]

    def test_sweep_keeps_other_sensor_fields(self):
        blurred = DUO.replace(sensing=rv.Sensing(noise=0.1, delay=2))
        (sweep,) = levels.sweeps([blurred], ["dropout=0,0.5"])
        assert sweep.scenarios[0] is blurred
        assert sweep.scenarios[1].sensing == rv.Sensing(noise=0.1, delay=2, dropout=0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("levels") / "out"
    words = ["--scenarios", "duo", "--policies", "bearing-only", "zero", "--episodes", "4"]
    sensing = ["--sensing", "range=none,3", "dropout=0,1"]
    assert cli.main(["compare", *words, *sensing, "--pdf", "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_levels_csv_has_row_per_level(folder):
    rows = results.read_csv(folder / "levels.csv")
    assert [(row["field"], row["level"], row["policy"]) for row in rows] == [
        (field, level, policy)
        for field, level in (("range", ""), ("range", "3"), ("dropout", "0"), ("dropout", "1"))
        for policy in ("bearing-only", "zero")
    ]
    found = {(row["field"], row["level"], row["policy"]): float(row["success"]) for row in rows}
    assert found["range", "", "bearing-only"] == found["dropout", "0", "bearing-only"] == 1.0
    assert found["dropout", "1", "bearing-only"] == 0.0  # who sees nobody stays
    by_name = {(r["scenario"], r["policy"]): r for r in results.read_csv(folder / "results.csv")}
    assert {name for name, _ in by_name} == {"duo", "duo-range-3", "duo-dropout-1"}
    for row in rows:
        own = by_name[row["scenario"], row["policy"]]
        assert all(row[name] == own[name] for name in results.RESULT_COLUMNS)


def test_level_figure_exists_per_field(folder):
    for field in ("range", "dropout"):
        assert imread(folder / f"levels-duo-{field}.png")[..., :3].std() > 0.05
        assert (folder / f"levels-duo-{field}.pdf").stat().st_size > 5000


def test_sweep_tables_replace_matrix(tmp_path, capsys):
    words = ["--scenarios", "duo", "--policies", "bearing-only", "--episodes", "3", "--no-figures"]
    assert cli.main(["compare", *words, "--sensing", "noise=0,0.2", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert (
        "duo: noise, 3 episodes" in said and "100, " in said and "collision-free, %  " not in said
    )
