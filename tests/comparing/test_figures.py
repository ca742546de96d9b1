"""Figures of compare and reproduce: a policy has one colour, axes are equal, data are right."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

import baselines
import rendezvous_env as rv
from train.comparing import compare
from train.pictures import figures, path_figures
from train.pictures.reproduce import one_team


def row(scenario, policy, clean, **others):
    """A row of results.csv."""
    return {
        "scenario": scenario, "policy": policy, "success": 1.0, "success_low": 0.9,
        "success_high": 1.0, "clean_success": clean, "clean_low": clean - 0.1,
        "clean_high": clean + 0.05, "median_time": 4.0, "time_low": 3.0, "time_high": 6.0,
    } | others  # fmt: skip


def lightness_and_hue(code):
    """Where a colour-blind reader sees a colour: lightness, and blue against yellow."""
    red, green, blue = to_rgb(code)
    light = 0.3 * red + 0.59 * green + 0.11 * blue
    return np.array([light, blue - (red + green) / 2])


class TestColours:
    def test_a_policy_has_one_colour_and_a_variant_another_marker(self):
        for name in baselines.names():
            base = name.removesuffix("-certified").removesuffix("-tuned")
            assert figures.policy_colour(name) == figures.policy_colour(base)
            assert (figures.policy_marker(name) == figures.policy_marker(base)) == (name == base)
        assert figures.policy_colour("learned") not in (
            figures.policy_colour(name) for name in baselines.names()
        )
        assert figures.policy_colour("learned:runs/mine") != figures.policy_colour("learned")

    def test_policies_that_meet_in_clutter_are_told_apart_without_red_and_green(self):
        shown = ["bearing-only", "tangent", "tangent-blocking", "tangent-joined", "learned", "zero"]
        colours = [figures.policy_colour(name) for name in shown]
        for one, other in combinations(colours, 2):
            assert np.linalg.norm(lightness_and_hue(one) - lightness_and_hue(other)) > 0.1

    def test_compare_draws_policies_in_their_colours(self):
        rows = [row("duo", name, 0.5) for name in ("bearing-only", "learned", "random")]
        for figure in (figures.success_figure(rows), figures.time_figure(rows)):
            drawn = [
                line.get_color() for line in figure.axes[0].get_lines() if len(line.get_xdata())
            ]
            wanted = {figures.policy_colour(entry["policy"]) for entry in rows}
            assert set(drawn) == wanted


class TestWhatDoesNotApply:
    def test_no_mark_where_nothing_is_clean_and_no_bar_from_a_single_start(self, tmp_path):
        nothing = dict.fromkeys(("success_low", "success_high", "time_low", "time_high"), np.nan)
        alone = row("fig3", "tangent", np.nan, episodes=1, **nothing)
        figure = figures.success_figure([alone])
        axes = figure.axes[0]
        assert axes.get_title() == "fig3, one start"
        [success] = axes.containers  # and none of clean success
        assert success.lines[0].get_xdata() == [1.0]
        [bars] = success.lines[2]
        assert np.ptp(bars.get_segments()[0][:, 0]) == 0
        times = figures.time_figure([alone])
        assert times.axes[0].get_xlim()[1] == pytest.approx(1.15 * 4.0)
        figures.save(times, tmp_path / "times.png")


class TestSweeps:
    def test_scenarios_that_differ_in_one_number_are_grouped(self):
        names = ["clutter-16", "fig4", "clutter-4", "duo", "clutter-8"]
        scenarios = [rv.scenarios.get(name) for name in names]
        [group] = figures.sweeps(scenarios, "obstacles")
        assert [scenario.name for scenario in group] == ["clutter-4", "clutter-8", "clutter-16"]
        assert figures.sweeps(scenarios, "robots") == []
        teams = [scenarios[0].replace(n_robots=n, name=f"team-{n}") for n in (8, 3)]
        [group] = figures.sweeps([*scenarios, *teams], "robots")
        assert [scenario.n_robots for scenario in group] == [3, 4, 8]

    def test_the_figure_holds_the_numbers(self):
        group = [rv.scenarios.get(f"clutter-{count}") for count in (4, 8)]
        rows = [
            row("clutter-8", "tangent-joined", 0.6),
            row("clutter-4", "tangent-joined", 0.8),
            row("clutter-4", "bearing-only", 0.3),
            row("fig4", "bearing-only", 0.1),
        ]
        axes = figures.sweep_figure(rows, group, "obstacles").axes[0]
        joined, law = (container.lines[0] for container in axes.containers)
        assert joined.get_ydata() == pytest.approx([80.0, 60.0])
        assert joined.get_xdata() == pytest.approx([4, 8], abs=0.1)
        assert law.get_ydata() == pytest.approx([30.0])
        assert joined.get_color() == figures.policy_colour("tangent-joined")
        assert axes.get_xlabel() == "number of obstacles" and "% of starts" in axes.get_ylabel()
        [bars] = axes.containers[1].lines[2]
        assert bars.get_segments()[0][:, 1] == pytest.approx([20.0, 35.0])


class TestEpisodes:
    def test_space_is_drawn_in_equal_axes_with_its_spheres(self):
        scenario = rv.scenarios.get("clutter-3d")
        recording = one_team(rv.rollout(scenario, baselines.make("bearing-only", scenario)))
        axes = path_figures.team_figure(scenario, recording, "bearing-only").axes[0]
        extents = np.diff([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])[:, 0]
        box = axes.get_box_aspect()
        assert extents / extents[0] == pytest.approx(box / box[0])
        assert axes.get_zlabel() == "z / m" and len(axes.collections) == 12

    def test_a_figure_is_written_by_its_ending(self, tmp_path):
        figure = figures.success_figure([row("duo", "zero", 0.5)])
        for ending, start in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
            figures.save(figure, tmp_path / f"a{ending}")
            assert (tmp_path / f"a{ending}").read_bytes().startswith(start)
        assert imread(tmp_path / "a.png").std() > 0.05


def test_compare_writes_pdf_when_asked_and_draws_sweeps(tmp_path):
    names = ("clutter-4", "clutter-8")
    config = compare.Config(names, ("bearing-only",), episodes=2, keep=0, out=tmp_path, pdf=True)
    assert compare.run(config) == 0
    for name in ("success", "times", "against-obstacles"):
        assert imread(tmp_path / f"{name}.png").std() > 0.05
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
