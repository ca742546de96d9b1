"""Page of ``rendezvous report`` in headless Chromium: fixtures and user actions."""

import base64
import io
import time
from contextlib import contextmanager

import pytest
from matplotlib.image import imread

from train.report import build as report
from train.report.input import read


@pytest.fixture(scope="module")
def address(compared):
    assert report.run(report.Config(compared)) == 0
    return (compared / "report.html").as_uri()


@contextmanager
def visited(browser, address):
    """A page with reduced motion, which must not log errors."""
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
    """Page of ``compared``."""
    with visited(browser, address) as page:
        yield page


@pytest.fixture
def recorded(compared):
    """Function that returns an array of a recording, stored or recomputed."""
    found = read(compared).recordings
    return lambda name, policy="bearing-only", start=0, scenario="fig4": found[
        scenario, policy, start
    ][name]


def clock(page):
    return float(page.text_content("#clock").removesuffix(" s"))


def picture(page, pane=0, of=".world"):
    return page.locator(f"{of} canvas").nth(pane).evaluate("canvas => canvas.toDataURL()")


def pixels(page, of=".world"):
    """First image as an array (height, width, 3) of 0 to 255."""
    data = picture(page, of=of).split(",")[1]
    return 255 * imread(io.BytesIO(base64.b64decode(data)))[..., :3]


def place_of(page, position):
    """Column and row of a position, m, in the first image."""
    to_pixels = "(canvas, [x, y]) => [canvas.view.x(x), canvas.view.y(y)]"
    return page.locator(".world canvas").first.evaluate(to_pixels, position.tolist())


def column(page, name, table="results"):
    """Values of a column of a table, as displayed."""
    cells = page.locator(f"#{table}-table td[data-column={name}]")
    return cells.evaluate_all("all => all.map(cell => cell.dataset.value)")


def scrub(page, time):
    page.locator("#time").evaluate(
        "(slider, time) => { slider.value = time; slider.dispatchEvent(new Event('input')); }", time
    )


@contextmanager
def reloaded(page):
    """Wait until the recordings selected in the body are shown."""
    page.locator("#player").evaluate("player => delete player.dataset.ready")
    yield
    page.wait_for_selector("#player[data-ready]")


def wait_for(page, scenario, policies):
    """Select, and wait until both recordings are shown."""
    with reloaded(page):
        page.select_option("#scenario", scenario)
    for pane, policy in enumerate(policies):
        if chosen(page)[pane] != policy:
            with reloaded(page):
                page.locator("select.policy").nth(pane).select_option(policy)


def chosen(page):
    """Policies of both sides."""
    return [page.locator("select.policy").nth(pane).input_value() for pane in (0, 1)]


def cells_of(page, rows):
    """Cells of each of some rows."""
    return [row.locator("td").all_text_contents() for row in page.locator(rows).all()]


def shown_rows(page):
    """Name and numbers of each row of the selected robot, on the first side."""
    cells = cells_of(page.locator(".rows").first, "tr")
    return {name: [*map(number, numbers)] for name, *numbers in cells}


def number(cell):
    return float(cell.replace("−", "-"))


def wait_until(page, reached):
    """Wait for a condition, with a generous limit for busy machines."""
    end = time.monotonic() + 120.0
    while not reached():
        assert time.monotonic() < end, "it did not happen"
        page.wait_for_timeout(50)
