"""Laws of the paper, by hand and on large sparse graphs; registry of scripted policies."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines import policy
from baselines.laws import paper_laws as laws
from baselines.learned.shipped import NAMES
from rendezvous_env.scenario.scenario import Scenario

STEERED = [name for name in NAMES if name != "learned-search"]
POINT = Scenario(n_robots=3)
UNICYCLE = Scenario(n_robots=3, robot_model="unicycle", max_turn_rate=0.9)
SPACE = Scenario(n_robots=3, dim=3, robot_model="nonholonomic_3d")
CLUTTER = Scenario(n_robots=3, obstacle_slots=2)
HEAVY = Scenario(n_robots=3, robot_model="double_integrator")
PITCH = 0.5
GRAVITY = [-math.sin(PITCH), 0.0, -math.cos(PITCH)]


@pytest.mark.parametrize(
    ("name", "scenario", "rows", "expected"),
    [
        ("bearing-only", POINT, [[1, 0], [0, 1]], [1, 1]),
        ("bearing-only", POINT, [[0.6, 0.8], [0, 0]], [0.6, 0.8]),
        ("unicycle", UNICYCLE, [[0.6, 0.8], [0, 0]], [0.6, 0.8]),
        ("unicycle", UNICYCLE, [[-1, 0], [0, -1]], [-1, -0.9]),  # ω saturates
        ("unicycle-cosine", UNICYCLE, [[0.6, 0.8], [0, 0]], [0.6, math.cos(2.5)]),
        ("nonholonomic-3d", SPACE, [[0, 0.6, 0.8], [1, 0, 0], GRAVITY],
         [1, 0.6 / math.cos(PITCH), 0.8]),
        # β = π/2, and β = −π/2 with f_y = 0
        ("nonholonomic-3d", SPACE, [[0, 1, 0], [0, 0, 0], [-1, 0, 0]], [0, 20, 0]),
        ("nonholonomic-3d", SPACE, [[0, 0, 1], [0, 0, 0], [1, 0, 0]], [0, 0, 1]),
        ("damped", HEAVY, [[1, 0], [0, 1], [0.3, -0.4]], [0.7, 1.4]),
        # within the limit of 8 m/s², direction kept
        ("damped", HEAVY, [[6, 0], [0, 8], [0, 0]], [4.8, 6.4]),
        ("zero", POINT, [[1, 0], [0, 1]], [0, 0]),
    ],
)  # fmt: skip
def test_laws_match_hand_computation(name, scenario, rows, expected):
    """All robots of a team have the same rows."""
    shape = (scenario.n_robots, *scenario.observation_layout.shape)
    seen = np.broadcast_to(np.array(rows, dtype=np.float32), shape)
    actions = baselines.make(name, scenario)(seen, 2.5)
    assert actions.dtype == np.float32
    np.testing.assert_allclose(actions, np.tile(expected, (3, 1)), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("pitch", [-3.0, -1.2, 0.0, 0.4, 1.6])
def test_pitch_is_read_from_gravity(pitch):
    gravity = np.array([-math.sin(pitch), 0.0, -math.cos(pitch)])
    assert laws.pitch_of(gravity) == pytest.approx(pitch, abs=1e-15)
    assert laws.pitch_of(np.zeros((2, 3))).tolist() == [0, 0]


def test_cosine_law_uses_time_of_each_environment():
    f = np.ones((2, 4, 2))
    rates = laws.unicycle_cosine_law(f, np.array([0.0, math.pi]))[..., 1]
    np.testing.assert_allclose(rates, [[1] * 4, [-1] * 4])
    np.testing.assert_allclose(laws.unicycle_cosine_law(f, math.pi / 3)[..., 1], 0.5)


@pytest.mark.parametrize("scenario", [POINT, UNICYCLE, SPACE, CLUTTER])
def test_every_fitting_policy_respects_bounds(scenario):
    random = np.random.default_rng(0)
    n, layout = scenario.n_robots, scenario.observation_layout
    observations = random.normal(size=(2, 4, n, *layout.shape)).astype(np.float32)
    observations[1, 2, 0] = 0  # a robot that is gone
    for name in baselines.names(scenario):
        if not name.startswith("privileged"):  # these see more than observations
            batch = baselines.make(name, scenario)(observations, random.random((2, 4)))
            assert batch.shape == (2, 4, n, scenario.action_size) and batch.dtype == np.float32
            assert (np.abs(batch) <= scenario.action_bounds.astype(np.float32)).all()  # no NaN
            single = baselines.make(name, scenario)(observations[1, 3], 0.25)
            assert single.shape == (n, scenario.action_size)


def test_random_policy_is_uniform_and_reproducible():
    slow = Scenario(n_robots=3, max_speed=0.5)
    view = np.zeros((400, 3, *slow.observation_layout.shape), np.float32)
    drawn = baselines.make("random", slow, seed=7)
    first, second = drawn(view, 0.0), drawn(view, 0.1)
    assert not np.array_equal(first, second)
    assert np.abs(first).max() <= 0.5 and abs(first.mean()) < 0.03
    assert first.std() == pytest.approx(1 / math.sqrt(12), rel=0.05)
    drawn.reset()
    np.testing.assert_array_equal(drawn(view, 0.0), first)
    drawn.reset(np.zeros(400, bool))
    np.testing.assert_array_equal(drawn(view, 0.1), second)
    assert not np.array_equal(baselines.make("random", slow, seed=8)(view, 0.0), first)


class TestRegistry:
    def test_names_lists_fitting_policies(self):
        everywhere = {"random", "zero"}
        references = {"consensus", "circumcentre", "enclosing-ball", "nearest-pursuit", "planner"}
        flat = {"smallest-sector", "quantised"}
        field = {"unit-mean", "cyclic-pursuit", "nearest-pursuit", "link-keeping", *flat}
        plane = {"bearing-only", *field, *STEERED, *everywhere}
        plane |= {f"privileged-{name}" for name in references}
        steered = {*STEERED, "privileged-planner", *everywhere}
        cars = {"unicycle", "unicycle-cosine", "pursuit", "windshield", *steered}
        cars |= {"search-and-pursue", "learned-search"}
        flyers = {"nonholonomic-3d", "pursuit", *steered}
        rules = {"tangent", "tangent-blocking", "tangent-merged"}
        among_discs = {"tangent-merged", "tangent-merged-tuned", "tank-merged"}
        rules |= {f"{rule}-certified" for rule in rules} | among_discs
        for scenario, wanted in (
            (POINT, plane),
            (UNICYCLE, cars),
            (SPACE, flyers),
            (POINT.replace(dim=3), plane - flat),
            (CLUTTER, plane | rules),
            (rv.scenarios.get("unicycle-clutter-8"), cars | among_discs),
            ("clutter-3d-32", (plane - flat) | rules),
            ("uav-clutter-16", flyers | among_discs),
            (HEAVY, {"damped", *everywhere}),
        ):
            assert set(baselines.names(scenario)) == wanted
        assert len(baselines.names()) == 34

    def test_policies_have_descriptions_in_order_of_kind(self):
        """Exactly the oracles, which read positions, have privileged in name and kind."""
        kinds = [policy.kind_of(name) for name in baselines.names()]
        assert kinds == sorted(kinds, key=list(policy.KINDS).index) and "own" not in kinds
        for name, kind in zip(baselines.names(), kinds, strict=True):
            assert policy.about(name), name
            assert name.startswith("privileged") == (kind == "privileged")
        assert baselines.names(UNICYCLE) == [
            "unicycle", "unicycle-cosine", "pursuit", "windshield", "search-and-pursue", *NAMES,
            "privileged-planner", "random", "zero",
        ]  # fmt: skip

    @pytest.mark.parametrize(
        ("name", "scenario", "options", "message"),
        [
            ("bearing_only", POINT, {}, "is unknown.*bearing-only.*did you mean 'bearing-only'"),
            ("unicycle", POINT, {}, "does not fit single_integrator robots in 2-D.*bearing-only"),
            ("tangent", POINT, {}, "with 0 obstacle slots"),
            ("tangent-merged", CLUTTER, {"clearence": 1}, "'clearence'; did you mean 'clearance'"),
            ("zero", POINT, {"seed": 1}, "no option 'seed'; known are none"),
        ],
    )
    def test_make_errors_list_valid_names(self, name, scenario, options, message):
        with pytest.raises(ValueError, match=message):
            baselines.make(name, scenario, **options)

    @pytest.mark.parametrize(
        ("name", "fits", "kind", "build", "message"),
        [
            ("mine", bool, "best", POINT, "kind is 'best'; it must be one of 'law', 'field'"),
            ("mine", bool, ["own"], POINT, r"kind is \['own'\]; it must be one of 'law'"),
            ("", bool, "own", POINT, "name of a policy is ''; it must be a word"),
            (5, bool, "own", POINT, "name of a policy is 5; it must be a word"),
            ("a:b", bool, "own", POINT, "name of a policy is 'a:b'; it must be without a colon"),
            ("learned", bool, "own", POINT, "is 'learned'; it must be another: it is one of the l"),
            ("mine", None, "own", POINT, "fits of policy 'mine' is None; it must be a function of"),
            ("mine", bool, "own", POINT, "policy 'mine' is Scenario"),
        ],
    )
    def test_invalid_registration_is_rejected(self, name, fits, kind, build, message):
        before = baselines.names()
        with pytest.raises(ValueError, match=message):
            policy.register(name, fits=fits, kind=kind)(build)
        assert baselines.names() == before


class TestLargeSparseGraphs:
    """Their default step depends on the degrees, and law (1) is scaled to it."""

    def sparse(self, n=60, **fields):
        graph = fields.pop("graph", rv.graphs.erdos_renyi(0.06))
        return rv.Scenario(n_robots=n, graph=graph, spawn_size=12.0, **fields)

    def test_default_step_follows_degrees(self):
        scenario = self.sparse()
        assert scenario.max_degree == 59.0
        assert scenario.step_degree == pytest.approx(2 * 0.06 * 59) == scenario.speed_limit
        assert scenario.tau == pytest.approx(scenario.merge_radius / (2 * scenario.step_degree))
        assert scenario.scales_velocity and scenario.tau > 8 * scenario.certified_step
        links = [(i, i + 1) for i in range(49)] + [(0, k) for k in range(5, 12)]
        fixed = self.sparse(50, graph=rv.graphs.from_edges(links))
        assert fixed.step_degree == 8.0 and fixed.max_degree == 49.0

    def test_other_scenarios_use_certified_or_given_step(self):
        others = {"graph": "cycle"}, {"graph": "complete"}, {"robot_model": "unicycle"}
        large = [self.sparse(47), *(self.sparse(**fields) for fields in others)]
        for scenario in (*large, *map(rv.scenarios.get, rv.scenarios.names())):
            assert scenario.n_robots > 47 or scenario.step_degree == scenario.max_degree
            assert scenario.tau in (scenario.time_step, scenario.certified_step)
            assert not scenario.scales_velocity
        given = self.sparse(time_step=0.001)
        assert given.tau == 0.001 and not given.scales_velocity

    @pytest.mark.slow
    def test_large_sparse_team_meets_and_v_never_increases(self):
        scenario = self.sparse(time_limit=40.0)
        found = rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=3, num_envs=6)
        assert found.success.all()
        assert (found.largest_rise_between_merges <= 0.0).all()

    def test_hub_scales_its_velocity(self):
        """Thirty neighbours on one side and 29 on the other: D_i = 59 m/s, ‖f_i‖ = 1 m/s."""
        scenario = self.sparse(graph=rv.graphs.erdos_renyi(0.03))
        seen = np.zeros((60, *scenario.observation_layout.shape), np.float32)
        seen[0, :30, 0], seen[0, 30:, 0], seen[1, 0, 0] = 1.0, -1.0, 1.0
        hub, leaf, *_ = baselines.make("bearing-only", scenario)(seen, 0.0)[:, 0]
        assert hub == pytest.approx(scenario.step_degree / 59) and leaf == 1.0
