"""Claims for the continuous-time integrator: satisfied, and violated by injected faults."""

import dataclasses

import continuous_time_claims
import delay_claims
import link_claims
import numpy as np
import pytest
from adversarial_graphs import Attention, draw_teams, draw_weights
from claims import CLAIMS, check, main
from continuous_time import Batch
from continuous_time_laws import away, followed, into_cone, turned
from parameters import marked
from scipy.optimize import nnls

from train.verify.claims import BATCH
from train.verify.falsification import Tally
from train.verify.monitors import across, unit

FREE = (*continuous_time_claims.CONTINUOUS_TIME, *delay_claims.DELAY, *link_claims.LINKS)
BY_NAME = {claim.name: claim for claim in FREE}


def findings(name, batches=(0, 1, 2, 3), broken=None):
    """Violations and worst T/bound of a claim, with a fault in each trial."""
    claim = BY_NAME[name]

    def draw(random, batch, least_margin):
        trial = claim.draw(random, batch, least_margin)
        if broken is not None:
            broken(trial, random)
        return trial

    changed = dataclasses.replace(claim, draw=draw)
    found = Tally()
    for batch in batches:
        found.join(check(changed, 7, batch, BATCH, 0.3))
    assert found.trials == len(batches) * BATCH
    return found.violations, found.ratio.get(name)


@pytest.mark.parametrize("name", marked(BY_NAME, slow=BY_NAME.keys() - {"gains", "stale"}))
def test_claims_hold(name):
    violations, ratio = findings(name)
    assert violations == 0
    if BY_NAME[name].meets:
        assert 0.01 < ratio <= 1  # a bound that nobody comes near checks little


def test_script_reports_every_claim(capsys):
    assert set(FREE) == set(CLAIMS)
    assert len({claim.name for claim in CLAIMS}) == len(CLAIMS)
    assert main(["--trials", "3", "gains", "stale"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:4] for line in lines] == [
        ["gains", "3", "teams", "0"],
        ["stale", "3", "teams", "0"],
    ]


def soon(trial):
    """Shorter limit for immediate violations."""
    trial.limit = np.minimum(trial.limit, 50 * np.max(trial.step))


def too_soon(trial, random):
    """Fault: a bound a hundred times too small."""
    trial.limit = trial.limit / 100


def backwards(trial, random):
    """Fault: robots move away."""
    law = trial.law
    trial.law = lambda teams: -law(teams)
    soon(trial)
    trial.limit[...] += 1e3 * (trial.look is None)


def sideways(trial, random):
    """Fault: velocities are rotated outward by a little."""
    law = trial.law

    def turning(teams):
        velocities, towards = law(teams), away(teams, teams.look())
        speeds = np.linalg.norm(velocities, axis=-1, keepdims=True)
        lone = unit(velocities)[:, :, None]
        return speeds * turned(lone, towards[:, :, :1], 0.2)[:, :, 0]

    trial.law = turning
    soon(trial)


def sideways_for_long(trial, random):
    """Fault for theorem N: errors beyond its tolerance."""
    sideways(trial, random)
    trial.limit = 400 * trial.step * np.ones(BATCH)


def one_rests(trial, random):
    """Fault: two robots without neighbours."""
    law = trial.law

    def resting(teams):
        velocities = law(teams)
        velocities[:, 1] = 0.0
        return velocities

    trial.law = resting


def outside_the_cone(trial, random):
    """Fault: law (4) at the minimum alignment on one side of f."""
    attention = Attention(trial.teams, random)
    axis = random.normal(size=trial.teams.positions.shape)

    def law(teams):
        sights = teams.look()
        f = followed(sights.bearings, attention(teams, sights))
        ahead = unit(f)
        h = 0.3 * ahead + np.sqrt(1 - 0.3**2) * unit(across(ahead, axis))
        return h * np.sum(h * f, axis=-1, keepdims=True)

    trial.law = law
    soon(trial)


def by_law_1(trial, random):
    """Fault: links are lost."""

    def law(teams):
        sights = teams.look()
        return link_claims.rows_in_sight(sights, sights.bearings, 1.0).sum(axis=-2)

    trial.law = law


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "batches", "broken", "least"),
    [
        *((name, (1, 2), too_soon, 0) for name in BY_NAME if BY_NAME[name].meets),
        *((name, (1,), backwards, 0.9) for name in BY_NAME if name != "beyond-N"),  # they flee
        *((name, (3,), sideways, 0.5) for name in ("gains", "gains-leader", "cone-headings")),
        ("wrong-bearings", (2, 3), sideways_for_long, 0),
        ("gains-leader", (1, 2), one_rests, 1.8),
        ("cone-headings", (2, 3), outside_the_cone, 1),
        ("link-keeping", (2, 3), by_law_1, 0),
    ],
)
def test_planted_mistakes_are_detected(name, batches, broken, least):
    assert findings(name, batches, broken=broken)[0] > least * BATCH


def test_polygons_within_theorem_n_do_not_grow():
    def draw(random, batch, least_margin):
        return continuous_time_claims.draw_growing(random, batch, least_margin, share=0.98)

    claim = dataclasses.replace(BY_NAME["beyond-N"], draw=draw)
    assert check(claim, 7, 2, BATCH, 0.3).violations == BATCH


def test_too_old_bearings_are_detected(monkeypatch):
    monkeypatch.setattr(delay_claims, "_KEPT", 2)
    largest = delay_claims.largest_age
    monkeypatch.setattr(
        delay_claims, "largest_age", lambda *given, **named: 200.0 * largest(*given, **named)
    )
    assert findings("stale", batches=(2, 3))[0] > 0


@pytest.mark.parametrize("name", ["links", "links-misled"])
def test_plain_velocities_are_detected(name, monkeypatch):
    class Careless(link_claims.LinkKeeping):
        def compute(self, observations):
            super().compute(observations)
            return (self.scenario.speed_limit * self._held).astype(np.float32)

    monkeypatch.setattr(link_claims, "LinkKeeping", Careless)
    assert findings(name, batches=(1, 2), broken=lambda trial, _: soon(trial))[0] > BATCH


def test_uncompensated_errors_are_detected(monkeypatch):
    real = link_claims.LinkKeeping

    def trusting(*given, bearing_error, **named):
        return real(*given, bearing_error=0.0, **named)

    monkeypatch.setattr(link_claims, "LinkKeeping", trusting)
    assert findings("links-misled", batches=(1, 2))[0] > 0


@pytest.mark.parametrize("batch", [1, 3])
def test_attention_covers_all_kinds(batch):
    random = np.random.default_rng(batch)
    teams = draw_teams(random, batch)
    attention, sights = Attention(teams, random), teams.look()
    shares = np.array([attention(teams, sights) for _ in range(50)])
    np.testing.assert_allclose(shares.sum(axis=-1), 1.0)
    assert (shares >= 0).all() and not shares[..., np.eye(shares.shape[-1], dtype=bool)].any()
    one = shares.max(axis=-1) > 0.999
    assert 0.3 < one.mean() < 0.95
    changes = np.abs(np.diff(shares, axis=0)).max(axis=(2, 3)) > 1e-9
    rate = changes.mean(axis=0)
    assert (rate == 0).any() and (rate > 0.9).any() and ((rate > 0) & (rate < 0.5)).any()
    assert (shares != np.swapaxes(shares, -1, -2)).any(axis=(0, 2, 3)).mean() > 0.7


def test_weights_of_merged_robot_add_up():
    random = np.random.default_rng(0)
    teams = Batch(random.normal(size=(BATCH, 3, 2)), 0.01)
    teams.active[0, 1], teams.active[1, 1:] = False, False
    shares = Attention(teams, random)(teams, teams.look())
    assert shares[0, 0].tolist() == [0, 0, 1] and not shares[0, 1].any()
    assert not shares[1].any()


def test_headings_stay_in_cone_of_two_bearings():
    random = np.random.default_rng(0)
    g, other = (unit(random.normal(size=(1000, 3))) for _ in range(2))
    f, margin = g * random.random((1000, 1)) + other, random.uniform(0.1, 0.9, (1000, 1))
    h = into_cone(g, f, margin)
    np.testing.assert_allclose(np.linalg.norm(h, axis=-1), 1.0)
    cosine = np.sum(h * unit(f), axis=-1, keepdims=True)
    assert (cosine >= margin - 1e-12).all()
    pairs = np.stack([g, other], axis=-1)
    off = [nnls(pair, one)[1] for pair, one in zip(pairs, h, strict=True)]
    assert max(off) < 1e-6


def test_bearings_have_maximum_age():
    """The bearing of a passing robot reveals its delay."""
    random = np.random.default_rng(3)
    places = random.uniform(-50.0, 50.0, (BATCH, 3, 2))  # so that nobody meets
    teams = Batch(places, 0.2, draw_weights(random, 3))
    seen, step = delay_claims._stale(teams, random, law_4=False)
    velocities = np.zeros_like(teams.positions)
    velocities[:, 0, 0] = 0.1
    paths, oldest = [], []
    for _ in range(30):
        sights = teams.look()
        paths.append((teams.time.copy(), sights.bearings))
        got = seen(teams, sights)
        ages = np.full(got.shape[:3], -np.inf)
        for when, bearings in paths:
            same = np.all(got == bearings, axis=-1)
            ages = np.where(same, (teams.time - when)[:, None, None], ages)
        assert (ages >= 0).all()  # each is one that was seen
        oldest.append(ages[:, 0, 1:].max(axis=-1) / step)
        teams.advance(velocities, step)
    late = np.array(oldest[10:])
    assert late.max() <= delay_claims._KEPT - 1 + 1e-6  # and held for one step more
    assert (late.max(axis=0) > delay_claims._KEPT - 1.5).mean() > 0.3
