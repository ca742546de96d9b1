"""``rendezvous reproduce bounds``: certified over simulated times, in docs."""

import pytest
from conftest import ROOT

import rendezvous_env as rv
from train.cli import main
from train.figures import bounds
from train.results import read_csv

FEW = (("law", "complete-3"), ("tank", "complete-3"))


@pytest.fixture(scope="module")
def rows():
    return list(bounds.measure(FEW, teams=6, seed=0))


def test_teams_meet_within_their_bounds(rows):
    for row in rows:
        assert set(row) == set(bounds.COLUMNS)
        assert 0 < row["median"] <= row["longest"] < row["own_bound"] < row["bound"]
        assert row["ratio"] == row["own_bound"] / row["median"] > 1
    law = rv.certificate(rv.Scenario(n_robots=3))
    assert rows[0]["bound"] == law.time_bound


def test_command_writes_table_and_page(rows, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bounds, "ROWS", FEW)
    table, page = bounds.table_of(rows), tmp_path / "page.md"
    page.write_text("\n".join(["# A", "", *table[:2], "| old | row |", "", "after"]))
    flags = ["reproduce", "bounds", "--episodes", "6", "--out", str(tmp_path), "--page", str(page)]
    assert main(flags) == 0
    assert page.read_text().split("\n") == ["# A", "", *table, "", "after"]
    assert table[3] in capsys.readouterr().out
    assert [row["by"] for row in read_csv(tmp_path / "bounds.csv")] == ["law", "tank"]
    page.write_text("no table")
    assert main(flags) == 2 and page.read_text() == "no table"
    assert main([*flags[:2], "--policy", "zero"]) == 2


def test_page_shows_current_bounds():
    head, rule, *_ = bounds.table_of([])
    lines = (ROOT / "docs/guarantees.md").read_text(encoding="utf-8").split("\n")
    first = lines.index(head)
    assert lines[first + 1] == rule
    for (by, graph), line in zip(bounds.ROWS, lines[first + 2 :], strict=False):
        margin = 0.1 if by in ("heading", "tank") else 1.0
        found = rv.certificate(bounds.scenario_of(graph), margin, by=by)
        _, kept_by, team, _, _, bound, *_ = (cell.strip() for cell in line.split("|"))
        assert kept_by.startswith(by) and team == graph
        assert float(bound.replace(",", "")) == pytest.approx(found.time_bound, rel=0.005)
