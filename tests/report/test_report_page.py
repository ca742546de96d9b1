"""The page of ``rendezvous report`` in headless Chromium, used as a reader uses it."""

import base64
import io
import os
import re
import shutil
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from matplotlib.image import imread

import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import outlines
from train import results
from train.compare import compare
from train.report import build as report
from train.report.input import read

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("CI"),
    reason="no chromium on this machine; apt-get install chromium",
)


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM, "no chromium on this machine; .ci/run installs it"
    with sync_playwright() as playwright:
        flags = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def address(compared):
    assert report.run(report.Config(compared)) == 0
    return (compared / "report.html").as_uri()


@contextmanager
def visited(browser, address):
    """A page of which nothing moves by itself, as some readers wish; it must not complain."""
    page = browser.new_page(
        viewport={"width": 1400, "height": 1000}, color_scheme="light", reduced_motion="reduce"
    )
    complaints, requests = [], []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(address)
    page.wait_for_selector("#player[data-ready]")
    yield page
    assert complaints == []
    assert set(requests) == {address}
    page.close()


@pytest.fixture
def opened(browser, address):
    """The page of what ``compared`` holds."""
    with visited(browser, address) as page:
        yield page


@pytest.fixture
def recorded(compared):
    """A function: an array of a start as it was recorded, or found again."""
    found = read(compared).recordings
    return lambda name, policy="bearing-only", start=0, scenario="fig4": found[
        scenario, policy, start
    ][name]


def clock(page):
    return float(page.text_content("#clock").removesuffix(" s"))


def picture(page, pane=0):
    return page.locator(".world canvas").nth(pane).evaluate("canvas => canvas.toDataURL()")


def scrub(page, time):
    page.locator("#time").evaluate(
        "(slider, time) => { slider.value = time; slider.dispatchEvent(new Event('input')); }", time
    )


@contextmanager
def reloaded(page):
    """Wait until the recordings that were chosen within are shown."""
    page.locator("#player").evaluate("player => delete player.dataset.ready")
    yield
    page.wait_for_selector("#player[data-ready]")


def wait_for(page, scenario, policies):
    """Choose, and wait until both recordings are shown."""
    with reloaded(page):
        page.select_option("#scenario", scenario)
    for pane, policy in enumerate(policies):
        if chosen(page)[pane] != policy:
            with reloaded(page):
                page.locator("select.policy").nth(pane).select_option(policy)


def chosen(page):
    """The policies of both sides."""
    return [page.locator("select.policy").nth(pane).input_value() for pane in (0, 1)]


def shown_rows(page, pane=0):
    """Name and numbers of each row that the chosen robot sees."""
    rows = page.locator(".rows").nth(pane).locator("tr").all()
    cells = [row.locator("td").all_text_contents() for row in rows]
    return {name: [float(cell.replace("−", "-")) for cell in numbers] for name, *numbers in cells}


def wait_until(page, reached):
    """Wait for something to become true, ten seconds at most."""
    for _ in range(200):
        if reached():
            return
        page.wait_for_timeout(50)
    raise AssertionError("it did not happen")


class TestReplay:
    def test_it_opens_where_two_policies_differ_and_says_how(self, opened, recorded):
        assert opened.input_value("#scenario") == "fig4" and clock(opened) == 0
        assert chosen(opened) == ["bearing-only", "tangent-joined"]
        said = opened.text_content("#said")
        contacts = int(recorded("contacts")[-1].sum())
        assert f"with {contacts} robot-steps in contact; tangent-joined meets after" in said
        assert said.endswith("without a contact.")

    def test_play_moves_the_robots_and_ends(self, opened, recorded):
        before = picture(opened, 0), picture(opened, 1)
        opened.select_option("#speed", "8")
        # half a second of play can be over before a slow browser is asked what the button says
        opened.evaluate(
            "const button = document.getElementById('play'); window.words = [];"
            "new MutationObserver(() => window.words.push(button.textContent))"
            ".observe(button, {childList: true})"
        )
        opened.click("#play")
        wait_until(opened, lambda: opened.evaluate("window.words.at(-1)") == "Play")
        assert opened.evaluate("[...new Set(window.words)]") == ["Pause", "Play"]
        times = recorded("times"), recorded("times", "tangent-joined")
        assert clock(opened) == pytest.approx(max(t[-1] for t in times), abs=0.006)
        assert picture(opened, 0) != before[0] and picture(opened, 1) != before[1]
        states = opened.locator(".state").all_text_contents()
        for state, own in zip(states, times, strict=True):
            assert state.startswith(f"met at {own[-1]:.2f} s · 1 of 3 robots left")

    def test_pause_stays(self, opened):
        opened.select_option("#speed", "0.25")  # far from the end, however slow the browser is
        opened.locator("#speed").blur()
        opened.keyboard.press("Space")
        wait_until(opened, lambda: clock(opened) > 0.1)
        opened.keyboard.press("Space")
        halted = clock(opened), picture(opened)
        opened.wait_for_timeout(150)
        assert (clock(opened), picture(opened)) == halted

    def test_scrubbing_sets_the_time(self, opened, recorded):
        box = opened.locator("#time").bounding_box()
        opened.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        end = max(recorded("times")[-1], recorded("times", "tangent-joined")[-1])
        assert clock(opened) == pytest.approx(0.5 * end, abs=0.05)
        plot = opened.locator(".v .u-over").first.bounding_box()
        opened.mouse.click(plot["x"] + 0.25 * plot["width"], plot["y"] + 10)
        assert clock(opened) == pytest.approx(0.25 * end, abs=0.05)
        head = opened.locator(".v .playhead").nth(1).bounding_box()
        right = opened.locator(".v .u-over").nth(1).bounding_box()
        assert head["x"] == pytest.approx(right["x"] + 0.25 * right["width"], abs=2)

    def test_values_at_a_time(self, opened, recorded):
        times = recorded("times")
        frame = len(times) // 2
        scrub(opened, times[frame])
        assert opened.locator(".v-now").first.text_content() == f"{recorded('lyapunov')[frame]:.1f}"
        alignment = recorded("alignment")[frame, 0]
        assert opened.locator(".a-now").first.text_content() == f"robot 0: {alignment:.3f}"
        contacts = int(recorded("contacts")[frame].sum())
        assert f"{contacts} robot-steps in contact" in opened.locator(".state").first.text_content()

    def test_between_frames_robots_move_and_what_they_see_stays(self, opened, recorded):
        times = recorded("times")
        scrub(opened, times[4])
        before, rows = picture(opened), shown_rows(opened)
        scrub(opened, 0.5 * (times[4] + times[5]))
        assert picture(opened) != before and shown_rows(opened) == rows
        scrub(opened, times[5])
        assert shown_rows(opened) != rows

    def test_keys(self, opened, recorded):
        times = recorded("times")
        opened.keyboard.press("ArrowRight")
        assert clock(opened) == pytest.approx(times[1], abs=0.006)
        opened.keyboard.press("ArrowRight")
        opened.keyboard.press("ArrowLeft")
        assert clock(opened) == pytest.approx(times[1], abs=0.006)
        opened.keyboard.press("End")
        assert clock(opened) == pytest.approx(times[-1], abs=0.006)
        opened.keyboard.press("Home")
        assert clock(opened) == 0
        opened.keyboard.press("]")
        assert opened.input_value("#speed") == "2"
        for _ in range(9):
            opened.keyboard.press("[")
        assert opened.input_value("#speed") == "0.1"

    def test_the_focus_is_visible_and_keys_there_mean_what_they_say(self, opened):
        opened.focus("#to-end")
        opened.keyboard.press("Tab")
        assert opened.evaluate("document.activeElement.id") == "time"
        outline = "getComputedStyle(document.activeElement).outlineStyle"
        assert opened.evaluate(outline) == "solid"
        opened.focus("#to-end")
        opened.keyboard.press("Space")  # presses this button once; does not play
        assert opened.text_content("#play") == "Play" and clock(opened) > 1
        opened.focus("#speed")
        opened.keyboard.press("Home")
        assert clock(opened) > 1

    def test_every_control_has_a_name(self, opened):
        bare = opened.evaluate(
            "[...document.querySelectorAll('button, select, input, canvas[role]')].filter("
            "e => !(e.textContent.trim() || e.ariaLabel || (e.labels && e.labels.length)))"
            ".map(e => e.outerHTML)"
        )
        assert bare == []

    def test_start_and_policy_are_chosen(self, opened):
        opened.keyboard.press("End")
        first = picture(opened, 1)
        opened.locator("select.policy").nth(1).select_option("zero")
        outcome = opened.locator(".outcome").nth(1)
        wait_until(opened, lambda: outcome.text_content().startswith("not met"))
        opened.keyboard.press("End")
        assert picture(opened, 1) != first
        assert opened.locator(".state").nth(1).text_content().startswith("time out at 30.00 s")

    def test_both_sides_never_show_the_same_policy(self, opened):
        with reloaded(opened):
            opened.locator("select.policy").nth(0).select_option("tangent-joined")
        assert chosen(opened) == ["tangent-joined", "bearing-only"]

    def test_it_plays_at_once_for_those_who_do_not_mind(self, browser, address):
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(address)
        # both in one look: the end may have come by the second one of a slow browser
        page.wait_for_function(
            "parseFloat(document.getElementById('clock').textContent) > 0.1"
            " && document.getElementById('play').textContent === 'Pause'"
        )
        top = page.locator(".world canvas").first.bounding_box()
        assert top["y"] + top["height"] < 900 and page.locator(".answer").is_visible()
        page.close()


class TestAddress:
    def test_it_says_what_is_shown(self, opened):
        opened.keyboard.press("ArrowRight")
        opened.click("#robots button:nth-child(3)")
        said = parse_qs(urlsplit(opened.url).fragment)
        assert said == {
            "scenario": ["fig4"],
            "start": ["0"],
            "policy": ["bearing-only", "tangent-joined"],
            "robot": ["2"],
            "t": ["0.05"],
        }

    def test_it_is_followed(self, opened):
        with reloaded(opened):
            opened.goto(
                f"{opened.url.split('#')[0]}#scenario=uav-6&start=1&policy=zero&robot=4&t=0.5"
            )
        assert opened.input_value("#scenario") == "uav-6" and opened.input_value("#start") == "1"
        assert chosen(opened) == ["zero", "nonholonomic-3d"] and clock(opened) == 0.5
        assert "What robot 4 sees" in opened.locator(".sight h3").first.text_content()

    @pytest.mark.parametrize("fragment", ["#scenario=nowhere", "#start=7", "#replay", "#t=x"])
    def test_what_is_not_there_is_passed_over(self, fragment, opened):
        opened.goto(opened.url.split("#")[0] + fragment)
        opened.reload()
        opened.wait_for_selector("#player[data-ready]")
        assert opened.input_value("#scenario") == "fig4" and clock(opened) == 0

    def test_a_row_leads_to_its_replay(self, opened):
        row = opened.locator("#results-table tr", has_text="uav-6").filter(has_text="zero")
        with reloaded(opened):
            row.locator("td").nth(4).click()
        assert opened.input_value("#scenario") == "uav-6"
        assert chosen(opened) == ["zero", "nonholonomic-3d"]
        wait_until(opened, lambda: opened.evaluate("scrollY") < 400)
        link = opened.locator("#best-table a").first
        link.focus()
        with reloaded(opened):
            opened.keyboard.press("Enter")
        assert opened.input_value("#scenario") == "fig4"


class TestSight:
    def click_robot(self, page, robot, place):
        spot = page.locator(".world canvas").first.evaluate(
            "(canvas, [x, y]) => [canvas.view.x(x), canvas.view.y(y)]", place
        )
        page.locator(".world canvas").first.click(position={"x": spot[0], "y": spot[1]})
        assert (
            page.get_attribute(f"#robots button:nth-child({robot + 1})", "aria-pressed") == "true"
        )

    @pytest.mark.parametrize("robot", [1, 2])
    def test_a_click_shows_the_recorded_rows(self, robot, opened, recorded):
        times, observations = recorded("times"), recorded("observations")
        frame = int(np.flatnonzero(recorded("contacts")[:, robot])[0])
        scrub(opened, times[frame])
        before = opened.locator(".eye canvas").first.evaluate("canvas => canvas.toDataURL()")
        self.click_robot(opened, robot, recorded("positions")[frame, robot].tolist())
        assert f"What robot {robot} sees" in opened.locator(".sight h3").first.text_content()
        after = opened.locator(".eye canvas").first.evaluate("canvas => canvas.toDataURL()")
        assert after != before
        own = observations[frame, robot]
        present = own[(own != 0).any(axis=1)]
        rows = shown_rows(opened)
        assert len(rows) == len(present) >= 2 + 2  # both neighbours and one silhouette at least
        np.testing.assert_allclose(list(rows.values()), present, atol=8e-4)
        others = [other for other in range(3) if other != robot]
        assert list(rows)[:2] == [f"robot {other}" for other in others]

    def test_in_space_there_are_two_projections_and_gravity(self, opened, recorded):
        wait_for(opened, "uav-6", ["nonholonomic-3d", "zero"])
        assert opened.locator(".pane").first.locator(".world canvas").count() == 2
        labels = opened.locator(".pane").first.locator("canvas[role]").all()
        planes = [label.get_attribute("aria-label").split(", ")[-1] for label in labels]
        assert planes == ["x–y plane", "x–z plane"] * 2
        opened.keyboard.press("ArrowRight")
        rows = shown_rows(opened)
        at = recorded("observations", "nonholonomic-3d", 0, "uav-6")[1, 0]
        np.testing.assert_allclose(rows["gravity"], at[-1], atol=6e-4)
        assert len(rows) == 5 + 1

    def test_a_robot_that_has_merged_sees_nothing(self, opened, recorded):
        gone = int(np.flatnonzero(~recorded("active")[-1])[0])
        opened.click(f"#robots button:nth-child({gone + 1})")
        assert len(shown_rows(opened)) > 0
        opened.keyboard.press("End")
        assert shown_rows(opened) == {}


class TestTables:
    def test_numbers_are_those_of_the_file(self, opened, compared):
        rows = opened.locator("#results-table tbody tr").all()
        expected = results.read_csv(compared / "results.csv")
        assert len(rows) == len(expected)
        for line, row in zip(rows, expected, strict=True):
            shown = line.locator("td").evaluate_all(
                "cells => cells.map(cell => [cell.dataset.column, cell.dataset.value, "
                "cell.dataset.low, cell.dataset.high, cell.textContent])"
            )
            low = {"success": "success", "clean_success": "clean", "median_time": "time"}
            assert {name for name, *_ in shown} == {
                name for name in row if not name.endswith(("_low", "_high"))
            }
            for name, value, least, most, text in shown:
                assert value == row[name]
                if name in low:
                    assert least == row[f"{low[name]}_low"] and most == row[f"{low[name]}_high"]
                if name == "clean_success":
                    numbers = [float(n) for n in re.findall(r"\d+", text)]
                    percents = [100 * float(cell) for cell in (value, least, most) if cell]
                    assert numbers == pytest.approx(percents, abs=0.5)
                if name == "path_length":
                    assert float(text) == pytest.approx(float(value), abs=0.051)

    def test_a_click_sorts_and_another_turns_round(self, opened, compared):
        head = opened.locator("#results-table th", has_text="path m")
        values = [float(row["path_length"]) for row in results.read_csv(compared / "results.csv")]

        def shown():
            cells = opened.locator("#results-table td[data-column=path_length]")
            return [float(v) for v in cells.evaluate_all("all => all.map(c => c.dataset.value)")]

        assert shown() == values != sorted(values)
        head.locator("button").click()
        assert shown() == sorted(values) and head.get_attribute("aria-sort") == "ascending"
        head.locator("button").click()
        assert shown() == sorted(values, reverse=True)
        assert head.get_attribute("aria-sort") == "descending"

    def test_empty_cells_come_last(self, opened):
        for _ in range(2):
            opened.click("#results-table th:has-text('clearance') button")
            cells = opened.locator("#results-table td[data-column=min_clearance]")
            last = cells.evaluate_all("all => all.map(c => c.dataset.value)")[-2:]
            assert last == ["", ""]

    def test_the_first_click_sorts_best_first(self, opened):
        for title, column, best in (
            ("met cleanly", "clean_success", max),
            ("median time", "median_time", min),
            ("contacts", "contacts", min),
            ("alignment", "min_alignment", max),
        ):
            opened.click(f"#results-table th:has-text('{title}') button")
            cells = opened.locator(f"#results-table td[data-column={column}]")
            values = cells.evaluate_all("all => all.map(c => c.dataset.value)")
            numbers = [float(value) for value in values if value]
            assert numbers[0] == best(numbers) and len(set(numbers)) > 1

    def test_every_column_is_seen_and_titles_stay(self, opened):
        table = opened.locator("#results-table").bounding_box()
        alignment = opened.locator("#results-table th").last
        assert alignment.text_content() == "alignment"
        right = alignment.bounding_box()
        assert right["x"] + right["width"] <= table["x"] + table["width"] + 1 <= 1400
        bottom = opened.locator("#results-table tr").last
        bottom.evaluate(
            "line => scrollTo({ top: line.getBoundingClientRect().top + scrollY - 200,"
            " behavior: 'instant' })"
        )
        head = opened.locator("header").bounding_box()
        assert head["y"] == 0 and opened.evaluate("scrollY") > 500
        if opened.locator("#results-table thead").bounding_box()["y"] < 0:
            assert alignment.bounding_box()["y"] == pytest.approx(head["height"], abs=1)

    def test_the_best_of_each_scenario(self, opened):
        rows = opened.locator("#best-table tbody tr").all()
        shown = [row.locator("td").all_text_contents() for row in rows]
        assert [(cells[0], cells[1]) for cells in shown] == [
            ("fig4", "tangent-joined"), ("uav-6", "nonholonomic-3d"),
        ]  # fmt: skip

    def test_a_table_is_saved_as_it_stands(self, opened, compared):
        opened.select_option("#table-scenario", "uav-6")
        opened.click("#results-table th:has-text('policy') button")
        opened.click("#results-table th:has-text('policy') button")
        with opened.expect_download() as saved:
            opened.click("button.csv[data-table=results]")
        assert saved.value.suggested_filename == "results.csv"
        rows = [r for r in results.read_csv(compared / "results.csv") if r["scenario"] == "uav-6"]
        assert results.read_csv(saved.value.path()) == sorted(
            rows, key=lambda row: row["policy"], reverse=True
        )

    def test_one_scenario(self, opened):
        opened.select_option("#table-scenario", "uav-6")
        names = opened.locator("#results-table td[data-column=scenario]").all_text_contents()
        assert names == ["uav-6", "uav-6"]


def test_dark_for_those_who_prefer_it(opened):
    light = opened.evaluate("getComputedStyle(document.body).backgroundColor"), picture(opened)
    opened.emulate_media(color_scheme="dark")
    wait_until(opened, lambda: picture(opened) != light[1])
    dark = opened.evaluate("getComputedStyle(document.body).backgroundColor")
    assert light[0] == "rgb(255, 255, 255)" and dark == "rgb(20, 23, 27)"


def test_pictures_are_saved(opened, compared):
    opened.keyboard.press("ArrowRight")
    with opened.expect_download() as saved:
        opened.locator("button.png").nth(1).click()
    assert saved.value.suggested_filename == "fig4-0-tangent-joined-0.05_s.png"
    pixels = imread(saved.value.path())
    world = opened.locator(".world canvas").nth(1).bounding_box()
    assert pixels.shape[0] > world["height"] and pixels.shape[1] > 1.4 * world["width"]
    assert (np.abs(pixels[..., :3] - np.array([0xE6, 0x9F, 0x00]) / 255).max(-1) < 0.01).any()
    with opened.expect_download() as saved:
        opened.click("figure#success button.save")
    assert saved.value.path().read_bytes() == (compared / "success.png").read_bytes()


class TestNarrow:
    @pytest.fixture
    def phone(self, opened):
        opened.set_viewport_size({"width": 390, "height": 844})
        opened.wait_for_timeout(200)
        return opened

    def test_it_needs_no_sideways_scrolling(self, phone):
        assert phone.evaluate("document.documentElement.scrollWidth") <= 390

    def test_one_policy_at_a_time(self, phone):
        panes = phone.locator(".pane")
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [False, True]
        first = phone.locator("#switch button").first
        assert first.text_content() == "bearing-only"
        first.click()
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [True, False]
        assert first.get_attribute("aria-pressed") == "true"
        phone.keyboard.press("End")
        assert phone.locator(".state").first.text_content().startswith("met at")
        assert imread(io.BytesIO(base64.b64decode(picture(phone).split(",")[1]))).std() > 0.05

    def test_key_numbers_are_on_the_screen(self, phone):
        for column in ("policy", "clean_success", "median_time"):
            for cell in phone.locator(f"#results-table td[data-column={column}]").all():
                box = cell.bounding_box()
                assert box["x"] >= 0 and box["x"] + box["width"] <= 390
                assert cell.evaluate("cell => cell.scrollWidth <= cell.clientWidth + 1")
        assert not phone.locator("#results-table td[data-column=path_length]").first.is_visible()
        phone.click("#all-columns")
        assert phone.locator("#results-table td[data-column=path_length]").first.is_visible()
        assert phone.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("width", [390, 1400])
@pytest.mark.parametrize("scenario", ["fig4", "uav-6"])
def test_no_number_is_cut(width, scenario, opened):
    opened.set_viewport_size({"width": width, "height": 900})
    wait_for(opened, scenario, [])
    opened.keyboard.press("ArrowRight")
    cut = opened.evaluate(
        "[...document.querySelectorAll('.rows, .plot p, .state, .outcome, #clock, td, figcaption')]"
        ".filter(e => e.clientWidth && e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML)"
    )
    assert cut == []


def test_the_world_shows_what_is_there(opened, recorded):
    """Orange obstacles at their place, the robot's own colour at its start."""
    canvas = opened.locator(".world canvas").first
    pixels = imread(io.BytesIO(base64.b64decode(picture(opened).split(",")[1])))[..., :3]

    def colour(place, right=0):
        """At a place in m, so many pixels further to the right."""
        to_pixels = "(canvas, [x, y]) => [canvas.view.x(x), canvas.view.y(y)]"
        column, row = canvas.evaluate(to_pixels, place.tolist())
        return np.rint(255 * pixels[round(row), round(column) + right]).tolist()

    centre = next(disc.centre for disc in outlines(recorded("obstacles")) if not len(disc.vertices))
    assert colour(centre) == [0xE6, 0x9F, 0x00]
    assert colour(recorded("positions")[0, 1], right=6) == [0xD5, 0x5E, 0x00]


@pytest.fixture(scope="module")
def erring(tmp_path_factory):
    """A comparison in which bearings are noisy and now and then missing, beside an exact one."""
    out = tmp_path_factory.mktemp("blurred")
    sensor = rv.Sensing(noise=0.3, dropout=0.3)
    scenario = rv.Scenario(name="blurred", n_robots=4, time_limit=1.0, sensing=sensor)
    scenario.to_toml(out / "blurred.toml")
    config = compare.Config(
        (str(out / "blurred.toml"), "ring-12"), ("bearing-only",), episodes=1, out=out / "out",
        figures=False,
    )  # fmt: skip
    assert compare.run(config) == 0
    return out / "out"


class TestErringSensor:
    @pytest.fixture
    def seen_page(self, browser, erring):
        if not (erring / "report.html").exists():
            assert report.run(report.Config(erring)) == 0
        with visited(browser, (erring / "report.html").as_uri()) as page:
            yield page

    @pytest.fixture
    def kept(self, erring):
        """Arrays of the only start."""
        with np.load(erring / "trajectories.npz") as arrays:
            yield lambda name, scenario: arrays[f"{scenario}/bearing-only/0/{name}"]

    def test_what_is_true_stands_beside_what_is_seen(self, seen_page, kept):
        wait_for(seen_page, "blurred", [])
        positions, frames = kept("positions", "blurred"), kept("frames", "blurred")
        seen = kept("observations", "blurred")[:, 0]
        hidden = (seen == 0).all(axis=-1)
        frame = int(np.flatnonzero(hidden.any(axis=1) & ~hidden.all(axis=1))[0])
        scrub(seen_page, kept("times", "blurred")[frame])
        offsets = positions[frame, 1:] - positions[frame, 0]
        true = offsets @ frames[frame, 0]
        true /= np.linalg.norm(true, axis=1, keepdims=True)
        lines = seen_page.locator(".rows tr.true").all()
        cells = [line.locator("td").all_text_contents() for line in lines]
        assert [name for name, *_ in cells] == ["truly 1", "truly 2", "truly 3"]
        numbers = [[float(c.replace("−", "-")) for c in (x, y)] for _, x, y, _ in cells]
        np.testing.assert_allclose(numbers, true, atol=2e-3)
        for robot, (*_, off) in enumerate(cells):
            if hidden[frame, robot]:
                assert off == "unseen"
            else:
                along = seen[frame, robot] @ true[robot] / np.linalg.norm(seen[frame, robot])
                assert float(off.removesuffix("°")) == pytest.approx(
                    np.degrees(np.arccos(min(1.0, along))), abs=0.7
                )

    def test_true_bearings_are_grey_rays(self, seen_page, kept):
        """Where no arrow lies: towards a robot that this robot does not see."""
        wait_for(seen_page, "blurred", [])
        times, hidden = kept("times", "blurred"), kept("observations", "blurred")[:, 0] == 0
        offsets = kept("positions", "blurred")[:, 1:] - kept("positions", "blurred")[:, :1]
        frame, robot = np.argwhere(hidden.all(axis=-1))[0]
        scrub(seen_page, times[frame])
        x, y = offsets[frame, robot] @ kept("frames", "blurred")[frame, 0]
        canvas = seen_page.locator(".eye canvas").first
        data = canvas.evaluate("canvas => canvas.toDataURL()").split(",")[1]
        pixels = 255 * imread(io.BytesIO(base64.b64decode(data)))[..., :3]
        middle = np.array(pixels.shape[:2]) / 2
        radius = middle.min() - 20
        way = np.linspace(0.25, 0.95, 40)[:, None] * radius * np.array([-y, x]) / np.hypot(x, y)
        on = np.array(
            [
                np.abs(pixels[r - 1 : r + 2, c - 1 : c + 2] - [92, 102, 114]).max(-1).min()
                for r, c in np.rint(middle + way).astype(int)
            ]
        )
        assert (on < 80).mean() > 0.8

    def test_a_ring_names_the_neighbours_that_are_seen(self, seen_page):
        wait_for(seen_page, "ring-12", [])
        assert not seen_page.locator(".rows tr.true").count()
        assert list(shown_rows(seen_page)) == ["robot 1", "robot 11"]
        seen_page.click("#robots button:nth-child(5)")
        assert list(shown_rows(seen_page)) == ["robot 3", "robot 5"]

    def test_a_single_policy_stands_alone(self, seen_page):
        panes = seen_page.locator(".pane")
        assert [panes.nth(k).is_visible() for k in (0, 1)] == [True, False]
        assert seen_page.text_content("#said").count("bearing-only") == 1
