"""Policies as JAX functions against those of ``baselines``."""

import importlib

import numpy as np
import pytest
from parameters import marked, slow
from rendezvous_env.baselines.laws import paper_laws
from rendezvous_env.baselines.learned import shipped
from rendezvous_env.baselines.learned.learned_policy import load
from rendezvous_env.baselines.learned.numpy_actor import NumpyActor
from rendezvous_env.baselines.learned.policy_settings import PolicySettings
from rendezvous_env.baselines.obstacle_rules import planes_in_space

import rendezvous_env as rv
from rendezvous_env import baselines

TEAMS, SEED = 4, 3
CASES = {
    "law (1)": ("bearing-only", "duo", {"n_robots": 5}),
    "law (1), long steps": ("bearing-only", "tree-12", {"n_robots": 48, "spawn_size": 20.0}),
    "laws (7) and (8)": ("unicycle", "unicycle-6", {}),
    "law (7), cos t": ("unicycle-cosine", "unicycle-6", {}),
    "laws (12) and (17)": ("nonholonomic-3d", "uav-6", {}),
    "damped": ("damped", "duo", {"robot_model": "double_integrator"}),
    "tuned": ("tangent-merged-tuned", "clutter-8", {}),
    "tuned, dense": ("tangent-merged-tuned", "clutter-24", {"n_robots": 3}),
    "tank": ("tank-merged", "clutter-8", {}),
    "tank, walls": ("tank-merged", "rooms", {}),
    "learned": ("learned", "clutter-8", {}),
    "learned, free": ("learned", "duo", {}),
    "learned tank": ("learned-tank", "corridor", {}),
}
for _name in ("tangent-merged-tuned", "tank-merged", "learned", "learned-tank"):
    for _scenario in ("unicycle-clutter-8", "clutter-3d", "uav-clutter-16"):
        CASES[f"{_name}, {_scenario}"] = _name, _scenario, {}
OWN_PATH = {
    "tank, walls", "learned", "tangent-merged-tuned, unicycle-clutter-8",
    "tank-merged, uav-clutter-16",
}  # fmt: skip
"""One slow case of each rule, of a network, and of robots in 3-D."""
SLOW = {case for case, (name, *_) in CASES.items() if name.startswith(("t", "learned"))}


@pytest.fixture
def jax_policies(rj):
    return importlib.import_module("rendezvous_env.baselines.jax")


@pytest.mark.parametrize("case", marked(CASES, slow=SLOW, own_path=OWN_PATH))
def test_policy_equals_its_numpy_form(case, jax_policies):
    import jax

    name, scenario, fields = CASES[case]
    env = rv.make_vec(scenario, num_envs=TEAMS, **fields)
    policy = baselines.make(name, env.unwrapped.scenario)
    form = jax_policies.make(name, env.unwrapped.scenario)
    act, memory = jax.jit(form.act), form.begin((TEAMS,))
    (seen, _), begun = env.reset(seed=SEED), None
    # in 3-D before merges: rounding decides on the first plane of a robot with one neighbour
    anew = 30 if env.unwrapped.scenario.dim == 3 else 100
    for step in range(300):
        if step == anew:  # the memory of one environment
            mask = np.arange(TEAMS) == 1
            policy.reset(mask)
            begun, memory = memory, form.forget(memory, mask)
        time = step * env.unwrapped.scenario.tau
        expected = policy(seen, time)
        actions, memory = act(seen, memory, time)
        np.testing.assert_allclose(actions, expected, rtol=0, atol=3e-6, err_msg=f"step {step}")
        seen, *_ = env.step(expected)
    assert abs(expected).max() > 0.05, "nobody moved"
    for old, new in zip(jax.tree.leaves(begun), jax.tree.leaves(memory), strict=True):
        assert old.shape == new.shape and old.dtype == new.dtype


@pytest.mark.slow
@pytest.mark.parametrize("name", ["learned", slow("learned-tank"), slow("recurrent")])
def test_network_equals_numpy_actor(name, jax_policies):
    rng, learned = np.random.default_rng(0), jax_policies.learned
    if name == "recurrent":
        settings = PolicySettings(8, (16,), 0.2, 0.5, 0.05, 100.0, 0.6, memory="recurrent")
        layout = settings.layout(3, 2)
        actor = NumpyActor(_random_weights(rng, settings, layout), settings, layout)
    else:
        policy = load(shipped.folder(name), "clutter-8")
        layout, actor = policy.settings.layout_of(policy.scenario), policy._chooser
    shown = rng.standard_normal((200, layout.size)).astype(np.float32)
    parts = layout.split(shown)
    parts.neighbours[rng.random(parts.neighbours.shape[:2]) < 0.3] = 0.0
    parts.obstacles[:100] = 0.0
    hidden = rng.standard_normal((200, 64 * (name == "recurrent"))).astype(np.float32)
    parameters = learned.parameters_of(actor)
    logits, kept = learned.preferences(parameters, layout, np.copy(shown), np.copy(hidden))
    expected = actor.preferences(shown, hidden)  # which updates the hidden state
    np.testing.assert_allclose(logits, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(kept, hidden, rtol=0, atol=1e-5)
    assert len(np.unique(expected.argmax(axis=-1))) > 1


def test_laws_equal_their_numpy_forms(jax_policies):
    """Random vectors, f = 0, and pitches on both sides of and at ±90°."""
    rng, laws = np.random.default_rng(4), baselines.laws
    f, v = rng.standard_normal((2, 300, 3))
    f[0] = f[1, 1] = 0.0
    pitch = rng.uniform(-np.pi, np.pi, 300)
    pitch[:4] = 0.5 * np.pi, -0.5 * np.pi, 0.0, np.pi
    h = v / np.linalg.norm(v, axis=-1, keepdims=True)
    found = jax_policies.laws
    close = {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(found.bearing_only_law(f), laws.bearing_only_law(f), **close)
    np.testing.assert_allclose(found.flexible_velocity(f, h), laws.flexible_velocity(f, h), **close)
    flat = f[:, :2]
    np.testing.assert_allclose(found.unicycle_law(flat), laws.unicycle_law(flat), **close)
    np.testing.assert_allclose(
        found._unicycle_inputs(flat, 0.3), paper_laws.unicycle_inputs(flat, 0.3), **close
    )
    np.testing.assert_allclose(
        found.nonholonomic_3d_law(f, pitch), laws.nonholonomic_3d_law(f, pitch), **close
    )
    np.testing.assert_allclose(
        found._nonholonomic_3d_inputs(f, pitch, 0.3),
        paper_laws.nonholonomic_3d_inputs(f, pitch, 0.3),
        **close,
    )
    np.testing.assert_allclose(
        found._damped_law(f, v, damping=2.0), laws.damped_law(f, v, damping=2.0), **close
    )


@pytest.mark.slow
def test_rule_in_planes_equals_the_kernel(jax_policies):
    """Random cones of all widths, with and without a kept plane."""
    import jax

    planes = importlib.import_module("rendezvous_env.baselines.jax.planes")
    rng, robots = np.random.default_rng(6), 200
    f, carried = rng.standard_normal((2, robots, 3))
    middle, aside = rng.standard_normal((2, robots, 5, 1, 3))
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    x = np.cross(middle, aside)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    azimuth = np.arange(8)[:, np.newaxis] * np.pi / 4
    half = rng.uniform(0.1, 1.4, (robots, 5, 1, 1))
    around = np.cos(azimuth) * x + np.sin(azimuth) * np.cross(middle, x)
    silhouettes = np.cos(half) * middle + np.sin(half) * around
    silhouettes[rng.random((robots, 5)) < 0.3] = 0.0
    asides = np.cross(f, carried)
    asides /= np.linalg.norm(asides, axis=-1, keepdims=True)
    asides[: robots // 3] = 0.0
    given = f.T, silhouettes, (0.2, 0.35), carried.T, asides.T
    rule = jax.jit(planes.headings_in_planes, static_argnums=2)
    heading, kept = rule(*(tuple(x) if k != 1 else x for k, x in enumerate(given)))
    expected = np.empty((robots, 3))
    planes_in_space.headings_in_planes(f, silhouettes, 0.2, carried, 0.35, asides, expected)
    np.testing.assert_allclose(np.stack(heading, axis=-1), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.stack(kept, axis=-1), asides, rtol=0, atol=1e-9)
    turned = np.abs(expected - f / np.linalg.norm(f, axis=-1, keepdims=True)).max(axis=-1) > 1e-3
    assert 20 < turned.sum() < robots - 20


def _random_weights(rng, settings, layout):
    width, units = settings.set_width, settings.units
    size = 4 * width + layout.context_columns
    shapes = {"memory.weight_ih": (3 * units, size), "memory.bias_ih": (3 * units,)}
    shapes |= {"memory.weight_hh": (3 * units, units), "memory.bias_hh": (3 * units,)}
    sets = {"neighbour_net": 3, "obstacle_net": 6}
    layers = {
        f"features_extractor.{net}.{2 * k}": (width, (columns, width)[k])
        for net, columns in sets.items()
        for k in range(2)
    }
    layers |= {"mlp_extractor.policy_net.0": (settings.hidden[0], units + size)}
    layers |= {"action_net": (len(settings.angles), settings.hidden[0])}
    for layer, shape in layers.items():
        shapes |= {f"{layer}.weight": shape, f"{layer}.bias": shape[:1]}
    return {key: 0.3 * rng.standard_normal(shape) for key, shape in shapes.items()}


@pytest.mark.slow
def test_joined_intervals_equal_the_kernel(jax_policies):
    """Random silhouettes of all widths: rotated copies merge, wrap around and close."""
    intervals = importlib.import_module("rendezvous_env.baselines.jax.merged_intervals")
    kernel = importlib.import_module("rendezvous_env.baselines.obstacle_rules.merged_intervals_2d")
    rng = np.random.default_rng(2)
    towards = rng.uniform(-np.pi, np.pi, 400)
    start, width = rng.uniform(-np.pi, np.pi, (400, 8)), rng.uniform(0.0, 2.6, (400, 8))
    edges = np.stack([start + width, start], axis=-1)
    silhouettes = np.stack([np.cos(edges), np.sin(edges)], axis=-1)
    silhouettes[rng.random((400, 8)) < 0.2] = 0.0
    silhouettes[0] = 0.0
    u = np.stack([np.cos(towards), np.sin(towards)])
    found = np.stack(intervals.merged_interval(tuple(u), silhouettes))
    room = np.empty((8, 2))
    expected = [
        kernel.merged_interval_2d((x, y, 0.0), points, room)
        for x, y, points in zip(*u, silhouettes, strict=True)
    ]
    expected = np.array(expected).T
    closed = expected[1] - expected[0] >= 2 * np.pi
    np.testing.assert_array_equal(found[1] - found[0] >= 2 * np.pi, closed)
    np.testing.assert_allclose(found[:, ~closed], expected[:, ~closed], rtol=0, atol=1e-9)
    assert 10 < closed.sum() < 380 and np.isinf(expected[0]).any()


def test_make_names_what_has_no_jax_form(jax_policies):
    with pytest.raises(NotImplementedError, match="policy 'tangent' has no JAX form; use "):
        jax_policies.make("tangent", "clutter-8")
    with pytest.raises(NotImplementedError, match="policy 'learned-search' has no JAX form"):
        jax_policies.make("learned-search", "utias-5")
    with pytest.raises(ValueError, match="policy 'unicycle' does not fit"):
        jax_policies.make("unicycle", "duo")
    with pytest.raises(ValueError, match="clearance is 4"):
        jax_policies.make("tangent-merged-tuned", "clutter-8", clearance=4.0)
    assert {"bearing-only", "tank-merged", "learned"} <= set(jax_policies.names())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["bearing-only", slow("tangent-merged-tuned"), slow("tank-merged")],
)
def test_gradients_of_rules_are_finite_where_nothing_is_observed(name, jax_policies):
    import jax

    form = jax_policies.make(name, "clutter-8")
    rng, shape = np.random.default_rng(1), (4, *form.scenario.observation_layout.shape)
    seen = rng.standard_normal(shape)
    seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    seen[0], seen[1, :3] = 0.0, 0.0  # a merged robot; f = 0 before an obstacle
    seen[2, 1], seen[2, 2] = -seen[2, 0], 0.0  # f = 0 between two neighbours
    seen[3, 3:] = 0.0
    memory = form.begin()
    share = rng.standard_normal((4, 2))
    slope = jax.jit(jax.grad(lambda rows: (form.act(rows, memory)[0] * share).sum()))(seen)
    assert np.isfinite(slope).all() and abs(slope[3]).max() > 0.0
