"""Figures of compare and reproduce: consistent colours, equal axes, correct data."""

import re
from functools import cache
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from matplotlib.patches import ConnectionPatch
from matplotlib.text import Annotation, Text
from PIL import Image

import baselines
import rendezvous_env as rv
from train.compare import compare
from train.figures import figures, path_figures, reproduce, style


def row(scenario, policy, clean, **others):
    """Row of results.csv."""
    return {
        "scenario": scenario, "policy": policy, "success": 1.0, "success_low": 0.9,
        "success_high": 1.0, "collision_free_success": clean, "collision_free_low": clean - 0.1,
        "collision_free_high": clean + 0.05, "median_time": 4.0, "time_low": 3.0, "time_high": 6.0,
    } | others  # fmt: skip


def lightness_and_hue(code):
    """Colour as perceived with colour blindness: lightness, and blue against yellow."""
    red, green, blue = to_rgb(code)
    light = 0.3 * red + 0.59 * green + 0.11 * blue
    return np.array([light, blue - (red + green) / 2])


class TestColours:
    def test_policy_has_one_colour_and_variants_have_markers(self):
        for name in baselines.names():
            base = name.removesuffix("-certified").removesuffix("-tuned")
            assert figures.policy_colour(name) == figures.policy_colour(base)
            assert (figures.policy_marker(name) == figures.policy_marker(base)) == (name == base)
        scripted = (name for name in baselines.names() if not name.startswith("learned"))
        assert figures.policy_colour("learned") not in map(figures.policy_colour, scripted)
        assert figures.policy_colour("learned:runs/mine") != figures.policy_colour("learned")

    def test_colours_are_distinguishable_without_red_and_green(self):
        shown = ["bearing-only", "tangent", "tangent-blocking", "tangent-merged", "learned", "zero"]
        colours = [figures.policy_colour(name) for name in shown]
        for one, other in combinations(colours, 2):
            assert np.linalg.norm(lightness_and_hue(one) - lightness_and_hue(other)) > 0.1


def test_undefined_values_and_intervals_are_not_drawn(tmp_path):
    nothing = dict.fromkeys(("success_low", "success_high", "time_low", "time_high"), np.nan)
    alone = row("fig3", "tangent", np.nan, episodes=1, **nothing)
    axes = figures.success_figure([alone]).axes[0]
    assert axes.get_title() == "fig3, one episode"
    [success] = axes.containers  # and none of collision-free success
    assert success.lines[0].get_xdata() == [100.0]
    [bars] = success.lines[2]
    assert np.ptp(bars.get_segments()[0][:, 0]) == 0
    times = figures.time_figure([alone])
    assert times.axes[0].get_xlim()[1] == pytest.approx(1.15 * 4.0)
    style.save(times, tmp_path / "times.png")


class TestSweeps:
    def test_sweeps_group_scenarios_by_one_number(self):
        names = ["clutter-16", "fig4", "clutter-4", "duo", "clutter-8"]
        scenarios = [rv.scenarios.get(name) for name in names]
        [group] = figures.sweeps(scenarios, "obstacles")
        assert group == [scenarios[k] for k in (2, 4, 0)]
        assert figures.sweeps(scenarios, "robots") == []
        teams = [scenarios[0].replace(n_robots=n, name=f"team-{n}") for n in (8, 3)]
        [group] = figures.sweeps([*scenarios, *teams], "robots")
        assert [scenario.n_robots for scenario in group] == [3, 4, 8]

    def test_sweep_figure_holds_results(self):
        group = [rv.scenarios.get(f"clutter-{count}") for count in (4, 8)]
        rows = [
            row("clutter-8", "tangent-merged", 0.6),
            row("clutter-4", "tangent-merged", 0.8),
            row("clutter-4", "bearing-only", 0.3),
            row("fig4", "bearing-only", 0.1),
        ]
        axes = figures.sweep_figure(rows, group, "obstacles").axes[0]
        joined, law = (container.lines[0] for container in axes.containers)
        assert joined.get_ydata() == pytest.approx([80.0, 60.0])
        assert joined.get_xdata() == pytest.approx([4, 8], abs=0)
        assert law.get_ydata() == pytest.approx([30.0])
        assert joined.get_color() == figures.policy_colour("tangent-merged")
        assert axes.get_xlabel() == "number of obstacles" and "success (%)" in axes.get_ylabel()
        [bars] = axes.containers[1].lines[2]
        assert bars.get_segments()[0][:, 1] == pytest.approx([20.0, 35.0])


def texts_of(figure):
    """Text and position, pixels, of every visible text that is not empty."""
    figure.draw_without_rendering()
    outside = {
        id(label)
        for axes in figure.findobj(Axes)
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()))
        for place, label in zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)
        if not min(limits) <= place <= max(limits)
    }
    return [
        (text.get_text(), text.get_window_extent())
        for text in figure.findobj(Text)
        if text.get_text().strip() and text.get_visible() and id(text) not in outside
    ]


def assert_readable(figure, across=style.COLUMN):
    """Check the width, inches, and that no texts overlap or leave the figure."""
    assert figure.get_figwidth() == across
    found, (width, height) = texts_of(figure), figure.get_size_inches() * figure.dpi
    assert len(found) > 5
    for text, box in found:
        assert box.x0 >= -1 and box.y0 >= -1, text
        assert box.x1 <= width + 1 and box.y1 <= height + 1, text
    for (one, a), (other, b) in combinations(found, 2):
        across = min(a.x1, b.x1) - max(a.x0, b.x0)
        down = min(a.y1, b.y1) - max(a.y0, b.y0)
        assert not (across > 1 and down > 1), (one, other)


@cache
def recorded(name, policy):
    """One episode."""
    scenario = rv.scenarios.get(name)
    return reproduce.one_team(rv.rollout(scenario, baselines.make(policy, scenario)))


@cache
def drawn(name, policy):
    """Figure of the episode."""
    return path_figures.team_figure(rv.scenarios.get(name), recorded(name, policy), policy)


class TestPrint:
    @pytest.mark.parametrize(
        ("name", "policy"),
        [("fig3", "bearing-only"), ("fig4", "tangent-merged"), ("unicycle-6", "unicycle"),
         ("clutter-8", "tangent-merged")],
    )  # fmt: skip
    def test_trajectory_figure_fits_column(self, name, policy):
        assert_readable(drawn(name, policy), 3.5)

    def test_sweep_figure_fits_column(self):
        names = ("clutter-16-team-3", "clutter-16", "clutter-16-team-8", "clutter-16-team-32")
        group = sorted(map(rv.scenarios.get, names), key=lambda scenario: scenario.n_robots)
        policies = ["bearing-only", *(n for n in baselines.names() if n.startswith("tangent"))]
        rows = [row(s.name, policy, 0.5) for s in group for policy in policies]
        assert_readable(figures.sweep_figure(rows, group, "robots"))

    @pytest.mark.parametrize(("counts", "width"), [((8,), style.COLUMN), ((4, 8, 12, 16), 7.16)])
    def test_panels_fit_column_and_page(self, counts, width):
        policies = ["bearing-only", "tangent-merged-certified", "learned", "privileged-planner"]
        rows = [row(f"clutter-{k}", policy, 0.5) for k in counts for policy in policies]
        for figure in (figures.success_figure(rows), figures.time_figure(rows)):
            assert_readable(figure, width)

    def test_tank_figure_is_readable_in_percent(self):
        rows = [
            {
                "budget": budget,
                "min_alignment": margin,
                "collision_free_success": 0.9,
                "bound": 1e4 / margin,
            }
            | {"episodes": 256}
            for budget in reproduce.BUDGETS
            for margin in reproduce.MARGINS
        ]
        figure = reproduce.tank_tradeoff_figure(rows)
        assert_readable(figure, style.PAGE)
        [line, _] = figure.axes[0].get_lines()
        assert {"10,000", "1,000,000"} <= {t.get_text() for t in figure.axes[1].get_yticklabels()}
        assert line.get_ydata() == pytest.approx(90.0) and "%" in figure.axes[0].get_ylabel()

    def test_headings_are_drawn_as_arrows(self):
        paths = drawn("unicycle-6", "unicycle").axes[0]
        arrows = [text for text in paths.texts if isinstance(text, Annotation)]
        assert len(arrows) >= 6 * 3
        along = np.subtract(arrows[0].xy, arrows[0].get_position())
        yaw = recorded("unicycle-6", "unicycle")["headings"][0, 0, 0]
        assert along / np.hypot(*along) == pytest.approx([np.cos(yaw), np.sin(yaw)])
        assert "headings" in paths.get_title()

    def test_annotations_do_not_cross_curve(self):
        figure = drawn("fig4", "tangent-merged")
        figure.draw_without_rendering()
        value = figure.axes[1]
        [inset] = value.child_axes
        assert not any(patch.get_visible() for patch in value.findobj(ConnectionPatch))
        [first, *_] = value.get_lines()
        curve = value.transData.transform(first.get_xydata())
        assert not inset.get_tightbbox().count_contains(curve)

    @pytest.mark.slow
    def test_fonts_are_embeddable(self, tmp_path):
        path, rows = tmp_path / "a.pdf", [row("duo", "zero", 0.5)]
        for figure in (figures.success_figure(rows), drawn("fig4", "tangent-merged")):
            style.save(figure, path)
            written = path.read_bytes()
            assert b"/FontFile2" in written and b"/CIDFontType2" in written
            assert b"/Type3" not in written
            [size] = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ", written)
            assert float(size) / 72 == pytest.approx(figure.get_figwidth(), abs=0.01)

    @pytest.mark.slow
    def test_palette_is_small(self, tmp_path):
        names = ["bearing-only", "tangent", "tangent-blocking", "tangent-merged", "learned"]
        rows = [row(f"clutter-{k}", name, 0.5) for k in (4, 8, 12) for name in names]
        style.save(figures.success_figure(rows), tmp_path / "a.png", run="7")
        pixels = imread(tmp_path / "a.png")[..., :3]
        for name in names:
            wanted = np.array(to_rgb(figures.policy_colour(name)))
            assert (np.abs(pixels - wanted).max(axis=-1) < 0.01).sum() > 100
        assert (pixels[0] == 1.0).all()
        with Image.open(tmp_path / "a.png") as picture:
            assert picture.info["Subject"] == "rendezvous compare, run 7"

    def test_style_ignores_matplotlibrc(self, tmp_path):
        found = []
        for own in ({"axes.grid": True, "savefig.bbox": "tight"}, {}):
            with matplotlib.rc_context(own):
                style.save(figures.success_figure([row("duo", "zero", 0.5)]), tmp_path / "a.png")
            found.append(imread(tmp_path / "a.png"))
        assert (found[0] == found[1]).all()


class TestEpisodes:
    @pytest.mark.slow
    def test_dollar_in_name_is_literal(self, tmp_path):
        """No text of the figure is a formula."""
        name, policy = r"m$x$ $\bad{$", r"runs/$\worse{$"
        scenario = rv.scenarios.get("clutter-4").replace(name=name)
        recording = recorded("clutter-4", "zero")
        for figure in (
            path_figures.team_figure(scenario, recording, policy),
            path_figures.trajectories_figure(scenario, {policy: recording}),
            figures.success_figure([row(name, policy, 0.5), row("duo", policy, 0.5)]),
            figures.time_figure([row(name, policy, 0.5), row("duo", policy, 0.5)]),
        ):
            style.save(figure, tmp_path / "drawn.png")
            assert any(name in text.get_text() for text in figure.findobj(Text))

    @pytest.mark.parametrize("axis", [0, 1])
    @pytest.mark.parametrize("u", [1e-6, 1.0, 1e6])
    def test_collinear_robots_have_readable_figure(self, u, axis):
        """The figure had the height of a line, and in a small world no width."""
        start = np.zeros((3, 2))
        start[:, axis] = u * np.arange(3)
        scenario = rv.Scenario(
            n_robots=3, merge_radius=0.1 * u, spawn_size=u, graph=rv.graphs.complete(u),
            start_positions=start,
        )  # fmt: skip
        met = rv.rollout(scenario, baselines.make("bearing-only", scenario))
        figure = path_figures.team_figure(scenario, reproduce.one_team(met), "bearing-only")
        figure.canvas.draw()
        sides = np.diff([figure.axes[0].get_xlim(), figure.axes[0].get_ylim()])[:, 0] / u
        box = figure.axes[0].get_window_extent()
        assert sides[axis] == pytest.approx(2.0, rel=0.5)
        assert 0.15 < sides.min() / sides.max() < 0.3
        assert min(box.width, box.height) / max(box.width, box.height) > 0.15

    def test_figure_3d_has_equal_axes_and_spheres(self):
        axes = drawn("clutter-3d", "bearing-only").axes[0]
        extents = np.diff([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])[:, 0]
        box = axes.get_box_aspect()
        assert extents / extents[0] == pytest.approx(box / box[0])
        assert axes.get_zlabel() == "z (m)" and len(axes.collections) == 12


@pytest.mark.slow
def test_compare_writes_pdf_and_sweeps(tmp_path):
    names = ("clutter-4", "clutter-8")
    config = compare.Config(names, ("bearing-only",), episodes=2, keep=0, out=tmp_path, pdf=True)
    assert compare.run(config) == 0
    for name in ("success", "times", "against-obstacles"):
        assert imread(tmp_path / f"{name}.png").std() > 0.05
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("count", range(1, 16))
def test_panels_of_paths_fill_their_rows(count):
    columns = path_figures.panel_columns(count)
    assert columns <= 5 and -count % columns <= min(2, columns - 1)
    if count > 5:
        assert columns >= 3


def test_the_last_row_of_paths_stands_in_the_middle():
    scenario = rv.scenarios.get("duo")
    recording = recorded("duo", "bearing-only")
    names = [f"policy-{k}" for k in range(7)]
    figure = path_figures.trajectories_figure(scenario, dict.fromkeys(names, recording))
    figure.canvas.draw()
    assert len(figure.axes) == 7
    places = [axes.get_position() for axes in figure.axes]
    middle = [(place.x0 + place.x1) / 2 for place in places]
    assert np.mean(middle[4:]) == pytest.approx(np.mean(middle[:4]), abs=0.02)
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
