"""Replay of ``rendezvous report`` in headless Chromium."""

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import browsing
import numpy as np
import pytest
from browsing import (
    chosen,
    clock,
    picture,
    pixels,
    place_of,
    reloaded,
    scrub,
    shown_rows,
    visited,
    wait_for,
    wait_until,
)
from conftest import needs_browser

import rendezvous_env as rv
from rendezvous_env import baselines
from train.compare import compare
from train.report import build as report

pytestmark = needs_browser
address, opened, recorded = browsing.address, browsing.opened, browsing.recorded  # fixtures


class TestReplay:
    def test_replay_opens_at_differing_episode(self, opened, recorded):
        assert opened.input_value("#scenario") == "fig4" and clock(opened) == 0
        assert chosen(opened) == ["bearing-only", "tangent-merged"]
        said = opened.text_content("#said")
        contacts = int(recorded("contacts")[-1].sum())
        assert f"with {contacts} robot-steps in contact; tangent-merged meets after" in said
        assert said.endswith("without a contact.")

    def test_play_moves_robots_to_end(self, opened, recorded):
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
        times = recorded("times"), recorded("times", "tangent-merged")
        assert clock(opened) == pytest.approx(max(t[-1] for t in times), abs=0.006)
        assert picture(opened, 0) != before[0] and picture(opened, 1) != before[1]
        states = opened.locator(".state").all_text_contents()
        for state, own in zip(states, times, strict=True):
            assert state.startswith(f"met at {own[-1]:.2f} s · 1 of 3 robots left")

    @pytest.mark.slow
    def test_pause_stops(self, opened):
        opened.select_option("#speed", "0.25")  # far from the end, however slow the browser is
        opened.locator("#speed").blur()
        opened.keyboard.press("Space")
        wait_until(opened, lambda: clock(opened) > 0.1)
        opened.keyboard.press("Space")
        halted = clock(opened), picture(opened)
        opened.wait_for_timeout(150)
        assert (clock(opened), picture(opened)) == halted

    @pytest.mark.slow
    def test_scrubbing_sets_time(self, opened, recorded):
        box = opened.locator("#time").bounding_box()
        opened.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        end = max(recorded("times")[-1], recorded("times", "tangent-merged")[-1])
        assert clock(opened) == pytest.approx(0.5 * end, abs=0.05)
        plot = opened.locator(".v .u-over").first.bounding_box()
        opened.mouse.click(plot["x"] + 0.25 * plot["width"], plot["y"] + 10)
        assert clock(opened) == pytest.approx(0.25 * end, abs=0.05)
        head = opened.locator(".v .playhead").nth(1).bounding_box()
        right = opened.locator(".v .u-over").nth(1).bounding_box()
        assert head["x"] == pytest.approx(right["x"] + 0.25 * right["width"], abs=2)

    @pytest.mark.slow
    def test_values_match_time(self, opened, recorded):
        times = recorded("times")
        frame = len(times) // 2
        scrub(opened, times[frame])
        assert opened.locator(".v-now").first.text_content() == f"{recorded('lyapunov')[frame]:.1f}"
        alignment = recorded("alignment")[frame, 0]
        assert opened.locator(".a-now").first.text_content() == f"robot 0: {alignment:.3f}"
        contacts = int(recorded("contacts")[frame].sum())
        assert f"{contacts} robot-steps in contact" in opened.locator(".state").first.text_content()

    @pytest.mark.slow
    def test_robots_interpolate_and_observations_hold(self, opened, recorded):
        times = recorded("times")
        scrub(opened, times[4])
        before, rows = picture(opened), shown_rows(opened)
        scrub(opened, 0.5 * (times[4] + times[5]))
        assert picture(opened) != before and shown_rows(opened) == rows
        scrub(opened, times[5])
        assert shown_rows(opened) != rows

    @pytest.mark.slow
    def test_keyboard_shortcuts_work(self, opened, recorded):
        times = recorded("times")
        opened.keyboard.press("ArrowRight")
        assert clock(opened) == pytest.approx(times[1], abs=0.006)
        for key, time in (("ArrowRight", times[2]), ("ArrowLeft", times[1]), ("End", times[-1])):
            opened.keyboard.press(key)
            assert clock(opened) == pytest.approx(time, abs=0.006)
        opened.keyboard.press("Home")
        assert clock(opened) == 0
        opened.keyboard.press("]")
        assert opened.input_value("#speed") == "2"
        for _ in range(9):
            opened.keyboard.press("[")
        assert opened.input_value("#speed") == "0.1"

    @pytest.mark.slow
    def test_focus_is_visible_and_keys_act_on_it(self, opened):
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

    @pytest.mark.slow
    def test_controls_have_accessible_names(self, opened):
        bare = opened.evaluate(
            "[...document.querySelectorAll('button, select, input, canvas[role]')].filter("
            "e => !(e.textContent.trim() || e.ariaLabel || (e.labels && e.labels.length)))"
            ".map(e => e.outerHTML)"
        )
        assert bare == []

    @pytest.mark.slow
    def test_episode_and_policy_are_selectable(self, opened):
        opened.keyboard.press("End")
        first = picture(opened, 1)
        opened.locator("select.policy").nth(1).select_option("zero")
        outcome = opened.locator(".outcome").nth(1)
        wait_until(opened, lambda: outcome.text_content().startswith("not met"))
        opened.keyboard.press("End")
        assert picture(opened, 1) != first
        assert opened.locator(".state").nth(1).text_content().startswith("time out at 30.00 s")

    @pytest.mark.slow
    def test_sides_never_show_same_policy(self, opened):
        with reloaded(opened):
            opened.locator("select.policy").nth(0).select_option("tangent-merged")
        assert chosen(opened) == ["tangent-merged", "bearing-only"]

    @pytest.mark.slow
    def test_autoplay_respects_reduced_motion(self, browser, address):
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(address)
        # both in one look: the end may have come by the second one of a slow browser. And a look
        # from outside: the page's own policy forbids what waits within it (wait_for_function)
        playing = (
            "() => parseFloat(document.getElementById('clock').textContent) > 0.1"
            " && document.getElementById('play').textContent === 'Pause'"
        )
        wait_until(page, lambda: page.evaluate(playing))
        top = page.locator(".world canvas").first.bounding_box()
        assert top["y"] + top["height"] < 900 and page.locator(".answer").is_visible()
        page.close()


class TestAddress:
    @pytest.mark.slow
    def test_address_describes_view(self, opened):
        opened.keyboard.press("ArrowRight")
        opened.click("#robots button:nth-child(3)")
        assert parse_qs(urlsplit(opened.url).fragment) == {
            "scenario": ["fig4"], "start": ["0"], "policy": ["bearing-only", "tangent-merged"],
            "robot": ["2"], "t": ["0.05"],
        }  # fmt: skip

    @pytest.mark.slow
    def test_address_is_followed(self, opened):
        fragment = "#scenario=uav-6&start=1&policy=zero&robot=4&t=0.5"
        with reloaded(opened):
            opened.goto(opened.url.split("#")[0] + fragment)
        assert opened.input_value("#scenario") == "uav-6" and opened.input_value("#start") == "1"
        assert chosen(opened) == ["zero", "nonholonomic-3d"] and clock(opened) == 0.5
        assert "Observation of robot 4" in opened.locator(".sight h3").first.text_content()

    @pytest.mark.slow
    @pytest.mark.parametrize("fragment", ["#scenario=nowhere", "#start=7", "#replay", "#t=x"])
    def test_invalid_address_is_ignored(self, fragment, opened):
        opened.goto(opened.url.split("#")[0] + fragment)
        opened.reload()
        opened.wait_for_selector("#player[data-ready]")
        assert opened.input_value("#scenario") == "fig4" and clock(opened) == 0

    @pytest.mark.slow
    def test_row_links_to_replay(self, opened):
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
    @pytest.mark.slow
    @pytest.mark.parametrize("robot", [1, 2])
    def test_click_shows_observation_rows(self, robot, opened, recorded):
        times, observations = recorded("times"), recorded("observations")
        frame = int(np.flatnonzero(recorded("contacts")[:, robot])[0])
        scrub(opened, times[frame])
        before = picture(opened, of=".eye")
        x, y = browsing.place_of(opened, recorded("positions")[frame, robot])
        opened.locator(".world canvas").first.click(position={"x": x, "y": y})
        button = f"#robots button:nth-child({robot + 1})"
        assert opened.get_attribute(button, "aria-pressed") == "true"
        assert f"Observation of robot {robot}" in opened.locator(".sight h3").first.text_content()
        assert picture(opened, of=".eye") != before
        own = observations[frame, robot]
        present = own[(own != 0).any(axis=1)]
        rows = shown_rows(opened)
        assert len(rows) == len(present) >= 2 + 2  # both neighbours and one silhouette at least
        np.testing.assert_allclose(list(rows.values()), present, atol=8e-4)
        others = [other for other in range(3) if other != robot]
        assert list(rows)[:2] == [f"robot {other}" for other in others]

    @pytest.mark.slow
    def test_replay_3d_has_two_projections_and_gravity(self, opened, recorded):
        wait_for(opened, "uav-6", ["nonholonomic-3d", "zero"])
        assert opened.locator(".pane").first.locator(".world canvas").count() == 2
        shown = opened.locator(".pane").first.locator("canvas[role]").all()
        planes = [canvas.get_attribute("aria-label").split(", ")[-1] for canvas in shown]
        assert planes == ["x–y plane", "x–z plane"] * 2
        opened.keyboard.press("ArrowRight")
        rows = shown_rows(opened)
        at = recorded("observations", "nonholonomic-3d", 0, "uav-6")[1, 0]
        np.testing.assert_allclose(rows["gravity"], at[-1], atol=6e-4)
        assert len(rows) == 5 + 1

    @pytest.mark.slow
    def test_merged_robot_has_no_observation(self, opened, recorded):
        gone = int(np.flatnonzero(~recorded("active")[-1])[0])
        opened.click(f"#robots button:nth-child({gone + 1})")
        assert len(shown_rows(opened)) > 0
        opened.keyboard.press("End")
        assert shown_rows(opened) == {}


@pytest.mark.slow
def test_packed_team_counts_as_met(browser, tmp_path):
    """All its robots remain, so it was reported as a time-out."""
    how = {"episodes": 1, "keep": 1, "figures": False}
    config = compare.Config(("robotarium-4",), ("bearing-only",), out=tmp_path, **how)
    assert compare.run(config) == 0 and report.run(report.Config(tmp_path)) == 0
    with visited(browser, (tmp_path / "report.html").as_uri()) as page:
        page.keyboard.press("End")
        state = page.locator(".state").first.text_content()
        assert state.startswith("met at ") and "4 of 4 robots left" in state


@pytest.mark.slow
def test_replay_shows_conditions_of_robots(browser, tmp_path):
    scenario = rv.Scenario(
        n_robots=5,
        graph=rv.graphs.complete(0.4),
        start_positions=((-3, -3), (-3, 3), (3, 3), (3, -3), (0.5, 0.0)),
        activation={"kind": "periodic", "period": [1, 1, 1, 4, 1], "phase": [0, 0, 0, 0, 0]},
        events={
            "crashes": [[0, 0.5]],
            "adversaries": [[1, 1.0]],
            "sensor_failures": [[2, 0.25, 1e3]],
        },
        time_limit=3.0,
        time_step=0.1,
        allow_long_step=True,
    )
    played = rv.rollout(scenario, baselines.make("bearing-only", scenario))
    path = played.to_report(tmp_path / "replay.html")
    wanted = sum(
        mark * played.conditions[name][1:, 0].astype(int)
        for name, mark in {"crashed": 1, "adversarial": 2, "blind": 4}.items()
    )
    wanted += 8 * ~played.conditions["activated"][1:, 0]
    with visited(browser, path.as_uri()) as page:
        page.click("#robots button:nth-child(5)")  # the frame of the selected robot is drawn
        said = page.locator(".state").first
        assert "crashed" not in said.text_content() and "inactive" not in said.text_content()
        before = pixels(page)
        page.keyboard.press("End")
        marks = wanted[-1]
        texts = "crashed", "adversarial", "blind", "inactive"
        for mark, text in zip((1, 2, 4, 8), texts, strict=True):
            count = int(((marks & mark) > 0).sum())
            assert (f"{count} {text}" in said.text_content()) == (count > 0)
        arms = [
            corners_in_ink(image, place)
            for image, place in (
                (before, place_of(page, played.positions[0, 0, 0])),
                (pixels(page), place_of(page, played.positions[-1, 0, 0])),
            )
        ]
        assert arms == [0, 4]


def corners_in_ink(image, place):
    """Number of corners of a square around a place that have the colour of the text."""
    column, row = map(round, place)
    around = image[row - 13 : row + 14, column - 13 : column + 14]
    ink = abs(around - (27, 31, 36)).max(axis=2) < 8
    return sum(
        bool(part.any()) for half in (ink[:5], ink[-5:]) for part in (half[:, :5], half[:, -5:])
    )


@pytest.mark.slow
def test_millimetre_world_fills_picture(browser):
    """The margin was 8 cm, and displayed numbers were zeros."""
    page = browser.new_page()
    for name in ("tables.js", "world.js"):
        page.add_script_tag(path=Path(report.__file__).with_name("page") / name)
    bounds = page.evaluate("boundsOf([{extent: [[0, 1e-3], [2e-4, 2e-4]]}])")
    np.testing.assert_allclose(bounds, [[-8e-5, 1.08e-3], [1.2e-4, 2.8e-4]])
    assert page.evaluate('[metres("0.00034", 2), metres("0.34", 2)]') == ["0.00034", "0.34"]
    assert page.evaluate("[0, 2.5e-4, -1e-7].map(tick)") == ["0", "0.00025", "−1e−7"]
    page.close()
