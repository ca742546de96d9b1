"""README and docs: code runs, commands parse, names and links exist."""

import re
import shlex
import shutil
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest
import tyro
from conftest import ROOT

import rendezvous_env as rv
from baselines import policy
from rendezvous_env.rewards.custom_terms import TERMS
from train import tasks
from train.cli import COMMANDS
from train.results import FORMAT_VERSION

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TARGETS = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))


def blocks(page: Path, language: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def shortened(block: str) -> str:
    """A block with its training, if any, limited to one rollout."""
    return block.replace("100_000", "4_096")


def each(pages: list[Path]) -> list[object]:
    return [pytest.param(page, id=page.relative_to(ROOT).as_posix()) for page in pages]


def with_blocks(language: str, pages: list[Path] = PAGES) -> list[object]:
    return each([page for page in pages if blocks(page, language)])


@pytest.fixture
def own_modules(monkeypatch, tmp_path, registry):
    """Remove the registrations and imports of a page after it."""
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "/").parent == tmp_path:
            del sys.modules[name]


@pytest.mark.slow
@pytest.mark.parametrize("page", with_blocks("python", PAGES[1:]))
def test_every_python_block_runs(page, tmp_path, monkeypatch, own_modules):
    """Each page is one program in a separate folder; README.md has a separate test.

    A block that begins with the name of a file is that file.
    """
    if page.name == "jax.md":
        pytest.importorskip("jax")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        if file := re.match(r"# (\w+\.py)\n", block):
            Path(file[1]).write_text(block, encoding="utf-8")
        else:
            exec(compile(shortened(block), str(page), "exec"), names)


def test_every_python_block_of_the_readme_runs(capsys):
    pytest.importorskip("stable_baselines3")
    found = blocks(PAGES[0], "python")
    names: dict[str, object] = {}
    for block in found:
        exec(compile(shortened(block), "README.md", "exec"), names)
    assert len(found) == 2
    assert names["model"].num_timesteps == 8_192  # 4,096, rounded up to whole rollouts
    printed = capsys.readouterr().out.splitlines()[-2:]
    shown = re.findall(r"^print.*# (.*)$", found[1], flags=re.MULTILINE)
    assert len(shown) == 2
    assert printed[0] == shown[0]
    assert float(printed[1]) == pytest.approx(float(shown[1]), abs=0.5)


def test_readme_names_every_command_and_existing_scenarios():
    text = PAGES[0].read_text(encoding="utf-8")
    assert set(re.findall(r"`rendezvous (\w+)", text)) == set(COMMANDS)
    shown = set(re.findall(r'"((?:fig|swarm-|ring-|clutter-)\w+)"', text))
    assert shown and shown <= set(rv.scenarios.names())
    assert (ROOT / "docs/images/guarantee-price.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", with_blocks("bash"))
def test_every_command_parses(page, monkeypatch):
    """Long commands are not run, only parsed, also without Ray."""
    monkeypatch.setattr(tasks, "check_installed", lambda *needed: None)
    seen = 0
    for line in "\n".join(blocks(page, "bash")).replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if not words or words[0] in ("cd", "git", "pip", "."):
            continue
        seen += 1
        if words[0] == "make":
            assert set(words[1:]) <= TARGETS, line
            continue
        if words[0].startswith(".venv/bin/"):
            words[0] = words[0].removeprefix(".venv/bin/")
        assert words[0] in ("rendezvous", "python"), line
        if words[0] == "python":
            assert (ROOT / words[1]).is_file(), line
            continue
        config = import_module(f"train.{COMMANDS[words[1]][0]}").Config
        tyro.cli(config, args=words[2:])
    assert seen


def test_every_toml_block_is_a_scenario(tmp_path, monkeypatch):
    """The reward term of rewards.md requires an imported file, the map of maps.md its image."""
    for name in ("office.yaml", "office.png"):
        shutil.copy(ROOT / "examples" / "maps" / name, tmp_path)
    monkeypatch.setitem(TERMS, "effort", lambda step: -step.time)
    file, found = tmp_path / "shown.toml", {}
    for page in PAGES:
        for block in blocks(page, "toml"):
            file.write_text(block, encoding="utf-8")
            assert page.stem not in found
            found[page.stem] = rv.Scenario.from_toml(file)
    assert found["faq"].n_robots == 6 and len(found["faq"].obstacles) > 0
    assert len(found["maps"].obstacles) > 100 and found["maps"].start_region
    assert found["graphs"].sensing_graph.order == "random"
    assert found["rewards"].reward.custom == (("effort", -0.01),)
    assert found["sensing"].sensing == rv.Sensing(field_of_view=2.0, noise=0.05, occlusion="both")


def test_code_blocks_have_known_languages():
    for page in PAGES:
        shown = set(re.findall(r"^```(\w+)", page.read_text(encoding="utf-8"), flags=re.MULTILINE))
        assert shown <= {"python", "bash", "text", "toml"}, page


@pytest.mark.parametrize("page", each(PAGES))
def test_links_resolve(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if not target.startswith(("http", "mailto:")):
            assert (page.parent / target).exists(), target


MODULE = re.compile(r"`((?:train|rendezvous_env|baselines)(?:\.\w+)+)`")


@pytest.mark.parametrize("page", each(PAGES))
def test_modules_and_files_exist(page):
    """The first cells of tables in migration pages, which hold old names, are excluded."""
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:train|rendezvous_env|baselines)/[\w./]+)`", text):
        assert "__pycache__" in path or (ROOT / path).exists(), path  # with NUMBA_CACHE_DIR none
    if page.name == "migration.md":
        assert len(MODULE.findall(text)) > 15
        text = re.sub(r"^\|[^|]*\|", "", text, flags=re.MULTILINE).replace("import train.", "")
    for name in MODULE.findall(text):
        assert resolve_name(name) is not None, name


def test_scenarios_and_policies_exist():
    scenarios = set(rv.scenarios.names())
    policies = set(policy.names())
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"--scenarios? ([\w.-]+)", text):
            assert name in scenarios or name.endswith(".toml") or name == "S", (page, name)
        for names in re.findall(r"--policies ([\w.: -]+)", text):
            for name in names.split(" --")[0].split():
                assert name in policies or ":" in name, (page, name)


def test_results_format_version_is_current():
    text = (ROOT / "docs/migration.md").read_text(encoding="utf-8")
    assert f"`format_version` {FORMAT_VERSION} in `run.json`" in text


def test_every_page_is_in_index():
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"]({page.name})" in index


def test_all_scenarios_and_policies_are_listed():
    described = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
    for name in rv.scenarios.names():
        scenario = rv.scenarios.get(name)
        robots = f"{scenario.n_robots} × {scenario.model.name}, {scenario.dim}-D"
        assert f"| ![{name}](images/scenarios/{name}.png) | `{name}` | {robots} |" in described
    laws = (ROOT / "docs/laws.md").read_text(encoding="utf-8")
    for name in policy.names():
        assert f"`{name}`" in laws, name
