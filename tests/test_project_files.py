"""Project files: the list of guarantees, continuous integration, containers."""

import json
import re
import tomllib
from collections import defaultdict
from functools import cache

import yaml
from conftest import COLLECTED, ROOT, run_python, take_unseen

CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
WORKFLOWS = {
    path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
    for path in (ROOT / ".github/workflows").iterdir()
}
JOBS = {name: job for workflow in WORKFLOWS.values() for name, job in workflow["jobs"].items()}
OUTSIDE = {"data", "adapters", "research"}
"""Test folders without a guarantee: data, other libraries, scripts."""


def promised_tests() -> list[str]:
    """Tests in the table of guarantees, by file and name."""
    return re.findall(r"^\|[^|]+\| `(tests/[\w/.:]+)` \|$", CONTRIBUTING, flags=re.MULTILINE)


def commands(job: str) -> list[str]:
    """The shell commands of a job of the workflow."""
    return [line for step in JOBS[job]["steps"] for line in step.get("run", "").splitlines()]


def is_among(test: str, ids: list[str]) -> bool:
    """True if a file, a class or a function of tests has one of the ids."""
    return any(re.match(rf"{re.escape(test)}($|::|\[)", one) for one in ids)


def test_promises_name_fast_tests(request):
    """Looked up in this run; what it does not select is collected by another one."""
    named = promised_tests()
    assert len(named) > 40
    chosen = [item.nodeid for item in request.session.items if tier_of(item) == "fast"]
    if left := [name for name in named if not is_among(name, chosen)]:
        found = run_python(ROOT, "-m", "pytest", "--collect-only", "-q", *left).stdout.splitlines()
        assert not [name for name in left if not is_among(name, found)]


@cache
def selections():
    """Expression of markers by which the command of each tier selects tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    commands = {
        "fast": project["tool"]["pytest"]["ini_options"]["addopts"],
        "slow": recipe("test-slow"),
        "nightly": recipe("test-nightly"),
    }
    found = {
        tier: re.search(r"-m ('[^']+'|(?!pytest)\w+) ", line) for tier, line in commands.items()
    }
    return {tier: expression[1].strip("'") for tier, expression in found.items()}


def tier_of(item):
    """Name of the only tier that has a test."""
    marks = {name: item.get_closest_marker(name) is not None for name in ("slow", "nightly")}
    found = [tier for tier, expression in selections().items() if eval(expression, {}, marks)]
    assert len(found) == 1, (item.nodeid, found)
    return found[0]


def test_every_test_is_in_exactly_one_tier(request):
    """A function or a file with nightly tests has others, unless its marker says otherwise."""
    tiers, functions = defaultdict(set), defaultdict(set)
    for item in request.config.stash[COLLECTED]:
        tiers[item.path].add(tier := tier_of(item))
        whole = any(mark.name == "nightly" for mark in getattr(item.function, "pytestmark", ()))
        functions[item.nodeid.partition("[")[0]].add("marked" if whole else tier)
    assert not [path for path, found in tiers.items() if found == {"nightly"}]
    assert not [function for function, found in functions.items() if found == {"nightly"}]


def test_repetitions_have_no_value_of_their_own():
    values = {(x, y): {(0, x), (1, y)} for x in "abc" for y in range(4)}
    left, seen = values.copy(), {(0, "a")}
    take_unseen(left, seen)
    assert seen == set().union(*values.values())
    assert len(values) - len(left) == 4  # as many as the longer parameter has values
    assert values.keys() > left.keys()


def test_every_folder_of_tests_has_a_promise():
    folders = {path.name for path in (ROOT / "tests").iterdir() if any(path.glob("test_*.py"))}
    assert "engine" in folders
    assert folders - OUTSIDE <= {name.split("/")[1] for name in promised_tests()}


def test_workflow_covers_systems_and_pythons():
    matrix = JOBS["test"]["strategy"]["matrix"]
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert any(line.startswith("make test ") for line in commands("test"))
    assert ".ci/run" in commands("full")
    assert any("pip wheel" in line for line in commands("wheel"))


def test_workflow_jobs_are_described():
    described = re.search(r"The jobs (.*?) have not run yet", CONTRIBUTING)
    assert described is not None
    assert set(re.findall(r"`(\w+)`", described[1])) == set(JOBS)


def test_ci_script_calls_the_test_commands_of_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"^make (test[\w-]*)", readme, flags=re.MULTILINE))
    assert shown == {"test", "test-all", "test-nightly"}
    called = re.findall(r"^make (.*)", (ROOT / ".ci/run").read_text(), flags=re.MULTILINE)
    assert shown - {word for line in called for word in line.split()} == {"test-nightly"}
    assert "make test-nightly" in commands("nightly")
    assert "schedule" in WORKFLOWS["nightly"][True]  # YAML 1.1 reads "on" as true


def test_containers_use_stages_of_the_dockerfile():
    stages = set(re.findall(r"^FROM .* AS (\w+)", DOCKERFILE, flags=re.MULTILINE))
    settings = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    assert settings["build"]["target"] in stages
    assert set(JOBS["container"]["strategy"]["matrix"]["target"]) <= stages


def test_image_holds_every_file_that_it_copies():
    kept = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    copied = re.findall(r"^COPY (.+) \S+$", DOCKERFILE, flags=re.MULTILINE)
    names = {name for line in copied for name in line.split()}
    assert names == {line.removeprefix("!") for line in kept if line.startswith("!")}
    assert all((ROOT / name).exists() for name in names)


def recipe(target: str) -> str:
    """Commands of a target of the Makefile."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", makefile, flags=re.MULTILINE)
    assert found is not None, target
    return found[1]


def test_every_workflow_container_and_script_is_linted():
    linted = recipe("lint-ci")
    assert all(path in linted for path in (".github/workflows", "Dockerfile", ".ci/run"))
    pinned = (ROOT / "constraints-lint.txt").read_text(encoding="utf-8")
    for tool in ("check-jsonschema", "zizmor", "hadolint", "shellcheck"):
        assert f"/{tool} " in linted and tool in pinned


def test_newer_pythons_run_folders_that_exist():
    folders = re.findall(r"tests/\w+", recipe("test-pythons"))
    assert len(folders) > 3 and all((ROOT / folder).is_dir() for folder in folders)
