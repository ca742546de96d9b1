"""Custom graph family, sensor imperfection and reward term from a user's file."""

from itertools import islice

import numpy as np
import pytest
from conftest import refusing, started

import rendezvous_env as rv
from rendezvous_env import Scenario, Sensing, Simulator, graphs
from rendezvous_env.checks import Registry
from rendezvous_env.rewards.custom_terms import RewardStep
from rendezvous_env.trajectory import run


@graphs.family("hexagon-and-chords")
def ring_with_chords(n, random):
    """Ring graph with one chord from robot 0."""
    ring = [(i, (i + 1) % n) for i in range(n)]
    return [*ring, (0, int(random.integers(2, n - 1)))]


@rv.sensor_imperfection("blind-behind")
def blind_behind(seen):
    """Sensor that misses robots behind the y axis of the robot's frame."""
    seen.neighbours[seen.neighbours[..., 0] < 0.0] = 0.0


@rv.sensor_imperfection("half-lost")
def half_lost(seen):
    """Sensor that loses half of the rows at random."""
    seen.neighbours[seen.uniform(*seen.neighbours.shape[1:3]) < 0.5] = 0.0


@rv.reward_term("effort")
def effort(step):
    """Commanded speed of each robot, m/s."""
    return np.linalg.norm(step.actions, axis=-1)


@rv.reward_term("spread")
def spread(step):
    """Mean distance to the centre of the team, m."""
    centred = step.positions - step.positions.mean(axis=1, keepdims=True)
    return np.linalg.norm(centred, axis=-1).mean(axis=-1)


FAMILY = Scenario(n_robots=6, graph="hexagon-and-chords")
OWN = FAMILY.replace(
    name="mine",
    reward=rv.RewardWeights(custom={"spread": 2, "effort": np.float32(-0.5)}),
    sensing=Sensing(custom=("blind-behind", "half-lost"), noise=0.1),
)


def towards(scenario):
    rows = scenario.observation_layout.neighbours
    return lambda seen, time: seen[..., rows, :].sum(axis=-2)


def walk(scenario, seed, num_envs):
    """Observations, team rewards and robot rewards of 12 steps, (12, B, …)."""
    simulator, found = started(scenario, num_envs, seed), []
    for step in islice(run(simulator, towards(scenario), simulator.observe()), 12):
        given = step.outcome
        found.append((given.observations, given.rewards.copy(), given.robot_rewards))
    return [np.array(each) for each in zip(*found, strict=True)]


def test_custom_family_is_sampled_per_seed_and_episode():
    graph = {"kind": "hexagon-and-chords", "weight_range": [0.5, 2.0]}
    simulator = started(FAMILY.replace(graph=graph), 40, seed=3)
    weights = simulator.weights
    assert ((weights > 0).sum(axis=(1, 2)) == 2 * 7).all()
    assert len(np.unique(weights > 0, axis=0)) == 3  # chords to robots 2, 3 and 4
    positive = weights[weights > 0]
    assert 0.5 <= positive.min() < 0.7 and 1.8 < positive.max() <= 2.0
    single = started(simulator.scenario, seed=3 + 7)
    np.testing.assert_array_equal(single.weights[0], weights[7])
    simulator.reset()
    assert not np.array_equal(simulator.weights, weights)


def test_custom_extensions_are_written_to_files(tmp_path):
    OWN.to_toml(tmp_path / "mine.toml")
    assert Scenario.from_toml(tmp_path / "mine.toml") == OWN
    assert hash(OWN) == hash(Scenario.from_plain(OWN.to_plain()))


def test_custom_family_acts_as_graph():
    assert FAMILY.max_degree == 5.0 and FAMILY.bottleneck_weight == 1.0
    assert FAMILY.observation_layout.neighbour_slots == 5
    met = rv.rollout(FAMILY, towards(FAMILY), seed=0, num_envs=3)
    assert met.success.all() and met.largest_rise_between_merges.max() <= 0.0
    assert rv.certificate(FAMILY).guaranteed and np.isfinite(rv.certificate(FAMILY).time_bound)


def test_failing_family_changes_nothing():
    graphs.family("moody", lambda n, random: [(i, i + 1) for i in range(n - 1)])
    simulator = started(FAMILY.replace(graph="moody"), 2, seed=5)
    graphs.family("moody", lambda n, random: [])
    with refusing(simulator, "'moody' returned a graph that is not connected"):
        simulator.reset(9)


def test_custom_imperfection_hides_robots_behind():
    scenario = Scenario(n_robots=4)
    blind = scenario.replace(sensing=Sensing(custom=["blind-behind"]))
    assert not blind.sensing.exact and "blind-behind" in blind.sensing.departures()
    exact, seen = (Simulator(s, 5).reset(2) for s in (scenario, blind))
    behind = exact[..., :3, 0] < 0.0
    assert behind.any() and not seen[..., :3, :][behind].any()
    np.testing.assert_array_equal(seen[..., :3, :][~behind], exact[..., :3, :][~behind])

    ring = Scenario(n_robots=5, graph="cycle", sensing=blind.sensing)
    seen = Simulator(ring, 20).reset(0).any(axis=-1)
    assert (seen[..., 0] | ~seen[..., 1]).all() and not seen.all()  # those left stand first


def test_batch_equals_single_environments():
    batch = walk(OWN, 3, 4)
    for team in range(4):
        single = walk(OWN, 3 + team, 1)
        for many, one in zip(batch, single, strict=True):
            np.testing.assert_array_equal(many[:, team], one[:, 0])


@pytest.mark.kernels
@pytest.mark.parametrize("teams", [2, 7])  # 5 and more stand side by side, in blocks
def test_observations_follow_from_state(teams):
    simulator = Simulator(Scenario(n_robots=4, sensing=Sensing(custom=("half-lost",))), teams)
    first = simulator.reset(0)
    np.testing.assert_array_equal(first, simulator.observe())
    zero = np.zeros((teams, 4, 2), np.float32)
    assert not np.array_equal(simulator.step(zero).observations == 0, first == 0)
    outcome = simulator.step(zero)
    kept = outcome.observations[1:].copy()
    simulator.restart(np.arange(teams) < 1, outcome)
    np.testing.assert_array_equal(outcome.observations[1:], kept)
    np.testing.assert_array_equal(outcome.observations, simulator.observe())


def test_random_numbers_cover_all_obstacles():
    shapes = []
    rv.sensor_imperfection(
        "counts", lambda seen: shapes.append(seen.uniform(*seen.obstacles.shape[1:4]).shape)
    )
    for obstacles in ((), rv.Disc((0.0, 0.0), 1.0)):
        Simulator(Scenario(sensing=Sensing(custom=("counts",)), obstacles=obstacles), 2).reset(0)
    assert shapes == [(2, 5, 0, 2), (2, 5, 1, 2)]


def test_later_imperfection_does_not_restore_rows():
    rv.sensor_imperfection("sees nobody", lambda seen: seen.neighbours.fill(0.0))
    rv.sensor_imperfection("sees all", lambda seen: seen.neighbours.fill(0.5))
    for names, rows in ((("sees nobody", "sees all"), 0.0), (("sees all",), 0.5)):
        assert (Simulator(Scenario(sensing=Sensing(custom=names))).reset(0) == rows).all()


def test_custom_sensor_has_no_theorem():
    scenario = Scenario(sensing=Sensing(custom=("blind-behind",)))
    for by in ("law", "heading", "tank", "gains", "links"):
        margin = 0.5 if by in ("heading", "tank") else 1.0
        certificate = rv.certificate(scenario, margin, by=by)
        assert not certificate.guaranteed and "blind-behind" in str(certificate)


@pytest.mark.parametrize("on_merge", ["remove", "follow"])
def test_custom_terms_are_added_with_weights(on_merge):
    plain = Scenario(n_robots=3, on_merge=on_merge, time_limit=20.0)
    paid = plain.replace(reward=rv.RewardWeights(custom={"effort": -0.5, "spread": 2.0}))
    simulator, other = (started(scenario, 2, seed=1) for scenario in (plain, paid))
    for _ in range(60):
        took_part, running = simulator.active, ~simulator.ended
        actions = towards(plain)(simulator.observe(), 0.0)
        usual, earned = simulator.step(actions), other.step(actions)
        centred = simulator.positions - simulator.positions.mean(axis=1, keepdims=True)
        size = 2.0 * np.linalg.norm(centred, axis=-1).mean(axis=-1)
        effort = -0.5 * np.linalg.norm(actions, axis=-1)
        team = np.where(took_part, effort, 0.0).sum(axis=1) / took_part.sum(axis=1)
        more = earned.rewards - usual.rewards
        np.testing.assert_allclose(more, running * (team + size), atol=1e-6)
        earning = (took_part | (on_merge == "follow")) & running[:, None]
        each = np.where(earning, effort + size[:, None], 0.0)
        more = earned.robot_rewards - usual.robot_rewards
        np.testing.assert_allclose(more, each, atol=1e-6)


def family_of(draw):
    graphs.family("bad", draw)
    return FAMILY.replace(graph="bad")


def stepped(role, term):
    """A step of a team with a custom reward term or cost."""
    rv.reward_term("mine", term)
    paid = {"reward": {"custom": {"mine": 1.0}}, "costs": ("mine",)}
    simulator = started(Scenario(**{role: paid[role]}))
    simulator.step(np.zeros((1, 5, 2), np.float32))


def seen_by(imperfection):
    rv.sensor_imperfection("mine", imperfection)
    Simulator(Scenario(n_robots=3, sensing=Sensing(custom=("mine",)))).reset(0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: graphs.family("path", ring_with_chords), "name is 'path'; it must be new"),
        (lambda: FAMILY.replace(graph="hexagon-and-chord"), "did you mean 'hexagon-and-chords'"),
        (lambda: graphs.family("mine", 5), "family of graphs 'mine' is 5; it must be a function"),
        (lambda: graphs.family("")(ring_with_chords), "name of a family of graphs is ''"),
        (lambda: family_of(lambda n, random: [(0, 1)]), "'bad' returned .* connected: comp"),
        (lambda: family_of(lambda n, random: [(0, n)]), r"'bad' for 6 robots: .*\(0, 6\)"),
        (lambda: family_of(lambda n, random: 5), "graph: edges is 5; it must be a sequence"),
        (lambda: family_of(lambda n, random: [(0, 1, 2.0)]), "weights come from"),
        (lambda: Registry("family", "rv.f")["x"], r"'x' is not registered here; import .* rv\.f"),
        (
            lambda: seen_by(lambda seen: setattr(seen, "neighbours", 0.0 * seen.neighbours)),
            "'mine' replaced an array of its argument; change wh",
        ),
        (lambda: stepped("reward", lambda step: np.zeros(7)), r"term 'mine' .*\(7,\); .*\(1,\)"),
        (lambda: stepped("reward", lambda step: np.inf + step.time), "term 'mine' .*finite"),
        (lambda: stepped("costs", lambda step: np.ones(3)), r"cost 'mine' .*\(3,\); .* \(1,\)"),
        (lambda: rv.RewardWeights(custom={"efort": 1.0}), "'efort' is unknown; did you mean 'eff"),
        (lambda: rv.RewardWeights(custom={"effort": "x"}), "reward.custom.effort is 'x'"),
        (lambda: rv.RewardWeights(custom=5), "reward.custom is 5; it must be a mapping"),
        (lambda: Sensing(custom=("nothing",)), "'nothing' is unknown; register it with rv.sensor"),
        (lambda: Sensing(custom="blind-behind"), "it must be a list of names"),
        (lambda: rv.reward_term("x", 5), "term 'x' is 5; it must be a function"),
        (lambda: rv.reward_term("rise"), "is 'rise'; it must be none of the costs contact"),
        (lambda: rv.reward_term(""), "name of a reward term is ''"),
        (lambda: rv.reward_term(np.zeros(3)), "name of a reward term is array"),
        (lambda: rv.sensor_imperfection("x", 5), "imperfection 'x' is 5; it must be a function"),
    ],
)
def test_invalid_extensions_are_rejected(make, said):
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize("field", [name for name in RewardStep._fields if name != "scenario"])
@pytest.mark.parametrize("role", ["reward", "costs"])
def test_reward_step_is_read_only(field, role):
    def meddler(step):
        getattr(step, field)[...] = 1
        return step.time

    with pytest.raises(ValueError, match="read-only"):
        stepped(role, meddler)
