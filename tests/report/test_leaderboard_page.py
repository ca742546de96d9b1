"""Page of the leaderboard, from the results in the repository."""

import json
import os
import re
import shlex
import shutil

import pytest
from browsing import chosen, clock, column, picture, reloaded, visited
from conftest import ROOT, needs_browser
from rendezvous_env.baselines.learned import plain_data
from report_data import data_of

from train.checks import UserError
from train.leaderboard import run_records
from train.leaderboard.replays import path_of, read_replay
from train.report import build as report
from train.results import read_csv

SMOKE = ROOT / "results" / "leaderboard" / "smoke"
TABLE = "leaderboard.csv"
BARE = "replays/ppo-none/clutter-8-v1-seed-0.json"
"""Entry that is missing in this folder."""


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("board") / "smoke"
    shutil.copytree(SMOKE, folder)
    (folder / BARE).unlink()
    assert report.run(report.Config(folder)) == 0
    return folder


@pytest.fixture
def page(browser, board):
    with visited(browser, (board / "report.html").as_uri()) as shown:
        yield shown


def read(folder):
    """Page of a folder, its data, and its recordings."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    return text, *data_of(text)


def test_page_has_every_row_and_record(board):
    text, data, _ = read(board)
    assert data["board"] == read_csv(board / TABLE)
    found = run_records.read_records(board)
    assert len(data["cells"]) == len(found)
    for row, card in zip(data["cells"], found, strict=True):
        kept = json.loads((board / row["card"]).read_text(encoding="utf-8"))
        assert kept == card
        starts = card["results"]["clean"]
        assert float(row["collision_free"]) == pytest.approx(sum(starts) / len(starts))
    own = " 'unsafe-inline'; "
    assert f"default-src 'none'; script-src{own}style-src{own}img-src data:" in text
    assert not re.findall(r"(?:src|href)=\"(?:https?:)?//", text)


def test_page_carries_replays_with_recorded_results(board):
    _, data, blobs = read(board)
    shown = {
        (one["scenario"], one["policy"], one["start"]): (one, blob)
        for one, blob in zip(data["recordings"], blobs, strict=True)
    }
    starts = 0
    for card in run_records.read_records(board):
        path = path_of(run_records.path_in(board, card))
        assert path.is_file() == (card["seed"] == 0 and path != board / BARE)
        policy = card["algorithm"] + (f", seed {card['seed']}" if card["decisions"] else "")
        for start, kept in read_replay(path, card["results"]).items():
            one, blob = shown[card["field"], policy, start]
            told = {
                **{"success": "success", "collision_free": "clean"},
                **{"time": "time", "contacts": "touches"},
            }
            assert {name: float(one["outcome"][name]) for name in told} == {
                name: card["results"][own][start] for name, own in told.items()
            }
            assert (blob, one["fields"]) == (kept.text, kept.fields)
            assert data["obstacles"][one["obstacles"]] == kept.obstacles
            starts += 1
    assert starts == len(shown) > 36


def with_half_a_row(folder):
    text = (folder / TABLE).read_text(encoding="utf-8")
    (folder / TABLE).write_text(text.rpartition(",")[0], encoding="utf-8")


def with_a_replay_of_other_results(folder):
    path = folder / "replays" / "ppo-tank" / "clutter-8-v1-seed-0.json"
    path.write_text(path.read_text().replace('{"sha256":"', '{"sha256":"0'))


def with_a_replay_of_no_start_of_its_card(folder):
    card = run_records.read_records(folder)[0]
    path = path_of(run_records.path_in(folder, card))
    starts = {"999": json.loads(path.read_text())["starts"]["0"]}
    sealed = plain_data.digest({"results": card["results"], "starts": starts})
    path.write_text(json.dumps({"sha256": sealed, "starts": starts}))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda folder: shutil.rmtree(folder / "cells"), r"leaderboard\.csv: has no cells"),
        (lambda folder: os.truncate(folder / TABLE, 0), r"leaderboard\.csv: has no cells"),
        (with_half_a_row, r"leaderboard\.csv: has no cells"),
        (lambda folder: (folder / TABLE).write_bytes(b"\xff"), r"leaderboard\.csv: not readable: "),
        (with_a_replay_of_other_results, r"not the replay of its record \(changed, or of"),
        (with_a_replay_of_no_start_of_its_card, r"not readable \(IndexError.* run rendezvous lead"),
    ],
)
def test_incomplete_folder_is_rejected(changed, message, board, tmp_path):
    shutil.copytree(board, folder := tmp_path / "changed")
    (folder / "report.html").unlink()
    changed(folder)
    with pytest.raises(UserError, match=message):
        report.run(report.Config(folder))
    assert not (folder / "report.html").exists()


@needs_browser
def test_table_sorts_and_filters_by_scenario(page, board):
    page.get_by_role("button", name="time s").first.click()
    shown = [float(value) for value in column(page, "time", "board")]
    assert shown == sorted(shown) and len(shown) == len(read_csv(board / TABLE))
    page.select_option("#table-scenario", "rendezvous/clutter-8-v1")
    fields = [card["field"] for card in run_records.read_records(board)]
    rows = page.locator("#cells-table tbody tr")
    assert rows.count() == fields.count("rendezvous/clutter-8-v1")
    card = board / rows.first.locator("a").first.get_attribute("href")
    assert json.loads(card.read_text())["field"] == "rendezvous/clutter-8-v1"


def cell(page, algorithm, column):
    """Entry of an algorithm in the table of scenarios."""
    row = page.locator("#fields-table tbody tr").filter(has=page.get_by_text(algorithm, exact=True))
    return row.locator("td").nth(column)


@pytest.mark.slow
@needs_browser
def test_click_on_cell_opens_replay(page, board):
    found = {
        (c["algorithm"], c["field"], c["seed"]): c["results"]
        for c in run_records.read_records(board)
    }
    field = "rendezvous/clutter-16-v1"
    shares = [found["ppo-cbf", field, seed]["clean"] for seed in (0, 1, 2)]
    box = cell(page, "ppo-cbf", 2)
    assert float(box.text_content()) == pytest.approx(100 * sum(map(sum, shares)) / 150, abs=0.06)
    with reloaded(page):
        box.click(position={"x": 3, "y": 3})  # beside its text: the cell's, not the row's first
    assert page.input_value("#scenario") == field and "ppo-cbf, seed 0" in chosen(page)
    assert page.locator("#player").evaluate("one => one.getBoundingClientRect().top < 600")
    start = int(page.input_value("#start"))
    seed = page.locator("#start option:checked").text_content()
    assert seed == f"{start} (seed {2**61 + start})"
    results, side = found["ppo-cbf", field, 0], chosen(page).index("ppo-cbf, seed 0")
    before = picture(page, side)
    page.keyboard.press("End")
    pane = page.locator(".pane").nth(side)
    state = pane.locator(".state").text_content()
    met, time = results["success"][start], results["time"][start]
    assert f"{'met' if met else 'time out'} at {time:.2f} s" in state
    touches = results["touches"][start]
    assert ("in contact" in state) == bool(touches) and (not touches or f"{touches} r" in state)
    assert picture(page, side) != before
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    assert 0.0 < clock(page) < 2.0
    with reloaded(page):
        cell(page, "tank-merged", 1).locator("a").press("Enter")
    assert page.input_value("#scenario") == "rendezvous/clutter-8-v1"
    assert "tank-merged" in chosen(page) and clock(page) == 0.0


@pytest.mark.slow
def test_commands_quote_folder_names(board, tmp_path):
    shutil.copytree(board, folder := tmp_path / "it's mine; <b>")
    assert report.run(report.Config(folder)) == 0
    _, data, _ = read(folder)
    assert shlex.split(f"report {data['folder']}") == ["report", str(folder)]


@pytest.mark.slow
@needs_browser
def test_narrow_screen_shows_selection(page):
    page.set_viewport_size({"width": 390, "height": 800})
    for name, label in (("bearing-only", "bearing-only"), ("ppo-cbf", "ppo-cbf, seed 0")):
        with reloaded(page):
            cell(page, name, 2).click()
        assert page.locator(".pane:not(.behind) select.policy").input_value() == label
    assert page.evaluate("document.documentElement.scrollWidth") == 390


@pytest.mark.slow
@needs_browser
def test_cell_without_replay_names_command(page, board):
    note = page.locator("#missing")
    assert not note.is_visible()
    cell(page, "ppo-none", 1).click()
    said = note.text_content()
    path = board / "cells" / "ppo-none" / "clutter-8-v1-seed-0.json"
    assert path.is_file() and f"rendezvous leaderboard --repeat {path} --record" in said
    assert f"rendezvous report {board}" in said
    with reloaded(page):
        cell(page, "ppo-none", 2).click()
    assert not note.is_visible()
    page.locator("#cells-table tr:has(td[data-column=seed][data-value='1']) td").last.click()
    assert "seed 1" in (said := note.text_content()) and "seed-1.json --record" in said


@pytest.mark.slow
@needs_browser
def test_page_without_replays_works(browser, board, tmp_path):
    folder = tmp_path / "none"
    shutil.copytree(board, folder, ignore=shutil.ignore_patterns("replays"))
    assert report.run(report.Config(folder)) == 0
    page = browser.new_page()
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((folder / "report.html").as_uri())
    assert page.locator("#player").count() == 0
    cell(page, "ppo-tank", 1).click()
    assert "--record" in page.locator("#missing").text_content() and complaints == []
    page.close()
