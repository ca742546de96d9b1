"""Leaderboard: statistics by hand, reproducible runs, guarantee of the filter."""

import json
import re
import shutil
from collections import defaultdict
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, contents
from parameters import slow

import rendezvous_env as rv
from rendezvous_env import scenarios
from train import cli
from train.checks import UserError
from train.compare import Job, play_job, statistics
from train.leaderboard import command, registry, run_records, tables
from train.leaderboard.algorithms.ppo import multiplier_of
from train.leaderboard.algorithms.ppo_cbf import Barrier, kept_out
from train.leaderboard.environments import make_training_envs
from train.leaderboard.playing import EvaluationSetup, play
from train.learn.settings import EVALUATION_SEEDS

SMALL = command.Config(
    algorithms=("bearing-only", "ppo-heading"), fields=("clutter-8",), seeds=(0, 1), decisions=64,
    episodes=8, jobs=1,
)  # fmt: skip


class TestStatistics:
    def test_interquartile_mean_drops_outer_quarters(self):
        scores = np.array([[0.0, 0.5], [0.6, 100.0]])
        assert statistics.interquartile_mean(scores) == pytest.approx(0.55)

    def test_stratified_interval_resamples_per_scenario(self):
        # fields that differ and seeds that do not: a draw across fields would spread
        alike, apart = np.array([[0.0, 1.0], [0.0, 1.0]]), np.array([[0.0, 0.0], [1.0, 1.0]])
        assert statistics.stratified_interval((alike,), np.mean) == (0.5, 0.5)
        assert statistics.stratified_interval((apart,), np.mean) == (0.0, 1.0)
        assert np.isnan(statistics.stratified_interval((apart[:1],), np.mean)).all()

    def test_probability_of_improvement_counts_pairs(self):
        own, other = np.array([[1.0, 0.0], [2.0, 0.0]]), np.array([[1.0, 5.0], [0.0, 5.0]])
        # field 0: 1 of (1,1) ½, (1,0) 1, (2,1) 1, (2,0) 1; field 1: none
        assert statistics.probability_of_improvement(own, other) == (3.5 / 4 + 0.0) / 2
        assert statistics.probability_of_improvement(own, own) == pytest.approx(0.5, abs=0.01)

    def test_performance_profile_is_fraction_above_level(self):
        scores, levels = np.array([[0.2, 0.4], [0.6, 0.8]]), np.array([0.0, 0.5, 0.8, 0.9])
        profile = statistics.performance_profile(scores, levels)
        np.testing.assert_array_equal(profile, [1.0, 0.5, 0.25, 0.0])

    def test_scenarios_with_different_seeds_are_combined(self):
        about = {key: "none" for key in ("safety", "guarantee", "given")}
        own = [
            about | {"algorithm": name, "field": field, "seed": seed, "results": {
                "clean": [clean], "time": [1.0], "steps": [1], "touches": [0], "risen": [0],
                "rise": [0.0],
            }}
            for name in ("one", "two")
            for field, seed, clean in (("a", 0, 0.0), ("a", 4, 0.5), ("b", 2, 1.0))
        ]  # fmt: skip
        assert tables.scores_of(own[:3], "collision_free").tolist() == [[0.0, 1.0]]
        assert (
            tables.rows_of(own)[0].items()
            >= {"runs": 2, "collision_free": 0.5, "robot_steps": 3}.items()
        )
        assert tables.improvements(own)[0]["probability"] == 0.5


@pytest.mark.kernels
class TestBarrier:
    def test_barrier_limits_velocity_towards_disc(self):
        random = np.random.default_rng(0)
        u, turned = random.normal(size=(500, 2)), random.uniform(0, 2 * np.pi, (500, 3))
        away = np.stack((np.cos(turned), np.sin(turned)), axis=-1)
        least = -random.uniform(0.0, 1.0, (500, 3))
        v = kept_out(u, away, least)
        assert ((away * v[:, None]).sum(axis=-1) >= least - 1e-12).all()
        assert (np.linalg.norm(v, axis=-1) <= np.linalg.norm(u, axis=-1) + 1e-12).all()
        # one constraint is the projection
        v = kept_out(np.array([[1.0, -2.0]]), np.array([[[0.0, 1.0]]]), np.array([[-0.5]]))
        np.testing.assert_allclose(v, [[1.0, -0.5]])

    def test_barrier_prevents_contact(self):
        field = rv.scenarios.get("clutter-16").replace(costs=("contact",), time_limit=20.0)
        paid = []
        for wrap in (lambda teams: teams, Barrier):
            teams = wrap(rv.make_vec(field, 16, autoreset_mode="disabled", n_robots=2))
            teams.reset(seed=0)
            random = np.random.default_rng(1)
            wanted = random.uniform(-1, 1, teams.action_space.shape).astype(np.float32)
            paid.append(sum(teams.step(wanted)[4]["cost"].sum() for _ in range(150)))
        assert paid[0] > 20 and paid[1] == 0


@pytest.mark.slow
def test_filters_differ_in_contacts_and_rises():
    field, risen, touches = scenarios.get("clutter-16"), {}, {}
    for safety in ("none", "rule", "heading"):
        teams = make_training_envs(field, 6, safety=safety, anew=False)
        aside = teams.single_action_space.nvec[0] - 1  # the choice farthest aside of f
        found = play(EvaluationSetup(teams, lambda seen, time, n=aside: np.full(seen.shape[:2], n)))
        risen[safety], touches[safety] = sum(found["risen"]), sum(found["touches"])
        assert sum(found["steps"]) > 1000 and len(found["clean"]) == 6
    assert risen["heading"] == 0 and risen["rule"] > 1000
    assert touches["rule"] == 0 < touches["none"]


def test_lagrange_multiplier_grows_with_contacts_and_is_bounded():
    """λ ← λ + 2 (J − 0.1)/16 after a rollout with J contacts per episode."""
    paid, robots = SimpleNamespace(multiplier=0.0), SimpleNamespace(costs={})
    rule = multiplier_of(paid, robots, 0.1)
    for touches, ended, expected in ((3, 2, 0.175), (0, 0, 0.175), (0, 1, 0.1625), (900, 1, 20.0)):
        robots.costs = {"cost_contact": np.array([touches])}
        rule.locals = {"infos": [{"episode": 1}] * ended + [{}]}
        assert rule._on_step()
        rule._on_rollout_end()
        assert paid.multiplier == pytest.approx(expected)


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    out = tmp_path_factory.mktemp("board") / "out"
    assert command.run(replace(SMALL, out=out)) == 0
    return out


def test_leaderboard_writes_record_per_run_and_tables(board):
    cards = run_records.read_records(board)
    assert [(card["algorithm"], card["seed"], card["decisions"]) for card in cards] == [
        ("bearing-only", 0, 0), ("ppo-heading", 0, 64), ("ppo-heading", 1, 64),
    ]  # fmt: skip
    for card in cards:
        assert card["field"] == "rendezvous/clutter-8-v1" and len(card["results"]["clean"]) == 8
        assert card["digest"] == scenarios.digests()["clutter-8-v1"] and "numpy" in card["versions"]
    assert cards[1]["results"] != cards[2]["results"]
    rows = {row["algorithm"]: row for row in command.results.read_csv(board / "leaderboard.csv")}
    own, law = rows["bearing-only"], cards[0]["results"]
    assert float(own["collision_free"]) == np.mean(law["clean"])
    assert float(own["touches"]) == pytest.approx(1000 * sum(law["touches"]) / sum(law["steps"]))
    assert rows["ppo-heading"]["risen"] == "0.0" and own["collision_free_low"] == ""
    names = "cells replays leaderboard.csv improvement.csv price.png profiles.png README.md"
    assert {path.name for path in board.iterdir()} == set(names.split())
    replays = {path.parent.name + path.name for path in board.glob("replays/*/*")}
    assert replays == {f"{name}clutter-8-v1-seed-0.json" for name in rows}
    assert not board.with_name("out.part").exists()


def test_law_is_evaluated_as_in_compare(board):
    """Another loop gives the same times for the same initial conditions and policy."""
    job = Job(scenarios.get("clutter-8"), "bearing-only")
    played = play_job(job, episodes=8, seed=EVALUATION_SEEDS).episodes
    law = run_records.read_records(board)[0]["results"]
    assert law["success"] == played.success.astype(int).tolist()
    assert law["clean"] == played.collision_free.astype(int).tolist()
    np.testing.assert_allclose(law["time"], played.time, atol=1e-6)
    assert law["touches"] == played.contacts.tolist()


@pytest.mark.slow
def test_repeat_reproduces_record_bitwise_or_reports_difference(board, capsys):
    card = board / "cells/ppo-heading/clutter-8-v1-seed-1.json"
    other = board.with_name("other.json")
    assert command.run(replace(SMALL, repeat=card)) == 0
    changed = json.loads(card.read_text())
    changed["results"]["time"][0] += 1.0
    for clean, where in ((changed["results"]["clean"], "within"), ([0] * 8, "outside")):
        changed["results"]["clean"] = clean
        other.write_text(json.dumps(changed))
        assert command.run(replace(SMALL, repeat=other)) == 1
        said = capsys.readouterr().err
        assert "results differ" in said and f"{where} the 95 % interval of the difference" in said
    wrong = [{"seed": seed} for seed in ("a", True, 1.0, -1, 2**29)]
    wrong += [{"episodes": 7}, {"episodes": 0}, {"decisions": "64"}, {"guarantee": "all"}]
    wrong += [{"versions": 1}, {"field": "mine/clutter-8-v1"}]
    for own in ({"time": [1.0]}, {"time": [np.nan] * 8}, {"steps": [0] * 8}, {"clean": [7] * 8}):
        wrong.append({"results": changed["results"] | own})
    texts = [json.dumps(changed | own) for own in wrong]
    del changed["learning_s"]
    for text in ("{}", "[1]", "no card", json.dumps(changed), *texts):
        other.write_text(text)
        with pytest.raises(UserError, match=r"other\.json: not a run record"):
            command.run(replace(SMALL, repeat=other))
    other.unlink()
    with pytest.raises(UserError, match="not a run record"):
        command.run(replace(SMALL, repeat=other))


def test_record_with_former_entry_is_read(tmp_path):
    source = ROOT / "results/leaderboard/smoke/cells/bearing-only/clutter-8-v1-seed-0.json"
    text, path = source.read_text(), tmp_path / source.name
    path.write_text(text.replace('"episodes": ', '"starts": '))
    assert path.read_text() != text
    assert run_records.read_record(path) == run_records.read_record(source) == json.loads(text)


def test_folder_with_former_algorithm_names_is_read_but_not_extended(tmp_path):
    folder = tmp_path / "out/cells/tank-joined"
    folder.mkdir(parents=True)
    source = ROOT / "results/leaderboard/smoke/cells/tank-merged/clutter-8-v1-seed-0.json"
    (folder / source.name).write_text(source.read_text().replace("tank-merged", "tank-joined"))
    [card] = run_records.read_records(tmp_path / "out")
    assert card["algorithm"] == "tank-joined"
    assert registry.find("tank-joined") is registry.find("tank-merged")
    asked = replace(SMALL, out=tmp_path / "out", algorithms=("tank-merged",), episodes=50)
    with pytest.raises(UserError, match="runs of tank-joined, which is called tank-merged now; ch"):
        command.run(asked)


def test_misplaced_record_is_rejected(board, tmp_path):
    shutil.copytree(board, out := tmp_path / "out")
    card = out / "cells/ppo-heading/clutter-8-v1-seed-1.json"
    text = card.read_text()
    for path, name in ((card, "../../../mine"), (card.with_name("copy.json"), "ppo-heading")):
        path.write_text(json.dumps(json.loads(text) | {"algorithm": name}))
        with pytest.raises(UserError, match=f"is the record of {name}/clutter-8-v1-se"):
            command.run(replace(SMALL, out=out))
        card.write_text(text)
    assert not list(tmp_path.rglob("*mine*"))


def test_finished_runs_are_not_repeated(board, tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(command, "run_of", lambda place, record: done.append(place) or (place,))
    monkeypatch.setattr(command, "write", lambda out, runs, console: 1 / 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            command.run(replace(SMALL, out=tmp_path / "out"))
    assert len(done) == 3


@pytest.mark.slow
def test_runs_are_added_to_existing_folder(board, tmp_path, monkeypatch, capsys):
    done, run_of = [], command.run_of
    shutil.copytree(board, out := tmp_path / "out")
    monkeypatch.setattr(command, "run_of", lambda *given: done.append(given[0]) or run_of(*given))
    more = replace(SMALL, algorithms=("tank-merged", "bearing-only"), out=out)
    assert command.run(more) == 0
    assert [place.name for place in done] == ["tank-merged/clutter-8-v1-seed-0"]
    names = [row["algorithm"] for row in command.results.read_csv(out / "leaderboard.csv")]
    assert sorted(names) == ["bearing-only", "ppo-heading", "tank-merged"]
    for card in (board / "cells").glob("*/*.json"):
        assert (out / card.relative_to(board)).read_bytes() == card.read_bytes()
    capsys.readouterr()
    for changes in ({"decisions": 65, "algorithms": ("ppo-heading",)}, {"episodes": 9}):
        with pytest.raises(UserError, match="cannot be in one table"):
            command.run(replace(more, **changes))
    path = out / "cells" / "tank-merged" / "clutter-8-v1-seed-0.json"
    path.write_text(path.read_text().replace(scenarios.digests()["clutter-8-v1"], "0" * 64))
    with pytest.raises(UserError, match="digest of other initial conditions"):
        command.run(more)


@pytest.mark.slow
def test_runs_without_replay_are_repeated_with_record(board, tmp_path):
    shutil.copytree(board, out := tmp_path / "out")
    cards = [card["results"] for card in run_records.read_records(out)]
    before = (out / "cells/bearing-only/clutter-8-v1-seed-0.json").read_bytes()
    assert command.run(replace(SMALL, out=out, record=True)) == 0
    assert [run_records.has_replay(out, card) for card in run_records.read_records(out)] == [
        True
    ] * 3
    assert [card["results"] for card in run_records.read_records(out)] == cards
    assert (out / "cells/bearing-only/clutter-8-v1-seed-0.json").read_bytes() == before


def test_foreign_files_are_not_overwritten(board, tmp_path, monkeypatch):
    """A folder that is not writable is reported before any episode."""
    monkeypatch.setattr(command, "play_all", lambda *given: 1 / 0)
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(UserError, match=r"contains 'README\.md', which leaderboard did not"):
        command.run(replace(SMALL, out=tmp_path))
    with pytest.raises(UserError, match=r"README\.md: cannot write there: Not a directory"):
        command.run(replace(SMALL, out=tmp_path / "README.md"))
    assert contents(tmp_path) == {"README.md": b"mine"}
    with pytest.raises(ZeroDivisionError):
        command.run(replace(SMALL, out=board))


def test_missing_libraries_are_skipped_or_named(monkeypatch, capsys, tmp_path):
    """Missing packages are skipped by default, and an error for explicit names."""
    monkeypatch.setattr(registry.Algorithm, "missing", property(lambda own: list(own.packages)))
    named = {place.algorithm for place in command.plan(command.Config())}
    assert named == {"bearing-only", "tangent-merged-tuned", "tank-merged"}
    with pytest.raises(UserError, match=r"'qmix-none' needs torch, torchrl, tensordict, benchmarl"):
        command.plan(command.Config(algorithms=("qmix-none",)))
    monkeypatch.setattr(command, "play_all", lambda *given: (defaultdict(dict), 0.0))
    monkeypatch.setattr(command, "write", lambda *given: None)
    assert command.run(command.Config(out=tmp_path / "out")) == 0
    assert "skipped without benchmarl, stable-baselines3" in capsys.readouterr().out


def test_invalid_leaderboard_settings_are_rejected():
    for changes, said in (
        ({"algorithms": ("ppo-hedding",)}, "unknown; did you mean 'ppo-heading'"),
        ({"fields": ("clutter-8-v2",)}, "of another version"),
        ({"fields": ("uav-6",), "algorithms": ("ppo-tank",)}, "none of these algorithms fits"),
        ({"seeds": (1, 1)}, "named twice"),
        ({"episodes": 0}, "--episodes is 0"),
        ({"seeds": (3_000_000_000,)}, "--seeds is 3000000000; it must be 536870911 or less"),
    ):
        with pytest.raises(UserError, match=said):
            command.plan(replace(SMALL, **changes))
    barred = replace(SMALL, algorithms=("ppo-cbf",), fields=("clutter-8", "rooms"), seeds=())
    assert {place.field for place in command.plan(barred)} == {"clutter-8-v1"}  # discs alone


def test_every_algorithm_has_description():
    known = registry.known()
    for name in ("none", "penalty", "lagrangian", "cbf", "rule", "heading", "tank"):
        assert f"ppo-{name}" in known
    for one in known.values():
        assert one.guarantee in ("none", "heading", "tank") and one.about and one.given
    proven = {name: one.guarantee for name, one in known.items() if one.guarantee != "none"}
    own = {name: what for name, what in proven.items() if name.startswith("ppo")}
    assert own == {"ppo-heading": "heading", "ppo-tank": "tank"}
    assert known["ppo-cbf"].given != "bearings" and "leaderboard" in cli.COMMANDS


@pytest.mark.parametrize("tier", ["smoke", slow("mini")])
def test_shipped_records_reproduce_tables(tier, monkeypatch):
    out = ROOT / "results" / "leaderboard" / tier
    cards = run_records.read_records(out)
    monkeypatch.setattr(registry.Algorithm, "missing", [])
    asked = command.plan(command.Config(tier=tier))
    done = {(c["algorithm"], c["field"].partition("/")[2], c["seed"]) for c in cards}
    assert {(place.algorithm, place.field, place.seed) for place in asked} == done
    digests = {f"rendezvous/{name}": digest for name, digest in scenarios.digests().items()}
    assert all(c["digest"] == digests[c["field"]] for c in cards)
    monkeypatch.setattr(statistics, "RESAMPLES", 2)  # intervals take long
    rows = {row["algorithm"]: row for row in tables.rows_of(cards)}
    kept = command.results.read_csv(out / "leaderboard.csv")
    assert list(rows) == [row["algorithm"] for row in kept]
    for row in kept:
        assert rows[row["algorithm"]]["collision_free"] == pytest.approx(
            float(row["collision_free"])
        )
    exact = [c for c in cards if not c["field"].startswith("rendezvous/noisy")]
    certified = [c["results"] for c in exact if c["guarantee"] == "heading"]
    # float32 alone: two steps of MASAC with unicycles, by 5e-9 of V at the start
    assert sum(sum(each["risen"]) for each in certified) == {"smoke": 0, "mini": 2}[tier]
    if tier == "smoke":
        return
    page = (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    headings = [
        c for c in exact if c["guarantee"] == "heading" and c["algorithm"] != "bearing-only"
    ]
    steps = sum(sum(c["results"]["steps"]) for c in headings) / 1e6
    assert f"in two of {steps:.1f} million robot steps of {len(headings)} runs" in page
    shown = {row["algorithm"]: row for row in tables.rows_of(exact)}
    without = re.sub(r" \([\d.]+ to [\d.]+\)", "", page)
    for line in table_of(exact):
        assert re.sub(r" \([\d.]+ to [\d.]+\)", "", line) in without
    monkeypatch.undo()
    some = ("ppo-heading", "ppo-lagrangian", "tank-merged")
    assert all(line in page for line in table_of([c for c in exact if c["algorithm"] in some]))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, start in (("none", "| nothing"), ("heading", "| rule, **headings**")):
        row = shown[f"ppo-{name}"]
        assert f"{start} | {100 * row['collision_free']:.1f} | {row['time']:.0f} |" in readme


def table_of(cards):
    page = tables.markdown(tables.rows_of(cards), cards)
    return [line for line in page.splitlines() if line.startswith("|")]
