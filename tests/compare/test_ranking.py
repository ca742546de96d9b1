"""Ranking of ``compare``: winners, ties, and their display."""

import io
import json
import re

import numpy as np
import pytest
from rich.console import Console

from rendezvous_env import graphs
from rendezvous_env.scenario import scenarios
from train.compare import compare, ranking, statistics, tables
from train.compare.evaluation import Episodes
from train.compare.playing import Played
from train.compare.settings import Job

STARTS = 200


def played(scenario, policy, clean, time=5.0):
    """Synthetic episodes, collision-free on the given fraction, the first ones."""
    hits = clean if isinstance(clean, np.ndarray) else np.arange(STARTS) < clean * STARTS
    count = len(hits)
    values = dict.fromkeys(Episodes.__dataclass_fields__, np.zeros(count))
    values |= {"success": np.ones(count, bool), "collision_free": hits.astype(float)}
    values |= {"time": np.full(count, time), "time_bound": np.full(count, 10.0)}
    return Played(Job(scenarios.get(scenario), policy), Episodes(**values), [])


def shown(table, width=tables.WIDTH):
    """Printed table, or printed matrix of rankings."""
    console = Console(file=io.StringIO(), width=width)
    tables.show_matrix(table, console) if isinstance(table, list) else console.print(table)
    return console.file.getvalue()


class TestRanking:
    def test_best_has_most_collision_free_success_then_least_time(self):
        own = [played("fig4", "tangent", 0.5, 1.0), played("fig4", "tangent-merged", 0.9, 9.0)]
        [found] = ranking.rank([*own, played("fig4", "bearing-only", 0.9, 3.0)])
        assert found.best == "bearing-only" and found.tied == ("tangent-merged",)
        assert found.share["tangent"] == 0.5 and found.count == STARTS

    @pytest.mark.parametrize(("worse", "tied"), [(0, True), (2, True), (8, False)])
    def test_tie_is_paired_interval_containing_zero(self, worse, tied):
        """Numbers of failures out of 200; two of them are within statistical error."""
        best = np.arange(STARTS) < 150
        other = best & (np.arange(STARTS) >= worse)
        pair = [played("fig4", "tangent", best, 1.0), played("fig4", "tangent-merged", other, 2.0)]
        [found] = ranking.rank(pair)
        assert (found.tied == ("tangent-merged",)) == tied
        difference, (low, high) = statistics.collision_free_difference(
            pair[1].episodes, pair[0].episodes
        )
        assert difference == -worse / STARTS and low <= difference <= high

    def test_single_initial_condition_is_not_ranked_by_interval(self):
        one, none = np.ones(1, bool), np.zeros(1, bool)
        names = {"tangent": one, "tangent-merged": one, "bearing-only": none}
        [found] = ranking.rank([played("fig4", name, hit) for name, hit in names.items()])
        assert found.top == ("tangent", "tangent-merged")

    def test_one_episode_of_a_random_scenario_decides_nothing(self):
        one, none = np.ones(1, bool), np.zeros(1, bool)
        pair = [played("clutter-8", "tangent", one), played("clutter-8", "bearing-only", none)]
        (found,) = ranking.rank(pair)
        assert found.best is None and not found.is_contest and found.tied == ()
        assert ranking.answer([found]) == (
            "No ranking: one episode of a random scenario is not conclusive; use more --episodes."
        )
        text = shown([found], 80)
        assert "*" not in text and "clutter-8: one episode is not conclusive" in text
        (only,) = ranking.rank(pair[:1])
        assert only.undecided == "" and "conclusive" not in shown([only], 80)

    def test_nobody_is_best_with_0_per_cent(self):
        pair = [played("clutter-8", name, 0.0) for name in ("tangent", "bearing-only")]
        (found,) = ranking.rank(pair)
        assert found.best is None and found.tied == () and not found.is_contest
        assert ranking.leaders([found]) == []
        said = ranking.answer([found])
        assert said == "No ranking: no policy met without a collision in any episode."
        text = shown([found], 80)
        assert "*" not in text and "=" not in text and "clutter-8: no policy met" in text

    def test_a_scenario_without_a_best_does_not_count(self):
        lost = [played("clutter-4", name, 0.0) for name in ("tangent", "bearing-only")]
        won = [played("clutter-8", "tangent", 0.9), played("clutter-8", "bearing-only", 0.1)]
        found = ranking.rank([*lost, *won])
        said = "tangent leads in collision-free success: best, or tied with the best, in the one "
        assert ranking.answer(found) == said + "scenario with a choice."

    @pytest.mark.parametrize(("starts", "tied"), [(2, True), (3, True), (4, False)])
    def test_few_unanimous_samples_may_be_chance(self, starts, tied):
        """Wilson's lower end for 4 of 4 is 4/(4 + 1.96²) = 0.51: more than half."""
        hits = {"tangent": np.ones(starts, bool), "bearing-only": np.zeros(starts, bool)}
        pair = {name: played("fig4", name, hit) for name, hit in hits.items()}
        [found] = ranking.rank(list(pair.values()))
        assert (found.top == ("tangent", "bearing-only")) == tied
        shares = {name: one.episodes for name, one in pair.items()}
        (row,) = statistics.compare_pairs("fig4", shares)
        low = starts / (starts + 1.959964**2)
        ends = [row["collision_free_difference_low"], row["collision_free_difference_high"]]
        ends += [row["improvement_low"], row["improvement_high"]]
        assert ends == pytest.approx([2 * low - 1, 1, low, 1])

    def test_equal_policies_may_differ_elsewhere(self):
        one = played("fig4", "tangent", 0.5).episodes
        difference, ends = statistics.collision_free_difference(one, one)
        rest = 1.959964**2 / (STARTS + 1.959964**2)
        assert difference == 0 and ends == pytest.approx((-rest, rest))

    def test_oracles_are_not_ranked(self):
        both = [played("fig4", "privileged-planner", 1.0), played("fig4", "tangent", 0.4)]
        [found] = ranking.rank(both)
        assert found.best == "tangent" and found.references == ("privileged-planner",)
        assert not found.is_contest

    def test_no_ranking_without_contacts(self):
        nothing = np.full(STARTS, np.nan)
        found = ranking.rank([played("fig3", n, nothing) for n in ("tangent", "bearing-only")])
        assert found[0].best is None and not found[0].is_contest
        assert "No ranking" in ranking.answer(found)


class TestAnswer:
    def test_answer_names_leader(self):
        cells = [("clutter-4", 0.7, 0.7), ("clutter-8", 0.9, 0.9), ("clutter-12", 0.2, 0.8)]
        found = ranking.rank(
            [played(s, "tangent", a) for s, a, _ in cells]
            + [played(s, "tangent-merged", b, 6.0) for s, _, b in cells]
        )
        assert ranking.answer(found) == (
            "tangent-merged leads in collision-free success: best, or tied with the best, "
            "in 3 of 3 scenarios, alone in 1; then tangent, in 2."
        )

    def test_answer_abbreviates_many_ties(self):
        names = ("tangent", "bearing-only", "zero", "random", "tangent-merged")
        found = ranking.rank([played("fig4", name, 1.0) for name in names])
        assert ranking.answer(found).startswith("5 policies are tied in collision-free success")


class TestMatrix:
    @pytest.mark.parametrize("width", [80, 120])
    def test_matrix_fits_terminal(self, width):
        names = ("bearing-only", "tangent-blocking-certified", "privileged-planner")
        cells = [played(s, n, 0.5) for s in scenarios.names() for n in names]
        text = shown(ranking.rank(cells), width)
        lines = text.splitlines()
        assert max(map(len, lines)) <= width and "…" not in text
        assert "robotarium" in text  # no name is cut within a word
        parts = sum("collision-free, %" in line for line in lines)
        assert sum(line.startswith("tangent-blocking-certified ") for line in lines) == parts > 1
        assert text.count(" 50") == len(cells)

    def test_matrix_explains_marks(self):
        shares = {"tangent": (1.0, 5.0), "tangent-merged": (1.0, 9.0), "bearing-only": (0.25, 5.0)}
        text = shown(ranking.rank([played("fig4", n, *share) for n, share in shares.items()]), 80)
        assert "100*" in text and "100=" in text and "  25" in text and "contains 0" in text
        assert text.index("tangent ") < text.index("bearing-only")  # as they were asked for

    def test_matrix_has_no_mark_without_contest(self):
        text = shown(ranking.rank([played("duo", "bearing-only", 1.0)]), 80)
        assert "100" in text and "*" not in text and "=" not in text
        text = shown(ranking.rank([played("fig3", "tangent", np.full(1, np.nan))]), 80)
        assert "– in fig3: robots pass through" in text and "nan" not in text

    @pytest.mark.parametrize(
        ("clearance", "text"),
        [
            (-4.4e-16, "0.00"),
            (9.4e-6, "0.00"),
            (3.2e-3, "0.0032"),
            (0.126, "0.13"),
            (-0.02, "-0.02"),
        ],
    )
    def test_a_clearance_of_a_contact_is_0(self, clearance, text):
        one = played("clutter-8", "tangent", 1.0)
        row = statistics.summarise(one.job.scenario, "tangent", one.episodes)
        row |= {"min_clearance": clearance, "min_alignment": 0.5}
        cells = shown(tables.results_table([row], {"clutter-8": one.job.scenario})).splitlines()
        assert next(line for line in cells if "tangent" in line).split()[-2] == text

    def test_percent_has_decimal_if_supported(self):
        assert tables.percent(0.9965, 1000) == "99.7" and tables.percent(0.9965, 200) == "100"


class TestTables:
    def test_tables_describe_absence_of_rise(self):
        found = played("fig4", "tangent", np.ones(1, bool))
        row = statistics.summarise(scenarios.get("fig4"), "tangent", found.episodes)
        fell = row | {"max_rise_between_merges": -0.5}
        rose = row | {"policy": "zero", "max_rise_between_merges": 0.25}
        text = shown(tables.results_table([fell, rose], {"fig4": scenarios.get("fig4")}))
        lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
        assert " none " in lines["tangent"] and " 0.25 " in lines["zero"]
        assert "fig4, 1 episode" in text and "nan" not in text and "[" not in lines["tangent"]

    def test_tables_show_small_lengths(self):
        """In a world of micrometres V may double by an increase of 10⁻⁹ m²/s."""
        tiny = scenarios.get("fig4").replace(merge_radius=1e-6, graph=graphs.complete(1e-6))
        found = played("fig4", "tangent", np.ones(1, bool))
        row = statistics.summarise(scenarios.get("fig4"), "tangent", found.episodes)
        small = {"max_rise_between_merges": 1e-9, "path_length": 3.4e-5, "min_clearance": 2.1e-6}
        text = shown(tables.results_table([row | small], {"fig4": tiny}))
        assert re.search(r" 3\.4e-05 +1e-09 +2\.1e-06 ", text)

    def test_paired_table_shows_differences(self):
        pair = {"bearing-only": played("fig4", "bearing-only", 0.5).episodes}
        pair["tangent"] = played("fig4", "tangent", 0.75).episodes
        rows = statistics.compare_pairs("fig4", pair, "bearing-only")
        printed = shown(tables.paired_table(rows), 80)
        [line] = [text for text in printed.splitlines() if "tangent" in text]
        assert "+25.0 [+" in line and " 62 [" in line  # better on a quarter, even on the rest


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Output of a comparison, and its summary."""
    out = tmp_path_factory.mktemp("answer")
    names, short = ("bearing-only", "tangent-merged", "zero"), out / "new" / "short.json"
    how = {"episodes": 3, "keep": 0, "against": "tangent-merged", "figures": False}
    console = Console(file=io.StringIO(), width=80)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compare, "Console", lambda **options: console)
        assert compare.run(compare.Config(("fig4",), names, **how, out=out / "a", json=short)) == 0
    return console.file.getvalue(), json.loads(short.read_text())


class TestCommand:
    def test_answer_precedes_tables(self, said):
        text, summary = said
        parts = (summary["answer"][:30], "collision-free, %", "Against")
        places = [text.index(part) for part in parts]
        assert places == sorted(places) and summary["answer"].startswith("tangent-merged leads")
        assert "T/bound" not in text  # that takes --details

    def test_times_of_stages_add_up(self, said):
        text, summary = said
        timing = summary["timing"]
        parts = [seconds for name, seconds in timing.items() if name != "total_s"]
        assert {"setting_up_s", "compiling_s", "playing_s", "tables_s"} <= set(timing)
        assert min(parts) >= 0 and sum(parts) == pytest.approx(timing["total_s"], abs=0.2)
        assert "playing" in text.splitlines()[-2] + text.splitlines()[-1]

    def test_json_summary_has_results(self, said):
        _, summary = said
        fig4 = summary["scenarios"]["fig4"]
        assert (fig4["initial_conditions"], fig4["best"], fig4["tied"]) == (1, "tangent-merged", [])
        assert fig4["policies"]["bearing-only"]["collision_free_success"] == 0
        assert fig4["policies"]["bearing-only"]["collision_free_low"] is None
        assert {row["against"] for row in summary["paired"]} == {"tangent-merged"}

    def test_blind_policies_are_omitted_unless_named(self, tmp_path):
        jobs = compare.plan(compare.Config(scenarios=("duo", "fig4"), out=tmp_path / "o"))
        assert not {job.policy for job in jobs} & {"random", "zero"}
        jobs = compare.plan(compare.Config(("duo",), ("zero",), out=tmp_path / "o"))
        assert [job.policy for job in jobs] == ["zero"]


def test_paired_rows_fall_back_to_other_reference():
    cells = [played("fig4", "tangent", 0.5), played("fig4", "bearing-only", 0.2)]
    cells += [played("duo", "bearing-only", 1.0), played("duo", "zero", 0.0)]
    found = {(r["scenario"], r["against"]) for r in compare.paired_rows(cells, "tangent")}
    assert found == {("fig4", "tangent"), ("duo", "bearing-only")}
