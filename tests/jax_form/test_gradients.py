"""Gradients through steps and policies: finite wherever a step leads, and equal to differences."""

import numpy as np
import pytest
from parameters import marked

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
    (_, merged), slope = jax.jit(jax.value_and_grad(cost, has_aux=True))(edges)
    assert merged > 0, "the gradient passed no merge"
    value = jax.jit(lambda edges: cost(edges)[0])
    for k in range(3):
        step = h * np.eye(3)[k]
        difference = (value(edges + step) - value(edges - step)) / (2 * h)
        assert slope[k] == pytest.approx(float(difference), rel=1e-4, abs=1e-7)
