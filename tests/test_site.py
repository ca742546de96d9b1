"""Site and tutorial: built without warnings, and pages without external resources."""

import http.server
import json
import re
import shutil
import threading
from functools import partial
from html.parser import HTMLParser

import pytest
from conftest import ROOT, needs_browser, run_python
from parameters import nightly

pytestmark = pytest.mark.slow
NOTEBOOK = ROOT / "docs" / "tutorial.ipynb"
LOADS = {
    "script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src",
    "link": "href", "object": "data", "use": "href",
}  # fmt: skip
"""Attributes that make a browser fetch something; links that a reader follows are not among
them."""
ELSEWHERE = re.compile(r"^\s*(?:https?:)?//")


def run(*words: object, **environment: str) -> str:
    """Output of a Python program, both streams."""
    done = run_python(ROOT, *words, PYTHONPATH=str(ROOT), **environment)
    return done.stdout + done.stderr


@pytest.fixture(scope="module", params=["mkdocs", nightly("zensical")])
def site(request):
    """Site by each generator, and the build output."""
    pytest.importorskip(request.param)
    folder = ROOT / "out" / f"site-by-{request.param}"  # one of them builds within the project only
    environment = {"SITE_DIR": str(folder.relative_to(ROOT)), "NO_MKDOCS_2_WARNING": "1"}
    yield folder, run("docs/building/build.py", request.param, **environment)
    shutil.rmtree(folder)


class Fetched(HTMLParser):
    """Parser that collects the resources that a page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the resources of a tag, and of its style."""
        given = dict(attrs)
        self.found.append(given.get(LOADS.get(tag, "")) or "")
        self.found += re.findall(r"url\(['\"]?([^)'\"]+)", given.get("style") or "")


def fetched(text: str) -> list[str]:
    """External resources of a page."""
    reader = Fetched()
    reader.feed(text)
    return [address for address in reader.found if ELSEWHERE.match(address)]


def test_fetch_reader_finds_external_resources():
    page = '<a href="https://a.b"><script src="//c.d/e.js"></script><link href="https://f">'
    assert fetched(page + '<img src="x.png" style="background: url(http://g)">') == [
        "//c.d/e.js", "https://f", "http://g",
    ]  # fmt: skip


def test_site_builds_without_warning(site):
    folder, said = site
    assert not re.search(r"(?<!no )warning|error", said, re.IGNORECASE), said
    assert len(list(folder.rglob("*.html"))) > 30
    for made in ("index", "tutorial", "data", "commands", "reference/index", "reference/equations"):
        assert (folder / f"{made}.html").stat().st_size > 10_000, made


def test_pages_fetch_nothing_external(site):
    folder, _ = site
    for page in folder.rglob("*.html"):
        assert fetched(page.read_text(encoding="utf-8")) == [], page.name
    for sheet in folder.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//", text), sheet.name


def test_old_addresses_forward_to_pages(site):
    folder, _ = site
    for old in (
        "noise",
        "training",
        "comparing",
        "scaling",
        "peers",
        "extending",
        "learners-rllib",
    ):
        text = (folder / f"{old}.html").read_text(encoding="utf-8")
        (target,) = re.findall(r'http-equiv="refresh" content="0; url=([^"]+)"', text)
        assert (folder / target).stat().st_size > 10_000, (old, target)


def test_equations_are_rendered_at_build_time(site):
    folder, _ = site
    pages = {page: page.read_text(encoding="utf-8") for page in folder.rglob("*.html")}
    assert sum("<math" in text for text in pages.values()) >= 3
    assert not [page.name for page, text in pages.items() if "arithmatex" in text]


class Silent(http.server.SimpleHTTPRequestHandler):
    """File server without a log."""

    def log_message(self, *_: object) -> None:
        """Suppress log messages."""


@needs_browser
def test_search_works_offline(site, browser):
    handler = partial(Silent, directory=site[0])
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        home = f"http://127.0.0.1:{server.server_port}/"
        page = browser.new_page()
        asked, complaints = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        for name in ("tutorial", "theory", "reference/scenarios", "index"):
            page.goto(f"{home}{name}.html", wait_until="networkidle")
        # key by key: the search listens to keys, and to a text filled in at once only with luck
        page.keyboard.press("/")
        page.locator("input:focus").press_sequentially("epsilon")
        page.locator("mark").first.wait_for()
        page.close()
        server.shutdown()
    assert complaints == [] and len(asked) > 10
    assert [address for address in asked if not address.startswith((home, "data:", "blob:"))] == []


EXECUTE = """
import json, sys, nbformat
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], 4)
NotebookClient(notebook, timeout=600, kernel_name="python3").execute()
nbformat.write(notebook, sys.argv[2])
"""


@pytest.mark.nightly
def test_tutorial_runs_with_shown_output(tmp_path):
    run("-W", "ignore", "-c", EXECUTE, NOTEBOOK, tmp_path / "run.ipynb")
    kept = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    new = json.loads((tmp_path / "run.ipynb").read_text(encoding="utf-8"))["cells"]
    assert len(new) == len(kept)

    def pictures(cells: list[dict]) -> int:
        outputs = [output for cell in cells for output in cell.get("outputs", ())]
        return sum("image/png" in output.get("data", {}) for output in outputs)

    def said(cells: list[dict]) -> str:
        outputs = [output for cell in cells for output in cell.get("outputs", ())]
        return "".join("".join(one["text"]) for one in outputs if one["output_type"] == "stream")

    assert pictures(new) == pictures(kept) == 2
    assert "tangent-merged collision-free 9" in said(new) and "report.html" in said(new)
    for name in ("shy", "bearing-only", "tangent-merged"):
        # on another processor a start may differ
        share = re.compile(rf"^{name} +collision-free (\d+)% \[", re.MULTILINE)
        (before,), (now,) = (share.findall(said(cells)) for cells in (kept, new))
        assert abs(int(before) - int(now)) <= 5, name
