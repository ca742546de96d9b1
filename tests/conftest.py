"""Common fixtures: the four robot models, and a full run of a law."""

import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib import import_module
from pathlib import Path

# the tests run beside others on few cores
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import pytest
from hypothesis import settings

import baselines
from baselines import policy as policies
from rendezvous_env import Scenario, Simulator
from rendezvous_env.compilation import compiled
from rendezvous_env.robots import robot_models

settings.register_profile("rendezvous", deadline=None, derandomize=True, print_blob=False)
settings.load_profile("rendezvous")
# it draws from the constants of all modules imported so far, which hang on the other tests of the
# process: cases would be others in each
with suppress(ImportError, AttributeError):
    from hypothesis.internal.conjecture import providers

    providers._get_local_constants = lambda: providers._local_constants


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--every-kernel",
        action="store_true",
        help="fail unless every kernel has run; see tests/kernel_coverage.py",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Configure warnings of uncompiled kernels, temporary files, and kernel coverage."""
    if not compiled():  # numbers of streams wrap around, which compiled code says nothing of
        config.addinivalue_line("filterwarnings", "ignore:overflow encountered:RuntimeWarning")
    if not hasattr(config, "workerinput"):  # a worker has its controller's
        use_own_temporary_folder(config)
    if config.option.every_kernel:
        from kernel_coverage import EveryKernel

        config.pluginmanager.register(EveryKernel(config, Path(os.environ["TMPDIR"]) / "checked"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Leave all modules and tests out of garbage collections, which would take minutes in all."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def use_own_temporary_folder(config: pytest.Config) -> None:
    """Remove all temporary files at the end of the run."""
    for left in Path(tempfile.gettempdir()).glob("rv-*-*"):  # by runs that were killed
        try:
            os.kill(int(left.name.split("-")[1]), 0)
        except ProcessLookupError:
            shutil.rmtree(left, ignore_errors=True)
    ours = tempfile.TemporaryDirectory(prefix=f"rv-{os.getpid()}-", ignore_cleanup_errors=True)
    # pytest's own folders stay where they were: those of failures are kept
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    os.environ["TMPDIR"], tempfile.tempdir = ours.name, None
    config.add_cleanup(ours.cleanup)


LONG = (
    "test_random_scenarios", "test_installed", "test_batch_equals_singles", "test_unions",
    "test_robot_policy", "test_gradients", "test_sensing_engine", "test_paper",
    "test_guarantee_wrappers", "test_interrupts", "test_examples", "test_same_experiment",
    "test_standalone", "test_policies", "test_robot_sensors", "test_privileged_planner",
    "test_contacts_among_shapes", "test_kernel_cache", "test_site", "test_research_scripts",
    "test_kernel_coverage", "test_fuzz_core", "test_fuzz_files", "test_sensor_fit",
    "test_double_integrator", "test_transformations", "test_docs", "test_every_policy",
    "test_package", "test_resuming", "test_workers", "test_shipped",
)  # fmt: skip
"""Slowest test files in the order of distribution to two workers. Files with the same kernels are
separated, or both workers would compile those."""


COLLECTED = pytest.StashKey[list[pytest.Item]]()
"""All collected tests, before some are selected."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark repetitions ``nightly``, then order long files first.

    Files with many tests come next, so that no worker ends with a long file.
    """
    for item in repetitions(items):
        item.add_marker(pytest.mark.nightly)
    config.stash[COLLECTED] = items.copy()
    tests = Counter(item.path for item in items)

    def rank(item: pytest.Item) -> tuple[int, int]:
        name = item.path.stem
        return LONG.index(name) if name in LONG else len(LONG), -tests[item.path]

    items.sort(key=rank)


def repetitions(items: list[pytest.Item]) -> Iterator[pytest.Item]:
    """Tests that repeat others of the same function with further parameters.

    Of combinations of several parameters each value occurs in one test, if possible a fast one.
    A single parameter that is ``slow`` beside others that are not is a repetition, unless it is
    marked ``slow(own_path=True)``.
    """
    functions = defaultdict(lambda: defaultdict(dict))
    for item in items:
        marks = list(item.iter_markers("slow"))
        kept = item.get_closest_marker("nightly") or any("own_path" in m.kwargs for m in marks)
        if isinstance(item, pytest.Function) and not kept:
            # the names of its values, one for each decorator or fixture with parameters
            names = item.callspec._idlist if hasattr(item, "callspec") else ()
            functions[item.nodeid.partition("[")[0]][len(marks)][item] = set(enumerate(names))
    for levels in functions.values():
        seen = set()
        for level, tests in sorted(levels.items()):
            if level == min(levels) or len(next(iter(tests.values()))) > 1:
                take_unseen(tests, seen)
            yield from (test for test, values in tests.items() if values)


def take_unseen(tests: dict[pytest.Item, set], seen: set) -> None:
    """Remove tests that have all unseen values among them, few of them, and add their values."""
    while unseen := set().union(*tests.values()) - seen:
        best = max(tests, key=lambda test: len(unseen & tests[test]))
        seen |= tests.pop(best)


ROOT = Path(__file__).parent.parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None and not os.environ.get("CI"),
    reason="no chromium on this machine; apt-get install chromium",
)
MODELS = {
    "single_integrator-2d": {"robot_model": "single_integrator", "dim": 2},
    "single_integrator-3d": {"robot_model": "single_integrator", "dim": 3},
    "unicycle": {"robot_model": "unicycle", "dim": 2},
    "nonholonomic_3d": {"robot_model": "nonholonomic_3d", "dim": 3},
}
LAWS = {
    "single_integrator": "bearing-only",
    "unicycle": "unicycle",
    "nonholonomic_3d": "nonholonomic-3d",
}
UNEQUAL = np.array(
    [
        [0.0, 2.0, 0.0, 0.5, 0.0],
        [2.0, 0.0, 1.3, 0.0, 0.0],
        [0.0, 1.3, 0.0, 0.7, 1.1],
        [0.5, 0.0, 0.7, 0.0, 0.9],
        [0.0, 0.0, 1.1, 0.9, 0.0],
    ]
)
"""Five robots, six links, no symmetry."""


def unequal_matrix(n: int, seed: int = 0, share: float = 0.3) -> np.ndarray:
    """Connected weight matrix with a random spanning tree, further links and unequal weights."""
    random = np.random.default_rng(seed)
    links = np.triu(random.random((n, n)) < share, 1)
    for i in range(1, n):
        links[random.integers(i), i] = True
    weights = np.where(links, random.uniform(0.5, 2.0, (n, n)), 0.0)
    return weights + weights.T


def five(kind: str, **changes: object) -> Scenario:
    """Asymmetric team of five robots of one of the MODELS."""
    return Scenario(**{"n_robots": 5, "graph": UNEQUAL, **MODELS[kind], **changes})


def law_of(scenario: Scenario) -> baselines.Policy:
    """Law of the paper for the scenario's robots."""
    return baselines.make(LAWS[scenario.robot_model], scenario)


def run_python(cwd: Path, *words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a new process, which must succeed, and return its output."""
    found = subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True, text=True, cwd=cwd, env=os.environ | environment, timeout=900,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    return found


def contents(folder: Path) -> dict[str, bytes | None]:
    """All files below a folder, by relative path; None for a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def started(scenario: Scenario, teams: int = 1, seed: object = 0, **options: object) -> Simulator:
    """A simulator after a reset with options."""
    simulator = Simulator(scenario, teams)
    simulator.reset(seed, options)
    return simulator


def actions_shape(simulator: Simulator) -> tuple[int, int, int]:
    """Shape (B, n, a) of a simulator's actions."""
    scenario = simulator.scenario
    return simulator.num_envs, scenario.n_robots, scenario.action_size


@pytest.fixture(params=list(MODELS))
def kind(request: pytest.FixtureRequest) -> str:
    """Each of the MODELS."""
    return str(request.param)


def assert_same_state(state: Simulator | dict, other: Simulator | dict) -> None:
    """Assert bitwise equality of simulators, or of their states."""
    one, two = (s if isinstance(s, dict) else s.get_state() for s in (state, other))
    np.testing.assert_equal(one, two)


@contextmanager
def refusing(simulator: Simulator, message: str, error: type[Exception] = ValueError) -> Iterator:
    """Assert that the body is rejected and leaves the simulator or wrapper unchanged."""
    before = simulator.get_state()
    with pytest.raises(error, match=message):
        yield
    assert_same_state(simulator, before)


@pytest.fixture
def without_rights() -> Callable[[Path], AbstractContextManager[None]]:
    """Context in which a folder is not readable, even for a privileged test run."""

    @contextmanager
    def revoke(folder: Path) -> Iterator[None]:
        mode, me = folder.stat().st_mode, os.geteuid()
        folder.chmod(0o000)
        if me == 0:
            os.seteuid(65534)
        try:
            yield
        finally:
            if me == 0:
                os.seteuid(0)
            folder.chmod(mode)

    return revoke


@pytest.fixture(autouse=True, scope="session")
def one_process():
    """Disable workers by default, since tests cannot inspect them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.tasks.Workers.worker_count", property(lambda own: own.jobs or 1))
        yield


@pytest.fixture(scope="session")
def compared(tmp_path_factory):
    """Files of a small comparison: obstacles in the plane, and 3-D robots."""
    from train.compare import compare

    out = tmp_path_factory.mktemp("compared")
    policies = ("bearing-only", "tangent-merged", "nonholonomic-3d", "zero")
    config = compare.Config(("fig4", "uav-6"), policies, episodes=4, seed=3, keep=2, out=out)
    assert compare.run(config) == 0
    return out


@pytest.fixture(scope="session")
def reseal():
    """Renew the digests of run.json, as ``compare`` would write them."""
    from train.compare import out_folder

    def seal(folder, **changes):
        about = json.loads((folder / "run.json").read_text()) | changes
        names = [name for name in about.pop("files") if (folder / name).is_file()]
        out_folder.seal(folder, names, {key: about[key] for key in about if key != "sha256"})

    return seal


@pytest.fixture
def one_line(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Function that returns the one-line message of a command that rejects its input."""
    from train import cli

    def refused(*words: object) -> str:
        assert cli.main([str(word) for word in words]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "Traceback" not in said
        return said

    return refused


@pytest.fixture
def registry():
    """All policies by name; policies and models registered by a test are removed after it."""
    registries = robot_models.ROBOT_MODELS, policies._registry
    known = [registry.copy() for registry in registries]
    yield registries[1]
    for entries, before in zip(registries, known, strict=True):
        entries.clear()
        entries.update(before)


@pytest.fixture
def set_threads():
    """torch.set_num_threads; restores the number afterwards."""
    import torch

    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM, "no chromium on this machine; .ci/run installs it"
    with sync_playwright() as playwright:
        flags = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an uninterrupted training run."""
    from training_runs import config

    from train.learn import ppo

    folder = tmp_path_factory.mktemp("runs") / "whole"
    assert ppo.run(config(folder)).status == 0
    return folder


@pytest.fixture
def rj():
    """``rendezvous_env.jax`` with numbers in float64, as the engine's are."""
    jax = pytest.importorskip("jax")
    # jax_disable_most_optimizations would compile faster, but computes other numbers
    with jax.enable_x64(True):
        yield import_module("rendezvous_env.jax")
