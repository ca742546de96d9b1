"""jit, vmap, grad, keys: what functions of JAX promise."""

import numpy as np
import pytest
from parameters import slow

import rendezvous_env as rv

SMALL = {"dim": 2, "n_robots": 3, "spawn_size": 2.0}


def run(jax, env, state, observations, steps, gain=1.0):
    """Final state after steps under law (1) times a gain, and the largest action."""
    layout = env.scenario.observation_layout

    def advance(now, _):
        state, seen = now
        action = gain * seen[..., layout.neighbours, :].sum(axis=-2)
        seen, state, *_ = env.step(None, state, action)
        return (state, seen), abs(action).max()

    (state, _), largest = jax.lax.scan(advance, (state, observations), None, steps)
    return state, largest.max()


@pytest.mark.slow
def test_gradients_equal_central_differences_through_merges(rj):
    import jax
    import jax.numpy as jnp

    env = rj.make("cloud-8", differentiable=True, **SMALL)
    begun, steps, h = env.reset(3), 60, 1e-6

    def cost(positions, gain):
        observations, state = begun
        state = state.replace(positions=positions)
        observations, state = env._look(state)
        state = state.replace(initial_lyapunov=state.lyapunov)
        last, _ = run(jax, env, state, observations, steps, gain)
        return last.lyapunov + last.path_length, last

    both = jax.jit(jax.value_and_grad(cost, argnums=(0, 1), has_aux=True))
    (_, last), (slope, slope_of_gain) = both(begun[1].positions, 0.5)
    assert (last.merged_into != jnp.arange(3)).any(), "the gradient passed no merge"

    def value(*at):
        return both(*at)[0][0]

    places = np.asarray(begun[1].positions)
    for i, axis in ((0, 0), (1, 1), (2, 0)):
        moved = np.zeros_like(places)
        moved[i, axis] = h
        difference = (value(places + moved, 0.5) - value(places - moved, 0.5)) / (2 * h)
        assert slope[i, axis] == pytest.approx(float(difference), rel=1e-4, abs=1e-6)
    difference = (value(places, 0.5 + h) - value(places, 0.5 - h)) / (2 * h)
    assert slope_of_gain == pytest.approx(float(difference), rel=1e-4)


@pytest.mark.nightly
def test_gradients_are_finite_for_coincident_robots_and_zero_actions(rj):
    import jax

    env = rj.make("cloud-8", "heading", differentiable=True, **SMALL)
    _, begun = env.reset(0)

    def cost(positions, choices):
        observations, state = env._look(begun.replace(positions=positions))
        observations, state, reward, *_ = env.step(None, state, choices)
        return state.lyapunov + state.path_length + reward + (observations**2).sum()

    together = np.zeros((3, 2))
    together[2] = 1.0  # on the diagonal; two robots stand on one another
    slopes = jax.grad(cost, argnums=(0, 1))(together, np.zeros((3, 2)))
    assert all(np.isfinite(slope).all() for slope in slopes)


@pytest.mark.slow
def test_one_team_equals_its_row_in_a_batch_and_under_vmap(rj):
    import jax
    import jax.numpy as jnp

    many = rj.make("cloud-8", num_envs=2, autoreset_mode="SAME_STEP", **SMALL)
    one = rj.make("cloud-8", autoreset_mode="SAME_STEP", **SMALL)
    observations, state = many.reset([7, 8])
    begun = [one.reset(seed) for seed in (7, 8)]
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts), *begun)
    law = jax.jit(jax.vmap(lambda state, seen: run(jax, one, state, seen, 120)))
    mapped, _ = law(stacked[1], stacked[0])
    last, _ = jax.jit(lambda state, seen: run(jax, many, state, seen, 120))(state, observations)
    assert (last.episode > 0).any()
    for ours, theirs in zip(jax.tree.leaves(last), jax.tree.leaves(mapped), strict=True):
        np.testing.assert_allclose(np.moveaxis(np.asarray(ours), -1, 0), theirs, atol=1e-12)


@pytest.mark.slow
def test_a_key_draws_seeds_of_its_own(rj):
    import jax

    env = rj.make("cloud-8", num_envs=2, **SMALL)
    (_, one), (_, other), (_, again) = (env.reset(jax.random.key(k)) for k in (0, 1, 0))
    np.testing.assert_array_equal(one.positions, again.positions)
    assert (one.positions != other.positions).all()
    assert (one.positions[..., 0] != one.positions[..., 1]).all()
    high, low = np.asarray(one.seed, np.uint64)[:, 0]
    _, same = env.reset([int(high >> np.uint64(1)) << 33 | int(low), 0])
    assert same.positions.shape == one.positions.shape


def test_traced_seeds_are_refused_and_traced_keys_accepted(rj):
    import jax
    import jax.numpy as jnp

    env = rj.make("cloud-8", **SMALL)
    for reset in (jax.vmap(env.reset), jax.jit(env.reset)):
        with pytest.raises(
            ValueError, match=r"seed is .*; it must be a JAX key under jit and vmap"
        ):
            reset(jnp.arange(4))
    observations, _ = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 4))
    assert observations.shape == (4, *env.reset(0)[0].shape)


@pytest.mark.slow
def test_float32_starts_agree_to_its_precision(rj):
    import jax

    engine = rv.make_vec("cloud-8", num_envs=4)
    engine.reset(seed=11)
    with jax.enable_x64(False):
        _, state = rj.make("cloud-8", num_envs=4).reset(11)
    assert state.positions.dtype == np.float32
    places = np.moveaxis(np.asarray(state.positions), -1, 0)
    np.testing.assert_allclose(places, engine.simulator.positions, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("guarantee", [None, "heading"])
@pytest.mark.parametrize("size", [1e25, 1e-25])
def test_float32_steps_agree_for_actions_whose_square_is_out_of_range(guarantee, size, rj):
    import jax

    actions = np.broadcast_to(np.float32(size) * np.array([0.6, -0.8], np.float32), (3, 4, 2))
    fields = {"num_envs": 3, "n_robots": 4}
    engine = rv.make_vec("duo", **fields)
    if guarantee is not None:
        engine = rv.vector.HeadingVectorWrapper(engine)
    engine.reset(seed=4)
    engine.step(actions)
    with jax.enable_x64(False):
        env = rj.make("duo", guarantee, **fields)
        _, state = env.reset(4)
        _, state, *_ = env.step(None, state, actions)
    places = np.moveaxis(np.asarray(state.positions), -1, 0)
    np.testing.assert_allclose(places, engine.unwrapped.simulator.positions, atol=1e-5)


@pytest.mark.slow
def test_spaces_hold_observations_and_are_those_of_make_vec(rj):
    engine = rv.make_vec("uav-6", num_envs=3)
    env = rj.make("uav-6", num_envs=3)
    assert env.observation_space == engine.observation_space
    assert env.action_space == engine.action_space
    observations, _ = env.reset(2)
    assert np.asarray(observations) in env.observation_space
    assert env.single_action_space.shape == rj.make("uav-6").action_space.shape


@pytest.mark.slow
def test_a_team_that_has_ended_stands_still_without_autoreset(rj):
    env = rj.make("duo", time_limit=0.2)
    _, state = env.reset(0)
    told = []
    for _ in range(4):
        _, state, reward, terminated, truncated, info = env.step(None, state, np.ones((2, 2)))
        told.append((float(reward) != 0.0, bool(terminated), bool(truncated), float(info["time"])))
    ends = [end for _, _, end, _ in told]
    assert ends.count(True) == 1
    assert [earned for earned, *_ in told][ends.index(True) + 1 :] == [False] * (
        3 - ends.index(True)
    )
    assert told[-1][3] == told[ends.index(True)][3]


@pytest.mark.slow
def test_what_is_not_a_number_stays_in_its_team(rj):
    env = rj.make("cloud-8", num_envs=2, **SMALL)
    observations, state = env.reset(0)
    for _ in range(40):
        action = np.array(observations.sum(axis=2))
        action[0, 0] = np.nan
        observations, state, reward, terminated, _, info = env.step(None, state, action)
    assert np.isnan(state.positions[0, :, 0]).all()
    assert np.isnan(reward[0])
    assert np.isnan(info["lyapunov"][0])
    assert np.isnan(observations[0]).any()
    assert not terminated[0]
    assert np.isfinite(reward[1])
    assert np.isfinite(state.positions[..., 1]).all()
    assert (state.merged_into[:, 1] != np.arange(3)).any()


@pytest.mark.slow
@pytest.mark.parametrize("wide", [False, slow(True)])
@pytest.mark.parametrize(
    ("name", "guarantee", "changes"),
    [
        ("cloud-8", None, {}),
        ("clutter-4", "tank", {"sensing": rv.Sensing(noise=0.1, dropout=0.1, delay=2)}),
        slow("uav-6", "heading", {"sensing": rv.Sensing(range=5.0, bias=0.1)}),
        slow("corridor", None, {"robot_model": "unicycle", "merge_through_obstacles": False}),
    ],
)
def test_a_step_keeps_the_types_of_the_state(name, guarantee, changes, wide, rj):
    import jax

    with jax.enable_x64(wide):
        env = rj.make(name, guarantee, num_envs=2, autoreset_mode="SAME_STEP", **changes)
        seed = jax.ShapeDtypeStruct((2, 2), np.uint32)
        _, before = jax.eval_shape(env._begin, seed)
        action = jax.ShapeDtypeStruct(env.action_space.shape, np.float32)
        _, after, *_ = jax.eval_shape(env._go, before, action)
    assert jax.tree.structure(before) == jax.tree.structure(after)
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    assert all(a.dtype == b.dtype and a.shape == b.shape for a, b in pairs)
