"""The page of ``rendezvous report`` in headless Chromium, used as a reader uses it."""

import base64
import io
import os
import re
import shutil

import numpy as np
import pytest

from rendezvous_env.experiment.outlines import outlines
from train import results
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


@pytest.fixture
def opened(browser, address):
    """A page, its complaints and its requests."""
    page = browser.new_page(viewport={"width": 1360, "height": 1000}, color_scheme="light")
    page.complaints, page.requests = [], []
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.on("request", lambda request: page.requests.append(request.url))
    page.goto(address)
    page.wait_for_selector("#player[data-ready]")
    yield page
    assert page.complaints == []
    assert page.requests == [address]
    page.close()


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


def wait_for(page, scenario, policies):
    """Choose, and wait until both recordings are shown."""
    page.locator("#player").evaluate("player => delete player.dataset.ready")
    page.select_option("#scenario", scenario)
    page.wait_for_selector("#player[data-ready]")
    for pane, policy in enumerate(policies):
        page.locator("#player").evaluate("player => delete player.dataset.ready")
        page.locator("select.policy").nth(pane).select_option(policy)
        page.wait_for_selector("#player[data-ready]")


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
    def test_it_opens_on_obstacles_with_two_policies(self, opened):
        assert opened.input_value("#scenario") == "fig4" and clock(opened) == 0
        chosen = [opened.locator("select.policy").nth(pane).input_value() for pane in (0, 1)]
        assert chosen == ["bearing-only", "tangent-joined"]

    def test_play_moves_the_robots_and_ends(self, opened, recorded):
        before = picture(opened, 0), picture(opened, 1)
        opened.select_option("#speed", "8")
        opened.click("#play")
        assert opened.text_content("#play") == "Pause"
        wait_until(opened, lambda: opened.text_content("#play") == "Play")
        times = recorded("times"), recorded("times", "tangent-joined")
        assert clock(opened) == pytest.approx(max(t[-1] for t in times), abs=0.006)
        assert picture(opened, 0) != before[0] and picture(opened, 1) != before[1]
        states = opened.locator(".state").all_text_contents()
        for state, own in zip(states, times, strict=True):
            assert state.startswith(f"met at {own[-1]:.2f} s · 1 of 3 robots left")

    def test_pause_stays(self, opened):
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
        assert f"{contacts} contacts" in opened.locator(".state").first.text_content()

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
        first = picture(opened, 1)
        opened.locator("select.policy").nth(1).select_option("zero")
        outcome = opened.locator(".outcome").nth(1)
        wait_until(opened, lambda: outcome.text_content().startswith("not met"))
        opened.keyboard.press("End")
        assert picture(opened, 1) != first
        assert opened.locator(".state").nth(1).text_content().startswith("time out at 30.00 s")


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
        np.testing.assert_allclose(list(rows.values()), present, atol=6e-4)
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

    def test_one_scenario(self, opened):
        opened.select_option("#table-scenario", "uav-6")
        names = opened.locator("#results-table td[data-column=scenario]").all_text_contents()
        assert names == ["uav-6", "uav-6"]


def test_dark_for_those_who_prefer_it(opened):
    light = opened.evaluate("getComputedStyle(document.body).backgroundColor"), picture(opened)
    opened.emulate_media(color_scheme="dark")
    opened.wait_for_timeout(200)
    dark = opened.evaluate("getComputedStyle(document.body).backgroundColor"), picture(opened)
    assert light[0] == "rgb(255, 255, 255)" and dark[0] == "rgb(20, 23, 27)"
    assert light[1] != dark[1]


def test_a_narrow_screen_needs_no_sideways_scrolling(opened):
    opened.set_viewport_size({"width": 420, "height": 900})
    opened.wait_for_timeout(200)
    assert opened.evaluate("document.documentElement.scrollWidth") <= 420


def test_the_world_shows_what_is_there(opened, recorded):
    """Orange obstacles at their place, the robot's own colour at its start."""
    from matplotlib.image import imread

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
