"""Common properties of all safety filters: batches, memory, single robots, errors."""

import numpy as np
import pytest
from conftest import MODELS, five

from rendezvous_env import Scenario, Sensing, Simulator, graphs, scenarios
from rendezvous_env.safety.gains import Gains
from rendezvous_env.safety.heading import HeadingFilter
from rendezvous_env.safety.links import LinkKeeping
from rendezvous_env.safety.safety_filter import SafetyFilter
from rendezvous_env.safety.settings import TANK_MARGIN
from rendezvous_env.safety.tank import EnergyTank

CASES = [(made, kind) for made in (HeadingFilter, EnergyTank) for kind in MODELS]
CASES += [(made, kind) for made in (Gains, LinkKeeping) for kind in MODELS if "single" in kind]
all_filters = pytest.mark.parametrize(("made", "kind"), CASES)


def begun(made, kind, num_envs, **options):
    """A filter, observations, and choices for it."""
    scenario = five(kind, spawn_size=3.0)
    filtered, random = made(scenario, num_envs, **options), np.random.default_rng(0)
    observations = Simulator(scenario, num_envs).reset(2)
    low = filtered.lowest_choice
    return filtered, observations, lambda: random.uniform(low, 1, filtered.held.shape)


def go_on(filtered, observations, choices, contact=None):
    seen = filtered.observe(observations)
    filtered.hold(choices)
    actions = filtered.apply(observations)
    filtered.update(contact)
    told = {name: values.copy() for name, values in filtered.diagnostics.items()}
    return {"seen": seen, "actions": actions, **told}


@pytest.mark.kernels
@all_filters
def test_batch_equals_single_environments(made, kind):
    together, observations, choose = begun(made, kind, 6)
    alone = [made(together.scenario, 1) for _ in range(6)]
    random = np.random.default_rng(1)
    for _ in range(3):
        choices, contact = choose(), random.random((6, 5)) < 0.3
        results = go_on(together, observations, choices, contact)
        for team, single in enumerate(alone):
            own = slice(team, team + 1)
            found = go_on(single, observations[own], choices[own], contact[own])
            for name, values in found.items():
                np.testing.assert_array_equal(values[0], results[name][team])


@pytest.mark.kernels
@pytest.mark.parametrize("n_robots", [2, 4, 5, 8])  # rows are processed in groups of four
def test_frames_turn_every_row(n_robots):
    scenario = Scenario(n_robots=n_robots, spawn_size=20.0)
    observations = Simulator(scenario, 3).reset(1)
    f = observations.astype(np.float64).sum(axis=2)
    x = (f / np.linalg.norm(f, axis=-1, keepdims=True))[:, :, np.newaxis]
    y = np.stack((-x[..., 1], x[..., 0]), axis=-1)
    turned = np.stack(((observations * x).sum(axis=-1), (observations * y).sum(axis=-1)), axis=-1)
    shown = HeadingFilter(scenario, 3).observe(observations)
    np.testing.assert_allclose(shown, turned, atol=1e-6)


@pytest.mark.kernels
@pytest.mark.parametrize("n_robots", [2, 4, 5, 8])
def test_tank_weighs_every_row(n_robots):
    scenario = Scenario(n_robots=n_robots, spawn_size=20.0)
    observations = Simulator(scenario, 3).reset(1)
    tank = EnergyTank(scenario, 3, budget=100.0, frame="local")
    actions = tank.apply(observations, np.full((3, n_robots, 2), 0.5, np.float32))
    tank.update()
    f = observations.astype(np.float64).sum(axis=2)
    degree = np.linalg.norm(observations.astype(np.float64), axis=-1).sum(axis=-1)
    moved = scenario.tau * actions.astype(np.float64)
    strength, r = np.linalg.norm(f, axis=-1), scenario.merge_radius
    speed_limit = scenario.robot_bounds[:, 0].min()
    scale = np.minimum(r / (2.0 * degree * scenario.tau), speed_limit / strength).clip(max=1.0)
    gain = 2.0 * (f * moved).sum(axis=-1) - 2.0 / r * degree * (moved**2).sum(axis=-1)
    gain -= TANK_MARGIN**2 * scenario.tau * scale * strength**2
    np.testing.assert_allclose(tank.levels - 100.0, gain, atol=1e-9)


@all_filters
def test_partial_reset_keeps_other_environments(made, kind):
    filtered, observations, choose = begun(made, kind, 3)
    beginning = filtered.get_state()
    go_on(filtered, observations, choose())
    before = filtered.get_state()
    filtered.forget(np.array([False, True, False]))
    after = filtered.get_state()
    for name, array in before.items():
        np.testing.assert_array_equal(after[name][[0, 2]], array[[0, 2]])
        np.testing.assert_array_equal(after[name][1], beginning[name][1])
    assert any((before[name] != beginning[name]).any() for name in before)


@all_filters
def test_robots_without_neighbours_stop(made, kind):
    filtered, observations, choose = begun(made, kind, 2)
    results = go_on(filtered, np.zeros_like(observations), choose())
    assert not results["actions"].any()
    assert np.isnan(results["alignment"]).all() and not results["lyapunov_rate"].any()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"levels": np.full((2, 5), -1.0)}, r"levels\[0, 0\] is -1.0; it must be from 0"),
        ({"levels": np.full((2, 5), np.nan)}, "levels.* must be finite"),
        ({"levels": np.full((2, 5), 1e61)}, "levels.* must be"),
        ({"frames": np.zeros((2, 5, 2, 2))}, "a rotation"),
    ],
)
def test_state_is_set_atomically(spoil, message):
    tank = EnergyTank(five("single_integrator-2d"), 2, budget=3.0)
    state = {**tank.get_state(), "held": np.ones((2, 5, 2))}
    with pytest.raises(ValueError, match=message):
        tank.set_state({**state, **spoil})
    assert not tank.get_state()["held"].any() and (tank.levels == 3.0).all()


ONE_WAY = graphs.directed_cycle()


@pytest.mark.parametrize(
    ("made", "changes", "options", "message"),
    [
        *(
            (made, {"robot_model": model}, {}, f"scenario has {model} robots.*{theorem} needs")
            for made, model, theorem in (
                (Gains, "unicycle", "theorem G"), (LinkKeeping, "unicycle", "theorem R"),
                (LinkKeeping, "double_integrator", "theorem R"),
                (EnergyTank, "double_integrator", r"law \(4\)"),
                (HeadingFilter, "double_integrator", r"law \(4\)"),
            )
        ),
        *(
            (LinkKeeping, {"sensing": Sensing(range=3.0, **sensing)}, {},
             rf"scenario: sensing\.{field}; theorem R needs")
            for sensing, field in (
                ({"field_of_view": 3.0}, "field_of_view is 3 rad"),
                ({"dropout": 0.1}, "dropout is 0.1"),
                ({"occlusion": "robots"}, "occlusion is 'robots'"),
                ({"occlusion": "obstacles"}, "occlusion is 'obstacles'"),
            )
        ),
        (LinkKeeping, {"graph": ONE_WAY}, {}, "graph is directed; theorem R needs"),
        (LinkKeeping, {"graph": graphs.switching([ONE_WAY, "path"])}, {},
         "graph is switching; theorem R needs"),
        (HeadingFilter, {}, {"certified": False, "bearing_error": 0.1},
         r"bearing_error is 0\.1; it must be 0 with certified=False"),
        (Gains, {}, {"min_gain": 0.0}, "min_gain is 0.0; it must be a positive"),
        (Gains, {}, {"max_gain": np.nan}, "max_gain is nan; it must be"),
        (Gains, {}, {"min_gain": 1e3}, r"min_gain is 1000.0; it must be at most r/τ"),
        (Gains, {}, {"min_gain": 1.0, "max_gain": 0.5},
         "max_gain is 0.5; it must be at least min_gain"),
    ],
)  # fmt: skip
def test_unsupported_scenario_is_rejected(made, changes, options, message):
    with pytest.raises(ValueError, match=message):
        made(Scenario(**changes), 1, **options)


def test_filter_must_define_actions():
    bare = SafetyFilter(five("single_integrator-2d"), 1, 2, "local", None)
    with pytest.raises(NotImplementedError, match="SafetyFilter needs compute"):
        bare.apply(np.zeros((1, 5, *bare.scenario.observation_layout.shape), np.float32))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("made", [EnergyTank, HeadingFilter])
def test_observations_of_other_types_are_converted(made, dim):
    """Kernels with pairwise sums must not read the bytes of other rows."""
    scenario = Scenario(n_robots=5, dim=dim)
    simulator, random = Simulator(scenario, 3), np.random.default_rng(0)
    seen, found = simulator.reset(0), []
    choices = random.uniform(-1, 1, (3, 5, dim)).astype(np.float32)
    for given in (seen, seen.astype(np.float64), np.repeat(seen, 2, axis=-1)[..., ::2]):
        error = {"bearing_error": 0.1} if made is HeadingFilter else {}
        safe = made(scenario, 3, **error)
        safe.hold(choices)
        found.append(safe.apply(given))
    assert np.abs(found[0]).max() > 0.1
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


@pytest.mark.kernels
@pytest.mark.parametrize("kind", ["single_integrator-2d", "single_integrator-3d"])
@pytest.mark.parametrize("made", [HeadingFilter, EnergyTank])
def test_observations_in_any_memory_order_are_filtered_alike(made, kind):
    """Every second row of a longer array, and Fortran order."""
    wanted = None
    for order in (
        np.ascontiguousarray,
        lambda rows: np.repeat(rows, 2, 2)[:, :, ::2],
        np.asfortranarray,
    ):
        filtered, observations, _ = begun(made, kind, 3)
        given = order(observations)
        np.testing.assert_array_equal(given, observations)
        seen = filtered.observe(given)
        wanted = seen if wanted is None else wanted
        np.testing.assert_array_equal(seen, wanted)


def test_filter_apply_takes_choices_and_keeps_them():
    """Equal to ``hold`` followed by ``apply`` without choices."""
    scenario = scenarios.get("fig3")
    observations = Simulator(scenario, 2).reset(seed=0)
    choices = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 3, 2))
    one, other = HeadingFilter(scenario, 2), HeadingFilter(scenario, 2)
    first = one.apply(observations, choices)
    other.hold(choices)
    np.testing.assert_array_equal(first, other.apply(observations))
    np.testing.assert_array_equal(one.held, other.held)
    np.testing.assert_array_equal(one.apply(observations), other.apply(observations))
    with pytest.raises(ValueError, match="actions"):
        one.apply(observations, choices[:1])


def test_filter_old_names_work_with_a_warning():
    """On a filter, in ``super()``, and in overridden methods."""
    scenario = scenarios.get("fig3")
    observations = Simulator(scenario).reset(seed=0)
    tank, other = (EnergyTank(scenario, 1, frame="local") for _ in range(2))
    for each in (tank, other):
        each.hold(np.full((1, 3, 2), 0.1))
    with pytest.warns(DeprecationWarning, match=r"SafetyFilter\.\w+ is called \w+ now"):
        np.testing.assert_array_equal(tank.act(observations), other.apply(observations))
        tank.book()
        assert tank.keeps_ledger and tank.leads and set(tank.told) == set(other.diagnostics)
        assert tank.view(observations) is observations
    other.update()
    np.testing.assert_array_equal(tank.levels, other.levels)
    assert (tank.levels > 0.0).all()

    with pytest.warns(DeprecationWarning, match=r"Old\.(act|told|keeps_ledger) is called \w+ now"):

        class Old(HeadingFilter):
            keeps_ledger = True

            @property
            def told(self):
                return {"more": self.lyapunov_rate, **super().told}

            def act(self, observations):
                return 0.5 * super().act(observations)

    with pytest.warns(DeprecationWarning):
        old, new = Old(scenario, 1), HeadingFilter(scenario, 1)
        halved = old.apply(observations, np.ones((1, 3, 2)))
        np.testing.assert_array_equal(halved, 0.5 * new.apply(observations, np.ones((1, 3, 2))))
        assert list(old.diagnostics) == ["more", *new.diagnostics]
    assert old.uses_feedback and not old.supports_multi_step and new.supports_multi_step
