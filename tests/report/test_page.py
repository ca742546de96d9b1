"""Page of ``rendezvous report``: tables, layout, and imperfect sensors."""

import re

import browsing
import numpy as np
import pytest
from browsing import column, picture, pixels, scrub, visited, wait_for, wait_until
from conftest import ROOT, needs_browser
from matplotlib.image import imread

import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import outlines
from train import results
from train.compare import compare
from train.report import build as report

pytestmark = needs_browser
address, opened, recorded = browsing.address, browsing.opened, browsing.recorded  # fixtures


class TestTables:
    def test_table_numbers_equal_file(self, opened, compared):
        rows = opened.locator("#results-table tbody tr").all()
        expected = results.read_csv(compared / "results.csv")
        low = {
            "success": "success",
            "collision_free_success": "collision_free",
            "median_time": "time",
        }
        for line, row in zip(rows, expected, strict=True):
            shown = line.locator("td").evaluate_all(
                "cells => cells.map(cell => [cell.dataset.column, cell.dataset.value, "
                "cell.dataset.low, cell.dataset.high, cell.textContent])"
            )
            columns = {name for name in row if not name.endswith(("_low", "_high"))}
            assert {name for name, *_ in shown} == columns
            for name, value, least, most, text in shown:
                assert value == row[name]
                if name in low:
                    assert least == row[f"{low[name]}_low"] and most == row[f"{low[name]}_high"]
                if name == "collision_free_success":
                    numbers = [float(n) for n in re.findall(r"\d+", text)]
                    percents = [100 * float(cell) for cell in (value, least, most) if cell]
                    assert numbers == pytest.approx(percents, abs=0.5)
                if name == "path_length":
                    assert float(text) == pytest.approx(float(value), abs=0.051)

    def test_click_sorts_and_second_click_reverses(self, opened, compared):
        head = opened.locator("#results-table th", has_text="path m")
        values = [float(row["path_length"]) for row in results.read_csv(compared / "results.csv")]
        shown = lambda: [float(value) for value in column(opened, "path_length")]  # noqa: E731
        assert shown() == values != sorted(values)
        head.locator("button").click()
        assert shown() == sorted(values) and head.get_attribute("aria-sort") == "ascending"
        head.locator("button").click()
        assert shown() == sorted(values, reverse=True)
        assert head.get_attribute("aria-sort") == "descending"

    @pytest.mark.slow
    def test_empty_cells_sort_last(self, opened):
        for _ in range(2):
            opened.click("#results-table th:has-text('clearance') button")
            assert column(opened, "min_clearance")[-2:] == ["", ""]

    @pytest.mark.slow
    def test_first_click_sorts_best_first(self, opened):
        for title, name, best in (
            ("collision-free", "collision_free_success", max),
            ("median time", "median_time", min),
            ("contacts", "contacts", min),
            ("alignment", "min_alignment", max),
        ):
            opened.click(f"#results-table th:has-text('{title}') button")
            numbers = [float(value) for value in column(opened, name) if value]
            assert numbers[0] == best(numbers) and len(set(numbers)) > 1

    def test_all_columns_and_headers_are_visible(self, opened):
        table = opened.locator("#results-table").bounding_box()
        alignment = opened.locator("#results-table th").last
        assert alignment.text_content() == "alignment"
        right = alignment.bounding_box()
        assert right["x"] + right["width"] <= table["x"] + table["width"] + 1 <= 1400
        opened.locator("#results-table tr").last.evaluate(
            "line => scrollTo({ top: line.getBoundingClientRect().top + scrollY - 200,"
            " behavior: 'instant' })"
        )
        head = opened.locator("header").bounding_box()
        assert head["y"] == 0 and opened.evaluate("scrollY") > 500
        if opened.locator("#results-table thead").bounding_box()["y"] < 0:
            assert alignment.bounding_box()["y"] == pytest.approx(head["height"], abs=1)

    @pytest.mark.slow
    def test_best_of_each_scenario_is_marked(self, opened):
        shown = browsing.cells_of(opened, "#best-table tbody tr")
        best = [["fig4", "tangent-merged"], ["uav-6", "nonholonomic-3d"]]
        assert [cells[:2] for cells in shown] == best

    @pytest.mark.slow
    def test_table_is_saved_as_shown(self, opened, compared):
        opened.select_option("#table-scenario", "uav-6")
        for _ in range(2):
            opened.click("#results-table th:has-text('policy') button")
        with opened.expect_download() as saved:
            opened.click("button.csv[data-table=results]")
        assert saved.value.suggested_filename == "results.csv"
        rows = [r for r in results.read_csv(compared / "results.csv") if r["scenario"] == "uav-6"]
        expected = sorted(rows, key=lambda row: row["policy"], reverse=True)
        assert results.read_csv(saved.value.path()) == expected


@pytest.mark.slow
def test_dark_mode_follows_preference(opened):
    light = opened.evaluate("getComputedStyle(document.body).backgroundColor"), picture(opened)
    opened.emulate_media(color_scheme="dark")
    wait_until(opened, lambda: picture(opened) != light[1])
    dark = opened.evaluate("getComputedStyle(document.body).backgroundColor")
    assert light[0] == "rgb(255, 255, 255)" and dark == "rgb(20, 23, 27)"


@pytest.mark.slow
def test_figures_can_be_saved(opened, compared):
    opened.keyboard.press("ArrowRight")
    with opened.expect_download() as saved:
        opened.locator("button.png").nth(1).click()
    assert saved.value.suggested_filename == "fig4-0-tangent-merged-0.05_s.png"
    image = imread(saved.value.path())
    world = opened.locator(".world canvas").nth(1).bounding_box()
    assert image.shape[0] > world["height"] and image.shape[1] > 1.4 * world["width"]
    assert (np.abs(image[..., :3] - np.array([0xE6, 0x9F, 0x00]) / 255).max(-1) < 0.01).any()
    with opened.expect_download() as saved:
        opened.click("figure#success button.save")
    assert saved.value.path().read_bytes() == (compared / "success.png").read_bytes()


class TestNarrow:
    @pytest.fixture
    def phone(self, opened):
        opened.set_viewport_size({"width": 390, "height": 844})
        wait_until(opened, opened.locator("#switch").is_visible)
        return opened

    @pytest.mark.slow
    def test_narrow_page_shows_one_policy(self, phone):
        panes = phone.locator(".pane")
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [False, True]
        first = phone.locator("#switch button").first
        assert first.text_content() == "bearing-only"
        first.click()
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [True, False]
        assert first.get_attribute("aria-pressed") == "true"
        phone.keyboard.press("End")
        assert phone.locator(".state").first.text_content().startswith("met at")
        assert pixels(phone).std() > 13

    @pytest.mark.slow
    def test_narrow_page_shows_key_numbers(self, phone):
        for name in ("policy", "collision_free_success", "median_time"):
            for cell in phone.locator(f"#results-table td[data-column={name}]").all():
                box = cell.bounding_box()
                assert box["x"] >= 0 and box["x"] + box["width"] <= 390
                assert cell.evaluate("cell => cell.scrollWidth <= cell.clientWidth + 1")
        assert not phone.locator("#results-table td[data-column=path_length]").first.is_visible()
        phone.click("#all-columns")
        assert phone.locator("#results-table td[data-column=path_length]").first.is_visible()
        assert phone.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("scenario", ["fig4", "uav-6"])
def test_numbers_are_not_truncated(width, scenario, opened):
    opened.set_viewport_size({"width": width, "height": 900})
    wait_for(opened, scenario, [])
    opened.keyboard.press("ArrowRight")
    cut = opened.evaluate(
        "[...document.querySelectorAll('.rows, .plot p, .state, .outcome, #clock, td, figcaption')]"
        ".filter(e => e.clientWidth && e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML)"
    )
    assert cut == []


@pytest.mark.slow
def test_about_section_lists_scenario(opened, recorded):
    """Orange obstacles at their positions, a robot's colour at its initial position."""
    disc = next(one for one in outlines(recorded("obstacles"), 2) if not len(one.vertices))
    for position, right, colour in (
        (disc.centre, 0, [0xE6, 0x9F, 0x00]),
        (recorded("positions")[0, 1], 6, [0xD5, 0x5E, 0x00]),
    ):
        x, y = browsing.place_of(opened, position)
        assert np.rint(pixels(opened)[round(y), round(x) + right]).tolist() == colour


@pytest.fixture(scope="module")
def erring(tmp_path_factory):
    """A comparison with noisy and missing bearings, and an exact one."""
    out = tmp_path_factory.mktemp("blurred")
    sensor = rv.Sensing(noise=0.3, dropout=0.3)
    scenario = rv.Scenario(name="blurred", n_robots=4, time_limit=1.0, sensing=sensor)
    scenario.to_toml(out / "blurred.toml")
    given = {"scenarios": (str(out / "blurred.toml"), "ring-12"), "policies": ("bearing-only",)}
    config = compare.Config(**given, episodes=1, out=out / "out", figures=False)
    assert compare.run(config) == 0 and report.run(report.Config(out / "out")) == 0
    return out / "out"


class TestErringSensor:
    @pytest.fixture
    def seen_page(self, browser, erring):
        with visited(browser, (erring / "report.html").as_uri()) as page:
            yield page

    @pytest.fixture
    def kept(self, erring):
        """Arrays of the only initial condition."""
        with np.load(erring / "trajectories.npz") as arrays:
            yield lambda name, scenario: arrays[f"{scenario}/bearing-only/0/{name}"]

    @pytest.mark.slow
    def test_true_and_measured_bearings_are_shown(self, seen_page, kept):
        wait_for(seen_page, "blurred", [])
        positions, frames = kept("positions", "blurred"), kept("frames", "blurred")
        seen = kept("observations", "blurred")[:, 0]
        hidden = (seen == 0).all(axis=-1)
        frame = int(np.flatnonzero(hidden.any(axis=1) & ~hidden.all(axis=1))[0])
        scrub(seen_page, kept("times", "blurred")[frame])
        offsets = positions[frame, 1:] - positions[frame, 0]
        true = offsets @ frames[frame, 0]
        true /= np.linalg.norm(true, axis=1, keepdims=True)
        cells = browsing.cells_of(seen_page, ".rows tr.true")
        assert [name for name, *_ in cells] == ["truly 1", "truly 2", "truly 3"]
        numbers = [[browsing.number(c) for c in (x, y)] for _, x, y, _ in cells]
        np.testing.assert_allclose(numbers, true, atol=2e-3)
        for (*_, off), one, way in zip(cells, seen[frame], true, strict=True):
            if not one.any():
                assert off == "unseen"
            else:
                angle = np.degrees(np.arccos(min(1.0, one @ way / np.linalg.norm(one))))
                assert float(off.removesuffix("°")) == pytest.approx(angle, abs=0.7)

    @pytest.mark.slow
    def test_true_bearings_are_grey_rays(self, seen_page, kept):
        """A ray without an arrow, towards an undetected robot."""
        wait_for(seen_page, "blurred", [])
        times, hidden = kept("times", "blurred"), kept("observations", "blurred")[:, 0] == 0
        offsets = kept("positions", "blurred")[:, 1:] - kept("positions", "blurred")[:, :1]
        frame, robot = np.argwhere(hidden.all(axis=-1))[0]
        scrub(seen_page, times[frame])
        x, y = offsets[frame, robot] @ kept("frames", "blurred")[frame, 0]
        eye = pixels(seen_page, ".eye")
        middle = np.array(eye.shape[:2]) / 2
        radius = middle.min() - 20
        way = np.linspace(0.25, 0.95, 40)[:, None] * radius * np.array([-y, x]) / np.hypot(x, y)
        off = (
            np.abs(eye[r - 1 : r + 2, c - 1 : c + 2] - [92, 102, 114]).max(-1).min()
            for r, c in np.rint(middle + way).astype(int)
        )
        assert np.mean([one < 80 for one in off]) > 0.8

    @pytest.mark.slow
    def test_ring_marks_visible_neighbours(self, seen_page):
        wait_for(seen_page, "ring-12", [])
        assert not seen_page.locator(".rows tr.true").count()
        assert list(browsing.shown_rows(seen_page)) == ["robot 1", "robot 11"]
        seen_page.click("#robots button:nth-child(5)")
        assert list(browsing.shown_rows(seen_page)) == ["robot 3", "robot 5"]

    @pytest.mark.slow
    def test_single_policy_is_shown_alone(self, seen_page):
        panes = seen_page.locator(".pane")
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [True, False]
        assert seen_page.text_content("#said").count("bearing-only") == 1


@pytest.mark.slow
def test_rises_of_v_use_world_units(browser, tmp_path):
    """V is about 10⁻⁸ m²/s here, and an increase of 10⁻¹⁰ was rounded to zero."""
    fields = {"merge_radius": 1e-5, "spawn_size": 1e-3, "time_limit": 30.0}
    small = rv.Scenario(name="small", n_robots=2, graph=rv.graphs.complete(1e-5), **fields)
    small.to_toml(tmp_path / "small.toml")
    config = compare.Config(
        (str(tmp_path / "small.toml"),), ("bearing-only", "random"), episodes=2, keep=1,
        out=tmp_path / "out", figures=False,
    )  # fmt: skip
    assert compare.run(config) == 0 and report.run(report.Config(config.out)) == 0
    with visited(browser, (config.out / "report.html").as_uri()) as page:
        rises = column(page, "max_rise_between_merges")
        assert float(rises[0]) < 0.0 < float(rises[1]) < 1e-9
        cells = page.locator("#results-table td[data-column=max_rise_between_merges]")
        none, some = cells.all_text_contents()
        assert none == "none" and browsing.number(some) == pytest.approx(float(rises[1]), rel=0.1)


@pytest.mark.slow
def test_a_clearance_of_a_contact_is_0(opened):
    """Values below a thousandth of the merge radius are rounding, for either sign."""
    source = (ROOT / "train/report/page/tables.js").read_text(encoding="utf-8")
    data = "const DATA = {scenarios: {fig4: {contact: 2e-4}}};"
    cells = ["-4.4408920985006262e-16", "0.0000094", "0.0032", "0.1261", ""]
    ask = f"(cell) => {{ {data} {source} return clearance(cell, {{scenario: 'fig4'}}); }}"
    assert [opened.evaluate(ask, cell) for cell in cells] == ["0.00", "0.00", "0.0032", "0.13", "–"]
    contact = opened.evaluate("JSON.parse(document.getElementById('data').textContent).scenarios")
    assert contact["fig4"]["contact"] == pytest.approx(2e-4)
