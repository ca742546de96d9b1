"""Custom policies as ``module:function`` from the current folder."""

import importlib
import linecache
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import rendezvous_env as rv
from baselines.policy import kind_of
from train import cli, policies, resume, tasks
from train.checks import UserError
from train.compare import compare, playing
from train.figures import figures, render
from train.report import build
from train.report.input import read
from train.results import read_csv

MINE = '''
import baselines

RATE = 3

class Away(baselines.HeadingPolicy):
    """Made of a scenario alone."""

    def __init__(self, scenario):
        super().__init__(scenario, lambda seen: [0.3, 1.0] + 0.0 * seen[..., 0, :])

def law(scenario):
    """Law (1), where robots can."""
    if scenario.robot_model == "single_integrator":
        return baselines.make("bearing-only", scenario)

def sideways(scenario):
    return Away(scenario) if scenario.dim == 2 else None

def broken(scenario):
    return scenario.colour

def text(scenario):
    return "bearing-only"

def a_class(scenario):
    return Away

def flat(scenario):
    return lambda observations, time: 0.0 * observations[..., 0, 0]

def fails(scenario):
    return lambda observations, time: observations.colour

def of_one_team(scenario):
    return lambda observations, time: [[[0.0, 0.0]] * scenario.n_robots]
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Name of a module in the current folder that no test has imported before."""
    name = f"mine_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    yield name
    sys.modules.pop(name, None)


@pytest.mark.nightly
def test_custom_policy_is_compared_by_workers(mine, tmp_path, monkeypatch):
    monkeypatch.setattr(tasks, "_ALONE", 0.0)
    names = [f"{mine}:law", f"{mine}:sideways", f"{mine}:Away", "bearing-only"]
    words = ["--scenarios", "duo", "swarm-20", "--policies", *names, "--episodes", "4"]
    assert cli.main(["compare", *words, "--jobs", "2", "--out", str(tmp_path / "out")]) == 0
    rows = read_csv(tmp_path / "out" / "results.csv")
    found = {(row["scenario"], row["policy"]): row for row in rows}
    assert {policy for _, policy in found} == set(names)
    law, same = found["swarm-20", "bearing-only"], found["swarm-20", f"{mine}:law"]
    for column in ("success", "median_time", "path_length", "min_clearance"):
        assert law[column] == same[column]
    margins = [float(found["swarm-20", name]["min_alignment"]) for name in names[1:3]]
    assert margins[0] == margins[1] and 0.1 < margins[0] < 0.5


def test_custom_policy_returning_none_is_skipped(mine, tmp_path):
    names = (f"{mine}:law", "random")
    config = compare.Config(scenarios=("duo", "uav-6"), policies=names, out=tmp_path / "out")
    jobs = [(job.scenario.name, job.policy) for job in compare.plan(config)]
    assert jobs == [("duo", names[0]), ("duo", "random"), ("uav-6", "random")]
    assert policies.kind_of(names[0]) == "own" and policies.about(names[0]) == ""


def edit(mine):
    place = Path(f"{mine}.py")
    place.write_text(place.read_text() + "\n# another law\n")


def test_changed_source_is_another_comparison(mine, tmp_path):
    """After the import, workers would import another version than this process has."""
    config = compare.Config(scenarios=("duo",), policies=(f"{mine}:law",), out=tmp_path / "out")
    first = playing.plan_of(compare.plan(config), config)
    edit(mine)
    with pytest.raises(UserError, match=r"was edited since this program imported it; importlib"):
        compare.plan(config)
    with pytest.raises(UserError, match="was edited since"):
        policies.tried(f"{mine}:law", rv.Scenario(n_robots=3))
    importlib.reload(sys.modules[mine])
    again = playing.plan_of(compare.plan(config), config)
    assert resume.run_id(first) != resume.run_id(again)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_rows_come_from_one_source_version(jobs, mine, tmp_path, monkeypatch):
    """An edit during a comparison would reach workers, which import later."""
    monkeypatch.setattr(tasks, "_ALONE", 0.0)
    monkeypatch.setattr(compare, "plan_of", lambda *given: (playing.plan_of(*given), edit(mine))[0])
    given = {"scenarios": ("duo",), "policies": (f"{mine}:law",), "episodes": 3, "figures": False}
    config = compare.Config(**given, jobs=jobs, out=tmp_path / "out")
    if jobs == 1:
        assert compare.run(config) == 0
        return
    with pytest.raises(UserError, match="has changed since the comparison began"):
        compare.run(config)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:law", "no module 'no_such_module', neither installed nor as no_such_mod"),
        ("MINE:laws", r"has no 'laws'; did you mean 'law'\?"),
        ("MINE:RATE", r"RATE in MINE is 3; it must be a function of a scenario"),
        ("MINE:", r"write MODULE:FUNCTION, as in my_policies:make"),
        ("MINE/a.py:law", r"write MODULE:FUNCTION"),
        ("MINE:broken", r"for scenario 'duo': AttributeError: .*colour"),
        ("MINE:text", r"returned 'bearing-only' for scenario 'duo'; it must return"),
        ("MINE:a_class", r"returned .* for scenario 'duo'; it must return"),
        ("MINE:flat", r"in the first step of scenario 'duo': ValueError: actions"),
        ("MINE:fails", r"in the first step of scenario 'duo': AttributeError: .*colour"),
        ("broken_module:law", "importing broken_module failed: ZeroDivisionError: division"),
        ("needs_more:law", "importing needs_more failed: No module named 'no_such_module'"),
    ],
)
def test_custom_policy_errors_are_reported_before_work(mine, tmp_path, name, message):
    (tmp_path / "broken_module.py").write_text("1 / 0\n")
    (tmp_path / "needs_more.py").write_text("import no_such_module\n")
    name = name.replace("MINE", mine)
    config = compare.Config(scenarios=("duo",), policies=(name,), out=tmp_path / "out")
    with pytest.raises(UserError, match=message.replace("MINE", mine)) as caught:
        compare.plan(config)
    assert repr(name) in str(caught.value)
    drawn = render.Config("duo", name, out=tmp_path / "out" / "duo.png")
    with pytest.raises(UserError, match=message.replace("MINE", mine)):
        render.run(drawn)
    assert not drawn.out.parent.exists()


@pytest.mark.slow
def test_later_custom_policy_error_names_policy(mine, tmp_path, monkeypatch):
    monkeypatch.setattr(tasks, "_ALONE", 0.0)
    names, out = (f"{mine}:law", f"{mine}:of_one_team"), tmp_path / "out"
    given = {"scenarios": ("duo",), "policies": names, "episodes": 4, "out": out}
    for jobs in (1, 2):
        with pytest.raises(ValueError, match=r"actions have shape \(1, 2, 2\)") as caught:
            compare.run(compare.Config(**given, jobs=jobs, fresh=True))
        assert caught.value.__notes__ == [f"policy {names[1]!r} on scenario 'duo'"]


def test_user_module_does_not_shadow_others(mine, tmp_path):
    (tmp_path / "json.py").write_text("raise RuntimeError('the wrong module')\n")
    (tmp_path / "colorsys.py").write_text("raise RuntimeError('the wrong module')\n")
    sys.modules.pop("colorsys", None)
    policies.check_names([f"{mine}:law"])
    import colorsys

    assert colorsys.hsv_to_rgb(0.0, 0.0, 1.0) == (1.0, 1.0, 1.0)
    with pytest.raises(KeyError):
        kind_of(f"{mine}:law")


def test_registered_scenario_runs_in_this_process():
    """Other processes lack registered sensors, reward terms, graphs and models."""

    @rv.sensor_imperfection("of this process")
    def blank(seen):
        seen.neighbours[:] = 0.0

    own = rv.Scenario(n_robots=2, sensing=rv.Sensing(custom=("of this process",)))
    for scenario, stays in ((own, True), (rv.Scenario(n_robots=2, costs=("contact",)), False)):
        config = compare.Config(policies=("bearing-only",), episodes=3)
        job = playing.Job(scenario, "bearing-only")
        assert {task.stays for task in playing.blocks_of(0, job, config)} == {stays}


def test_function_of_main_runs_in_this_process(monkeypatch, tmp_path):
    """``__main__`` is another program in a worker or in a notebook."""
    monkeypatch.setattr(tasks, "_ALONE", 0.0)
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "mine", lambda scenario: lambda seen, time: seen[..., 0, :], False)
    for file in ("<stdin>", None):
        monkeypatch.setattr(main, "__file__", file, False)  # not there under xdist
        given = {"scenarios": ("duo",), "policies": ("__main__:mine",), "episodes": 3}
        config = compare.Config(**given, out=tmp_path / str(file), figures=False, jobs=2)
        assert compare.run(config) == 0


OWN = """
import rendezvous_env as rv
from baselines.policy import register

@rv.sensor_imperfection("plan-sensor")
def changed(seen):
    seen.neighbours *= 1.0

@rv.reward_term("plan-term")
def changed(step):
    return 1.0 * step.time

@rv.graphs.family("plan-family")
def changed(n, random):
    return [(0, i) for i in range(1.0 > 0, n)]

@register("plan-law", fits=lambda scenario: True)
def changed(scenario):
    return lambda seen, time: 1.0 * seen[..., 0, :]
"""


@pytest.mark.parametrize("in_file", [True, False])
def test_registered_extensions_are_part_of_plan(in_file, tmp_path, registry):
    """Otherwise an edit before resuming would mix old and new results."""
    cell = tmp_path / "cell.py"

    def planned(source):
        if in_file:
            cell.write_text(source)
        lines = source.splitlines(keepends=True)
        linecache.cache[str(cell)] = len(source), None, lines, str(cell)  # as notebooks do
        exec(compile(source, cell, "exec"), {"__name__": "cell"})
        for how in (
            {"sensing": rv.Sensing(custom=("plan-sensor",))},
            {"reward": rv.RewardWeights(custom={"plan-term": 1.0})},
            {"costs": ("plan-term",)},
            {"graph": "plan-family"},
            {},
        ):
            scenario = rv.Scenario(n_robots=3, **how)
            policy = "zero" if how else "plan-law"
            config = compare.Config(policies=(policy,), out=tmp_path)
            yield resume.run_id(playing.plan_of([playing.Job(scenario, policy)], config))

    first, same, other = (list(planned(OWN.replace("1.0", rate))) for rate in ("1.0", "1.0", "2.0"))
    assert first == same
    assert all(one != another for one, another in zip(first, other, strict=True))


class TestLabels:
    """Label of a policy in tables, figures and the report."""

    def test_a_label_stands_for_the_name(self, tmp_path):
        wanted = ("my law=bearing-only", "zero")
        config = compare.Config("duo", wanted, episodes=2, out=tmp_path / "out", against="my law")
        assert compare.run(config) == 0
        rows = read_csv(tmp_path / "out/results.csv")
        assert [row["policy"] for row in rows] == ["my law", "zero"]
        found = read(tmp_path / "out")
        assert found.run["labels"] == {"my law": "bearing-only"}
        (ranking,) = build.rankings(found)
        assert ranking.best == "my law"

    @pytest.mark.slow
    def test_a_labelled_reference_does_not_compete(self, tmp_path):
        wanted = ("oracle=privileged-planner", "tangent", "learned")
        config = compare.Config(
            ("clutter-4",), wanted, episodes=2, out=tmp_path / "out", figures=False
        )
        assert compare.run(config) == 0
        (ranking,) = build.rankings(read(tmp_path / "out"))
        assert ranking.references == ("oracle",)

    @pytest.mark.parametrize(
        ("wanted", "message"),
        [
            (("a=zero", "a=random"), "two policies have the label 'a'"),
            (("a=zero", "b=zero"), "policy 'zero' is named twice"),
            (("learned=zero",), "label 'learned' is invalid"),
            ((" =zero",), "label ' ' is invalid"),
            (("a=zeero",), "policy 'zeero' is unknown; did you mean 'zero'"),
        ],
    )
    def test_a_label_that_cannot_be_is_refused(self, wanted, message):
        with pytest.raises(UserError, match=message):
            compare.plan(compare.Config(("duo",), wanted))

    def test_a_path_may_hold_an_equals_sign(self):
        assert policies.labels_of(["learned:runs/a=b"]) == {"learned:runs/a=b": ""}
        assert policies.labels_of(["c=learned:runs/a=b"]) == {"learned:runs/a=b": "c"}


def test_own_policies_have_distinct_colours_and_markers():
    rows = [{"policy": name} for name in ("zero", "learned", *"abcdefgh", "bearing-only")]
    own = figures.own_names(rows)
    assert own == list("abcdefgh")
    styles = {(figures.policy_colour(n, own), figures.policy_marker(n, own)) for n in own}
    assert len(styles) == 8
    assert len({figures.policy_colour(name, own) for name in own[:7]}) == 7
    known = {
        figures.policy_colour(n) for n in ("bearing-only", "learned", "tangent-merged", "zero")
    }
    assert not known & {figures.policy_colour(name, own) for name in own}


def test_a_long_path_is_shown_by_its_end():
    assert figures.shown_name("tangent-blocking-certified") == "tangent-blocking-certified"
    shown = figures.shown_name("learned:/home/somebody/runs/a-very-long-name/step-1000")
    assert shown == "learned:…-long-name/step-1000"


def test_config_takes_scenario_objects(tmp_path):
    team = rv.Scenario(name="my team", n_robots=3, time_limit=5.0)
    config = compare.Config([team, "duo"], "bearing-only", episodes=2, out=tmp_path / "out")
    again = pickle.loads(pickle.dumps(replace(config, seed=1)))
    assert [job.scenario for job in compare.plan(again)] == [team, rv.scenarios.get("duo")]
    assert compare.run(replace(config, figures=False)) == 0
    assert read(tmp_path / "out").scenarios["my team"] == team
    (job,) = compare.plan(compare.Config(team, "bearing-only", set="n_robots=4"))
    assert job.scenario == team.replace(n_robots=4, name="my team-n-robots-4")
