"""Gradients through steps and policies: finite wherever a step leads, and equal to differences."""

import numpy as np
import pytest
from parameters import marked

import rendezvous_env as rv

MODELS = {
    "single integrators": ("cloud-8", {"dim": 2}),
    "single integrators in 3-D": ("cloud-8", {}),
    "double integrators": ("duo", {"robot_model": "double_integrator"}),
    "unicycles": ("unicycle-6", {}),
    "nonholonomic robots": ("uav-6", {}),
}


def together(state):
    """The state with two robots of three at one place, so that f of all is on one line."""
    places = np.array(state.positions)
    places[1] = places[0]
    return state.replace(positions=places)


@pytest.mark.slow
@pytest.mark.parametrize("model", marked(MODELS, slow=MODELS.keys() - {"single integrators"}))
def test_gradients_are_finite_at_singular_states(model, rj):
    """Coincident robots, f = 0 between two others, actions of zero, and robots at rest."""
    import jax
    import jax.numpy as jnp

    scenario, fields = MODELS[model]
    env = rj.make(scenario, n_robots=3, differentiable=True, **fields)
    _, begun = env.reset(1)
    middle = np.array(begun.positions)
    middle[1] = 0.5 * (middle[0] + middle[2])
    rest = jnp.zeros(env.action_space.shape)

    def cost(positions, weights, action):
        state, total = begun.replace(positions=positions, weights=weights), 0.0
        for chosen in (rest, action, action):
            seen, state, reward, *_ = env.step(None, state, chosen)
            total += state.lyapunov + state.path_length + reward + (seen**2).sum()
        return total

    slopes = jax.jit(jax.grad(cost, argnums=(0, 1, 2)))
    for positions in (together(begun).positions, middle, 0.0 * middle):
        for found in slopes(positions, begun.weights, rest):
            assert np.isfinite(found).all()


@pytest.mark.slow
def test_gradient_of_edge_weights_and_meeting_time_equals_differences(rj):
    import jax
    import jax.numpy as jnp

    env = rj.make("duo", n_robots=3, differentiable=True, spawn_size=1.5, time_step=0.05)
    layout, (_, begun) = env.scenario.observation_layout, env.reset(5)
    first, second = np.triu_indices(3, 1)

    def cost(edges):
        """Smooth time to rendezvous, s/(s + 1 m) summed over steps."""
        weights = jnp.zeros((3, 3)).at[first, second].set(edges)
        now = env.step(None, begun.replace(weights=weights + weights.T), jnp.zeros((3, 2)))

        def advance(now, _):
            action = 0.5 * rj.bearing_only_law(rj.net_bearing(now[0], layout))
            seen, state, *_ = env.step(None, now[1], action)
            places = state.positions[state.merged_into]
            squares = ((places[first] - places[second]) ** 2).sum(axis=1)
            spread = jnp.sqrt(squares + 1e-6).sum()
            return (seen, state), spread / (spread + 1.0)

        (_, state), shares = jax.lax.scan(advance, now[:2], None, 25)
        return shares.sum(), (state.merged_into != jnp.arange(3)).sum()

    edges, h = np.array([0.7, 1.1, 0.9]), 1e-6
    both = jax.jit(jax.value_and_grad(cost, has_aux=True))
    (_, merged), slope = both(edges)
    assert merged > 0, "the gradient passed no merge"
    for k in range(3):
        step = h * np.eye(3)[k]
        (ahead, _), (behind, _) = (both(edges + way)[0] for way in (step, -step))
        difference = (ahead - behind) / (2 * h)
        assert slope[k] == pytest.approx(float(difference), rel=1e-4, abs=1e-7)


SHAPES = [
    rv.Disc((0.2, 0.3), 0.6),
    rv.Capsule(((-1.5, -1.2), (-0.6, -1.4)), 0.3),
    rv.Polygon(((0.9, -1.2), (1.6, -1.0), (1.3, -0.3))),
]
BALLS = [rv.Sphere((0.2, 0.3, 0.0), 0.6), rv.Capsule(((-1.0, -1.0, 0.0), (-0.6, -1.4, 0.3)), 0.4)]
AMONG = {"n_robots": 3, "spawn_size": 4.0, "obstacles": SHAPES, "max_speed": 1.0}
CONTACTS = {
    "stop": ("duo", {**AMONG, "obstacle_contact": "stop"}),
    "slide in space": ("duo", {**AMONG, "dim": 3, "obstacles": BALLS}),
    "unicycles": ("unicycle-6", AMONG),
}


@pytest.mark.nightly
@pytest.mark.parametrize("case", CONTACTS)
def test_gradients_through_contact_equal_differences(case, rj):
    """Each robot moves towards the middle of an obstacle, and past it."""
    import jax
    import jax.numpy as jnp

    scenario, fields = CONTACTS[case]
    env = rj.make(scenario, differentiable=True, time_step=0.05, **fields)
    n, d = env.scenario.n_robots, env.scenario.dim
    _, begun = env.reset(2)
    places = np.zeros((n, d))
    places[:, :2] = [[-0.9, 0.45], [-1.0, -0.4], [1.5, 0.6]]
    aims = np.array([[1.0, -0.1, 0.0], [-0.1, -1.0, 0.0], [-0.1, -1.0, 0.0]])[:, :d]
    if env.scenario.model.nonholonomic:
        begun = begun.replace(memory=jnp.asarray(np.arctan2(aims[:, 1:2], aims[:, :1])))
        aims = np.stack([np.ones(n), np.full(n, 0.3)], axis=1)
    else:
        begun = begun.replace(frames=jnp.broadcast_to(jnp.eye(d).ravel(), (n, d * d)))
    weights = jnp.asarray(np.random.default_rng(0).uniform(0.5, 1.0, (n, d)))

    def cost(positions, gain):
        _, state = env._look(begun.replace(positions=positions))

        def advance(state, _):
            state = env.step(None, state, gain * jnp.asarray(aims))[1]
            return state, state.contacts

        state, contacts = jax.lax.scan(advance, state, None, 26)
        return (weights * state.positions).sum() + 0.1 * state.path_length, contacts[-1]

    both, h = jax.jit(jax.value_and_grad(cost, argnums=(0, 1), has_aux=True)), 1e-5
    (_, touched), slopes = both(jnp.asarray(places), 0.9)
    assert touched > 5, "hardly a contact"

    def value(*at):
        return both(*at)[0][0]

    for i in range(n):
        for axis in range(d):
            step = np.zeros((n, d))
            step[i, axis] = h
            difference = (value(places + step, 0.9) - value(places - step, 0.9)) / (2 * h)
            assert slopes[0][i, axis] == pytest.approx(float(difference), rel=1e-4, abs=1e-4)
    difference = (value(places, 0.9 + h) - value(places, 0.9 - h)) / (2 * h)
    assert slopes[1] == pytest.approx(float(difference), rel=1e-4, abs=1e-6)
