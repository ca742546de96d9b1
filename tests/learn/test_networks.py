"""Set network: invariance to order, absent rows and orientation."""

import numpy as np
import pytest
import torch
from inference_network import make_network, stirred

from baselines.learned import checkpoints, shipped
from baselines.learned.features import CONTEXT_COLUMNS, FeatureLayout
from baselines.learned.numpy_actor import NumpyActor
from baselines.learned.policy_settings import CHOICES, PolicySettings
from train.learn import networks, sets

K, M = 4, 6
SETTINGS = {"set_width": 8, "hidden": (16,)}


def network(K=K, M=M):
    return stirred(make_network(FeatureLayout(K, M), **SETTINGS))


def shown(robots=50, columns=CONTEXT_COLUMNS):
    """Random rows, some absent, as (neighbours, obstacles, context)."""
    random = np.random.default_rng(0)
    parts = [random.normal(size=(robots, *shape)) for shape in ((K, 3), (M, 6), (columns,))]
    parts[0][random.random((robots, K)) < 0.3] = 0.0
    parts[1][random.random((robots, M)) < 0.5] = 0.0
    parts[1][0] = 0.0  # sees no obstacle
    return parts


def flat(parts):
    joined = np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)
    return torch.as_tensor(joined.astype(np.float32))


def outputs(made, parts):
    with torch.no_grad():
        chances = made.get_distribution(flat(parts)).distribution.probs
        return chances.numpy(), made.predict_values(flat(parts)).numpy()


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6)


def test_set_network_is_permutation_invariant_and_uses_all_inputs():
    made, parts = network(), shown()
    (neighbours, obstacles, context), random = parts, np.random.default_rng(1)
    mixed = (neighbours[:, random.permutation(K)], obstacles[:, random.permutation(M)], context)
    before, value = outputs(made, parts)
    assert_same(outputs(made, mixed), (before, value))
    for k in range(3):
        changed = [part.copy() for part in parts]
        changed[k][1:] += 0.5 * (changed[k][1:] != 0)
        after, other = outputs(made, changed)
        assert np.abs(after - before).max() > 1e-3 and np.abs(other - value).max() > 1e-3


@pytest.mark.parametrize(("more_neighbours", "more_obstacles"), [(3, 0), (0, 18), (28, 18)])
def test_absent_rows_are_ignored(more_neighbours, more_obstacles):
    made, (neighbours, obstacles, context) = network(), shown()
    wide = make_network(FeatureLayout(K + more_neighbours, M + more_obstacles), **SETTINGS)
    wide.load_state_dict(made.state_dict())
    padded = (
        np.concatenate([neighbours, np.zeros((50, more_neighbours, 3))], axis=1),
        np.concatenate([np.zeros((50, more_obstacles, 6)), obstacles], axis=1),
        context,
    )
    assert_same(outputs(wide, padded), outputs(made, (neighbours, obstacles, context)))


def test_empty_sets_are_finite():
    neighbours, obstacles, context = (np.zeros_like(part) for part in shown())
    seen = outputs(network(), (neighbours, obstacles, context))
    assert_same(seen, outputs(network(M=0), (neighbours, obstacles[:, :0], context)))
    assert all(np.isfinite(values).all() for values in seen)


def test_untrained_network_prefers_rule():
    torch.manual_seed(3)
    chances, _ = outputs(make_network(FeatureLayout(K, M), prior=2.0, **SETTINGS), shown())
    expected = np.r_[np.exp(2.0), np.ones(CHOICES - 1)] / (np.exp(2.0) + CHOICES - 1)
    np.testing.assert_allclose(chances, np.broadcast_to(expected, chances.shape), atol=0.1)
    assert (chances.argmax(axis=1) == 0).all()


@pytest.mark.parametrize("tank", [False, True])
def test_numpy_actor_matches_torch(tank):
    """The critic's weights are not required."""
    settings = PolicySettings(
        **SETTINGS, clearance=0.1, persistence=0.5, min_alignment=0.1, max_turn_rate=3.0,
        decision_time=0.2, **({"guarantee": "tank", "memory": "features"} if tank else {}),
    )  # fmt: skip
    layout = settings.layout(K, M)
    made = stirred(make_network(layout, len(settings.angles), **SETTINGS))
    parts = shown(3000, layout.context_columns)
    for part in parts:
        part[:5] = 0.0
    seen = flat(parts)
    weights = {k: v.numpy() for k, v in made.state_dict().items() if "value" not in k}
    ours = NumpyActor(weights, settings, layout)
    with torch.no_grad():
        distribution = made.get_distribution(seen)
    expected = distribution.distribution.logits.numpy()
    preferences = ours.preferences(seen.numpy())
    np.testing.assert_allclose(
        preferences - preferences.max(axis=1, keepdims=True),
        expected - expected.max(axis=1, keepdims=True),
        atol=2e-5,
    )
    chosen = ours.choose(seen.numpy())
    clear = np.diff(np.sort(expected, axis=1)[:, -2:])[:, 0] > 1e-4
    np.testing.assert_array_equal(chosen[clear], distribution.mode().numpy()[clear])
    assert clear.mean() > 0.99 and len(np.unique(chosen)) > 3
    del weights["action_net.bias"]
    with pytest.raises(ValueError, match=r"weights have no 'action_net\.bias'"):
        NumpyActor(weights, settings, layout)


def judged(made, seen):
    """Outputs of a network in an update, and all gradients."""
    found = made.judged(seen)
    loss = (found[0].softmax(dim=-1).square().sum(dim=-1) + found[1][:, 0].square()).sum()
    return [*(told.detach() for told in found), *torch.autograd.grad(loss, made.parameters())]


@pytest.mark.kernels
@pytest.mark.parametrize("name", shipped.NAMES)
def test_pooling_kernels_match_torch(name, monkeypatch):
    """Outputs and gradients of the shipped weights; equal rows share those of the maximum."""
    about, tables = checkpoints.read(checkpoints.find(shipped.folder(name)), ["network"])
    settings = PolicySettings.from_plain(about["policy"])
    layout, own = settings.layout(K, M), {name: getattr(settings, name) for name in SETTINGS}
    made = make_network(layout, settings.choices, **own)
    weights = {k: torch.from_numpy(v) for k, v in tables["network"].items()}
    made.load_state_dict(weights, strict=False)
    assert made.state_dict().keys() & weights.keys() >= {"action_net.weight"}
    parts = shown(700, layout.context_columns)
    parts[0][1, :2] = [0.6, 0.8, 1.0]
    parts[0][2] = parts[1][2] = 0.0
    ours = judged(made, flat(parts))
    monkeypatch.setattr(networks, "pooled", sets.pooled_anywhere)
    expected = judged(made, flat(parts))
    for one, other in zip(ours, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5 * float(other.abs().max()))
    assert min(float(other.abs().max()) for other in expected) > 0.0


def test_log_probabilities_match_torch():
    made, seen = network(), flat(shown())
    with torch.no_grad():
        expected = made.get_distribution(seen).distribution
        choices, values, log_prob = made(seen.repeat(400, 1))
        torch.testing.assert_close(log_prob, expected.log_prob(choices.view(400, -1)).flatten())
        torch.testing.assert_close(values, made.predict_values(seen).repeat(400, 1))
        assert torch.equal(made(seen, deterministic=True)[0], expected.probs.argmax(dim=-1))
    shares = torch.nn.functional.one_hot(choices.view(400, -1), CHOICES).double().mean(dim=0)
    error = (expected.probs * (1 - expected.probs) / 400).sqrt()
    assert ((shares - expected.probs).abs() <= 5 * error + 2 / 400).all()
    assert ((shares - expected.probs) / error.clamp(min=0.01)).square().mean() < 1.5
