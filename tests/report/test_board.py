"""The page of a leaderboard's folder, made of the results in the repository."""

import json
import re
import shutil

import pytest
from browsing import browser, needs_browser
from conftest import ROOT

from train.checks import UserError
from train.leaderboard import cards
from train.report import build as report
from train.results import read_csv

__all__ = ["browser"]
SMOKE = ROOT / "results" / "leaderboard" / "smoke"


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("board") / "smoke"
    shutil.copytree(SMOKE, folder)
    assert report.run(report.Config(folder)) == 0
    return folder


def test_the_page_has_every_row_and_where_every_card_is(board):
    text = (board / "report.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.S)[1])
    assert data["board"] == read_csv(board / "leaderboard.csv")
    found = cards.read_cards(board)
    assert len(data["cells"]) == len(found)
    for row, card in zip(data["cells"], found, strict=True):
        kept = json.loads((board / row["card"]).read_text(encoding="utf-8"))
        assert kept == card
        starts = card["results"]["clean"]
        assert float(row["clean"]) == pytest.approx(sum(starts) / len(starts))
    policy = (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
    )
    assert policy in text and not re.findall(r"(?:src|href)=\"(?:https?:)?//", text)


def test_a_folder_without_its_cards_is_refused(board, tmp_path):
    folder = tmp_path / "bare"
    folder.mkdir()
    shutil.copy(board / "leaderboard.csv", folder)
    with pytest.raises(UserError, match="without its cells"):
        report.run(report.Config(folder))


@needs_browser
def test_it_sorts_shows_one_field_and_leads_to_cards(browser, board):
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    complaints = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((board / "report.html").as_uri())
    cells = page.locator("#board-table tbody td[data-column=time]")
    page.get_by_role("button", name="time s").first.click()
    shown = [float(cell.get_attribute("data-value")) for cell in cells.all()]
    assert shown == sorted(shown) and len(shown) == len(read_csv(board / "leaderboard.csv"))
    page.select_option("#table-scenario", "rendezvous/clutter-8-v1")
    rows = page.locator("#cells-table tbody tr")
    of_field = [c for c in cards.read_cards(board) if c["field"] == "rendezvous/clutter-8-v1"]
    assert rows.count() == len(of_field)
    assert complaints == []
    rows.first.locator("a").click()
    page.wait_for_url("**/cells/**.json")
    assert json.loads(page.inner_text("body"))["field"] == "rendezvous/clutter-8-v1"
    page.close()
