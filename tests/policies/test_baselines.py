"""The paper's laws, by hand, and the registry of scripted policies."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines import policy
from baselines.laws import paper_laws as laws
from baselines.learned.shipped import NAMES
from rendezvous_env.scenario.scenario import Scenario

POINT = Scenario(n_robots=3)
UNICYCLE = Scenario(n_robots=3, robot_model="unicycle", max_turn_rate=0.9)
SPACE = Scenario(n_robots=3, dim=3, robot_model="nonholonomic_3d")
CLUTTER = Scenario(n_robots=3, obstacle_slots=2)
HEAVY = Scenario(n_robots=3, robot_model="double_integrator")
PITCH = 0.5
GRAVITY = [-math.sin(PITCH), 0.0, -math.cos(PITCH)]


def observation(scenario, *rows):
    """One team; every robot sees the same rows, as float32."""
    shape = (scenario.n_robots, *scenario.observation_layout.shape)
    return np.broadcast_to(np.array(rows, dtype=np.float32), shape)


@pytest.mark.parametrize(
    ("name", "scenario", "rows", "expected"),
    [
        ("bearing-only", POINT, [[1, 0], [0, 1]], [1, 1]),
        ("bearing-only", POINT, [[0.6, 0.8], [0, 0]], [0.6, 0.8]),
        ("unicycle", UNICYCLE, [[0.6, 0.8], [0, 0]], [0.6, 0.8]),
        ("unicycle", UNICYCLE, [[-1, 0], [0, -1]], [-1, -0.9]),  # ω saturates
        ("unicycle-cosine", UNICYCLE, [[0.6, 0.8], [0, 0]], [0.6, math.cos(2.5)]),
        (
            "nonholonomic-3d",
            SPACE,
            [[0, 0.6, 0.8], [1, 0, 0], GRAVITY],
            [1, 0.6 / math.cos(PITCH), 0.8],
        ),
        ("nonholonomic-3d", SPACE, [[0, 1, 0], [0, 0, 0], [-1, 0, 0]], [0, 20, 0]),  # β = π/2
        (
            "nonholonomic-3d",
            SPACE,
            [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
            [0, 0, 1],
        ),  # β = −π/2, f_y = 0
        ("zero", POINT, [[1, 0], [0, 1]], [0, 0]),
    ],
)
def test_laws_by_hand(name, scenario, rows, expected):
    actions = baselines.make(name, scenario)(observation(scenario, *rows), 2.5)
    assert actions.dtype == np.float32
    np.testing.assert_allclose(actions, np.tile(expected, (3, 1)), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("pitch", [-3.0, -1.2, 0.0, 0.4, 1.6])
def test_pitch_is_read_from_gravity(pitch):
    gravity = np.array([-math.sin(pitch), 0.0, -math.cos(pitch)])
    assert laws.pitch_of(gravity) == pytest.approx(pitch, abs=1e-15)
    assert laws.pitch_of(np.zeros((2, 3))).tolist() == [0, 0]


def test_cosine_law_has_one_time_for_each_team():
    f = np.ones((2, 4, 2))
    rates = laws.unicycle_cosine_law(f, np.array([0.0, math.pi]))[..., 1]
    np.testing.assert_allclose(rates, [[1] * 4, [-1] * 4])
    np.testing.assert_allclose(laws.unicycle_cosine_law(f, math.pi / 3)[..., 1], 0.5)


@pytest.mark.parametrize("scenario", [POINT, UNICYCLE, SPACE, CLUTTER])
def test_every_fitting_policy_has_any_leading_axes_and_stays_in_bounds(scenario):
    random = np.random.default_rng(0)
    n, layout = scenario.n_robots, scenario.observation_layout
    observations = random.normal(size=(2, 4, n, *layout.shape)).astype(np.float32)
    observations[1, 2, 0] = 0  # a robot that is gone
    for name in baselines.names(scenario):
        if name.startswith("privileged"):  # sees more than observations
            continue
        batch = baselines.make(name, scenario)(observations, random.random((2, 4)))
        assert batch.shape == (2, 4, n, scenario.action_size) and batch.dtype == np.float32
        assert np.isfinite(batch).all()
        assert (np.abs(batch) <= scenario.action_bounds.astype(np.float32)).all()
        single = baselines.make(name, scenario)(observations[1, 3], 0.25)
        assert single.shape == (n, scenario.action_size)
        if name not in ("random", "unicycle-cosine"):
            np.testing.assert_array_equal(single, batch[1, 3])


def test_names_are_those_that_fit():
    everywhere = {"random", "zero"}
    references = {"consensus", "circumcentre", "enclosing-ball", "nearest-pursuit", "planner"}
    privileged = {f"privileged-{name}" for name in references}
    field = {"unit-mean", "smallest-sector", "quantised", "cyclic-pursuit", "nearest-pursuit"}
    field |= {"link-keeping"}
    plane = {"bearing-only", *field, *NAMES, *everywhere, *privileged}
    assert set(baselines.names(POINT)) == plane
    cars = {"unicycle", "unicycle-cosine", "pursuit", "windshield"}
    cars |= {*NAMES, "privileged-planner"}
    assert set(baselines.names(UNICYCLE)) == {*cars, *everywhere}
    flyers = {"nonholonomic-3d", "pursuit", *NAMES, "privileged-planner"}
    assert set(baselines.names(SPACE)) == {*flyers, *everywhere}
    flat = {"smallest-sector", "quantised"}
    assert set(baselines.names(POINT.replace(dim=3))) == plane - flat
    rules = {"tangent", "tangent-blocking", "tangent-joined"}
    certified = {f"{rule}-certified" for rule in rules}
    tuned = {"tangent-joined-tuned", "tank-joined"}
    assert set(baselines.names(CLUTTER)) == {*plane, *rules, *certified, *tuned}
    among_discs = {"tangent-joined", *tuned}
    turning = rv.scenarios.get("unicycle-clutter-8")
    assert set(baselines.names(turning)) == {*cars, *everywhere, *among_discs}
    among_spheres = {*(plane - flat), *rules, *certified, *tuned}
    assert set(baselines.names("clutter-3d-32")) == among_spheres
    assert set(baselines.names("uav-clutter-16")) == {*flyers, *everywhere, *among_discs}
    assert set(baselines.names(HEAVY)) == {"damped", *everywhere}
    assert len(baselines.names()) == 31


@pytest.mark.parametrize(
    ("name", "scenario", "options", "message"),
    [
        ("bearing_only", POINT, {}, "is unknown.*bearing-only.*did you mean 'bearing-only'"),
        ("unicycle", POINT, {}, "does not fit single_integrator robots in 2-D.*bearing-only"),
        ("tangent", POINT, {}, "with 0 obstacle slots"),
        ("tangent-joined", CLUTTER, {"clearence": 1}, "no option 'clearence'; it has clearance"),
        ("tangent-joined", CLUTTER, {"clearance": -1}, "clearance is -1"),
        ("zero", POINT, {"seed": 1}, "no option 'seed'; it has none"),
    ],
)
def test_refusals_say_what_is_right(name, scenario, options, message):
    with pytest.raises(ValueError, match=message):
        baselines.make(name, scenario, **options)


def test_a_wrong_observation_is_refused():
    with pytest.raises(ValueError, match=r"needs \(..., 2, 2\)"):
        baselines.make("bearing-only", POINT)(np.zeros((3, 5, 2), np.float32), 0.0)


def test_random_is_uniform_and_repeatable():
    slow = Scenario(n_robots=3, max_speed=0.5)
    view = np.zeros((400, 3, *slow.observation_layout.shape), np.float32)
    policy = baselines.make("random", slow, seed=7)
    first, second = policy(view, 0.0), policy(view, 0.1)
    assert not np.array_equal(first, second)
    assert np.abs(first).max() <= 0.5 and abs(first.mean()) < 0.03
    assert first.std() == pytest.approx(1 / math.sqrt(12), rel=0.05)
    policy.reset()
    np.testing.assert_array_equal(policy(view, 0.0), first)
    policy.reset(np.zeros(400, bool))
    np.testing.assert_array_equal(policy(view, 0.1), second)
    other = baselines.make("random", slow, seed=8)(view, 0.0)
    assert not np.array_equal(other, first)


def test_every_policy_says_what_it_is_and_of_which_kind():
    """A reader of positions is privileged by its name and by its kind, and nobody else is."""
    for name in baselines.names():
        assert policy.about(name), name
        assert policy.kind_of(name) != "own", name
        assert name.startswith("privileged") == (policy.kind_of(name) == "privileged")


def test_names_are_in_the_order_of_their_kinds():
    kinds = [policy.kind_of(name) for name in baselines.names()]
    assert kinds == sorted(kinds, key=list(policy.KINDS).index)
    assert baselines.names(UNICYCLE) == [
        "unicycle", "unicycle-cosine", "pursuit", "windshield", *NAMES, "privileged-planner",
        "random", "zero",
    ]  # fmt: skip
    assert baselines.names("uav-6") == baselines.names(rv.scenarios.get("uav-6"))


def test_another_kind_is_refused_and_nothing_is_entered():
    with pytest.raises(ValueError, match="kind is 'best'; it must be one of law, field, rule"):
        policy.register("mine", fits=lambda scenario: True, kind="best")
    assert "mine" not in baselines.names()
