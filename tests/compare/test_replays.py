"""Replays of the leaderboard, compared with the run records."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import ROOT
from parameters import slow
from rendezvous_env.baselines.learned.plain_data import digest
from report_data import arrays_of

from rendezvous_env import Simulator, scenarios
from rendezvous_env.obstacles.shape import RADIUS
from train.checks import UserError
from train.leaderboard import command, replays, run_records
from train.leaderboard.environments import make_training_envs
from train.leaderboard.playing import EvaluationSetup, play
from train.learn.settings import EVALUATION_SEEDS
from train.recording import MAX_FRAMES

RULES = command.Config(
    algorithms=("bearing-only", "tank-merged"), fields=("clutter-8", "unicycle-clutter-16"),
    episodes=10, jobs=1,
)  # fmt: skip


def check_agreement(card, kept):
    """Replays end as in the run record, on the documented initial conditions."""
    found = card["results"]
    other = [start for start, one in enumerate(found["clean"]) if one != found["clean"][0]]
    assert sorted(kept) == [0, *other[:1]]
    for start, shown in kept.items():
        arrays = arrays_of(shown.fields, shown.text)
        assert arrays["times"][-1] == pytest.approx(found["time"][start], rel=1e-6, abs=1e-6)
        assert (arrays["active"][-1].sum() == 1) == bool(found["success"][start])
        assert arrays["contacts"][-1].sum() == found["touches"][start]
        assert found["clean"][start] == (found["success"][start] and not found["touches"][start])
        assert (np.diff(arrays["times"]) > 0).all() and len(arrays["times"]) > 5


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    out = tmp_path_factory.mktemp("rules") / "out"
    assert command.run(replace(RULES, out=out)) == 0
    return out


def kept_of(board, card):
    return replays.read_replay(replays.path_of(run_records.path_in(board, card)), card["results"])


@pytest.mark.slow
def test_replay_matches_record_and_initial_condition(board):
    found = run_records.read_records(board)
    assert [(card["algorithm"], card["field"]) for card in found] == [
        ("bearing-only", "rendezvous/clutter-8-v1"), ("tank-merged", "rendezvous/clutter-8-v1"),
        ("tank-merged", "rendezvous/unicycle-clutter-16-v1"),
    ]  # fmt: skip
    for card in found:
        check_agreement(card, kept_of(board, card))
    kept = kept_of(board, found[0])
    assert len(kept) == 2  # law (1) fails on some, and not on all
    for start, shown in kept.items():
        simulator = Simulator(scenarios.get("clutter-8"), 1)
        simulator.reset(EVALUATION_SEEDS + start)
        first = arrays_of(shown.fields, shown.text)["lyapunov"][0]
        assert first == np.float32(simulator.lyapunov()[0])
        discs = sorted(one["radius"] for one in shown.obstacles)
        np.testing.assert_allclose(discs, sorted(simulator.obstacles[0][:, RADIUS]), atol=1e-5)
        places, inside = np.array(shown.extent), simulator.positions[0]
        assert (places[:, 0] <= inside + 1e-9).all() and (inside <= places[:, 1] + 1e-9).all()


def led(field, count, safety, choose):
    """Policy whose choices depend on the action space only."""
    teams = make_training_envs(scenarios.get(field), count, safety=safety, anew=False)
    return EvaluationSetup(teams, lambda seen, time: choose(seen.shape[:2]))


def test_recording_does_not_change_episode():
    player = partial(led, "clutter-16", 3, "tank", lambda shape: np.full(shape, 3))
    found, recordings = replays.play_and_record(own := player(), [2, 0])
    assert found == play(player())
    for team, recording in zip((2, 0), recordings, strict=True):
        assert recording["contacts"][-1].sum() == found["touches"][team]
        steps = recording["times"] / scenarios.get("clutter-16").tau
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        assert len(steps) <= MAX_FRAMES
        assert recording["times"][-1] == pytest.approx(found["time"][team])
        path = own.env.unwrapped.simulator.path_length[team]
        ways = np.linalg.norm(np.diff(recording["positions"], axis=0), axis=-1).sum()
        assert 0.9 * path < ways  # chords of the way, merges aside
        both = recording["active"][:, :2].all(axis=1)
        offset = recording["positions"][both, 1] - recording["positions"][both, 0]
        bearing = np.einsum("tji,tj->ti", recording["frames"][both, 0], offset)
        bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
        # robot 0 sees robot 1 where it is in that frame, not where it was a step before
        np.testing.assert_allclose(recording["observations"][both, 0, 0], bearing, atol=1e-5)


def test_nondeterministic_run_has_no_replay():
    random = np.random.default_rng(0)
    player = partial(led, "clutter-8", 2, "heading", lambda shape: random.integers(0, 9, shape))
    assert replays.replay_of(play(player()), player()) is None


@pytest.mark.slow
def test_replay_is_reproduced_from_record(board, tmp_path, capsys):
    name = "bearing-only/clutter-8-v1-seed-0.json"
    card, path = board / "cells" / name, board / "replays" / name
    before = path.read_bytes()
    path.unlink()
    assert command.run(replace(RULES, repeat=card)) == 0 and not path.exists()
    assert kept_of(board, run_records.read_record(card)) == {}
    assert command.run(replace(RULES, repeat=card, record=True)) == 0
    assert path.read_bytes() == before and str(path) in capsys.readouterr().out
    changed = run_records.read_record(card)
    changed["results"]["time"][3] += 0.05
    run_records.write_run(tmp_path, changed, None)
    assert command.run(replace(RULES, repeat=tmp_path / "cells" / name, record=True)) == 1
    assert "results differ" in capsys.readouterr().err and not (tmp_path / "replays").exists()
    elsewhere = (tmp_path / "cells" / name).rename(tmp_path / "card.json")
    with pytest.raises(UserError, match=r"card\.json: a replay belongs to a record in OUT/cells"):
        command.run(replace(RULES, repeat=elsewhere, record=True))


def test_foreign_replay_is_rejected(board, tmp_path):
    card = run_records.read_records(board)[0]
    good = json.loads(replays.path_of(run_records.path_in(board, card)).read_text())
    path = tmp_path / "replay.json"

    def refused(said, found=card["results"], sealed=False, **changes):
        replay = good | changes
        if sealed:  # by somebody who means to
            replay["sha256"] = digest({"results": found, "starts": replay["starts"]})
        path.write_text(json.dumps(replay))
        with pytest.raises(UserError, match=rf"replay\.json: not the replay of its record.*{said}"):
            replays.read_replay(path, found)

    refused("of other results", found=card["results"] | {"time": [0.0] * 10})
    refused("changed", starts={"0": good["starts"]["0"] | {"stride": 16}})
    bad = good["starts"]["0"] | {"text": "</script><b>"}
    refused("not base64", sealed=True, starts={"0": bad})
    refused("missing 3 required", sealed=True, starts={"0": {"text": "", "fields": []}})
    refused("", sealed=True, starts=[])
    path.write_text("[" * 100_000)
    with pytest.raises(UserError, match="nested"):
        replays.read_replay(path, card["results"])


@pytest.mark.parametrize("tier", ["smoke", slow("mini")])
def test_every_shipped_record_has_replay(tier):
    out = ROOT / "results" / "leaderboard" / tier
    first = [card for card in run_records.read_records(out) if card["seed"] == 0]
    assert len(first) == {"smoke": 36, "mini": 118}[tier]
    for card in first:
        check_agreement(card, kept_of(out, card))
    assert sum(path.stat().st_size for path in out.glob("replays/*/*")) < 3e6
