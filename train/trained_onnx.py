"""ONNX export of models of stable-baselines3 or torch, from observations to choices."""

import io
import json
import warnings
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.onnx_network import DIGEST_KEY, NO_DIGEST, digest_of
from rendezvous_env.baselines.trained_policy import ARGUMENTS_KEY, OBSERVATION, TrainedPolicy

from .checks import UserError

_OPSET = 18
_AT_ONCE = 512


def content_of(policy: TrainedPolicy) -> bytes:
    """Content of the ONNX file of a policy's model: observation (N, …) → action (N, a), N free.

    The metadata contain the arguments of ``vector.training_env`` in training, as JSON, and a
    digest.

    Raises:
        UserError: for a model of another library, or arguments that JSON does not support.
    """
    import onnx
    import torch

    actor, shape = actor_of(policy.model), policy.observation_shape
    written = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter is old, but self-contained
        torch.onnx.export(
            actor,
            (torch.zeros(2, *shape),),
            cast(Any, written),
            input_names=[OBSERVATION],
            output_names=["action"],
            dynamic_axes={OBSERVATION: {0: "robots"}, "action": {0: "robots"}},
            opset_version=_OPSET,
            dynamo=False,
        )
    made = onnx.load_from_string(written.getvalue())
    about = {"arguments": policy.arguments, "by_team": policy.by_team, "shape": list(shape)}
    try:
        told = {ARGUMENTS_KEY: json.dumps(about), DIGEST_KEY: json.dumps(NO_DIGEST)}
    except TypeError as error:
        raise UserError(f"arguments of TrainedPolicy are {policy.arguments}: {error}") from error
    onnx.helper.set_model_props(made, told)
    told[DIGEST_KEY] = json.dumps(digest_of(made.SerializeToString()))
    onnx.helper.set_model_props(made, told)
    return made.SerializeToString()


def actor_of(model: Any) -> Any:
    """Torch module of a model: observations (N, …) → greedy actions."""
    import torch

    model = getattr(model, "__self__", model)  # model.predict belongs to a model
    if not isinstance(model, torch.nn.Module) and hasattr(model, "policy"):
        model = model.policy
    if not isinstance(model, torch.nn.Module):
        kind = type(model).__name__
        raise UserError(
            f"the model is a {kind}; an ONNX file is made of a model of stable-baselines3 or a "
            "torch module. --standalone robot.py writes a function that needs NumPy alone"
        )
    model = model.cpu().eval()
    return _greedy(model) if hasattr(model, "_predict") else model


def _greedy(policy: Any) -> Any:
    """Torch module of a stable-baselines3 policy's ``predict(deterministic=True)``."""
    import torch

    space = policy.action_space

    class Greedy(torch.nn.Module):
        """Module from observations to actions within their space."""

        def __init__(self) -> None:
            super().__init__()
            self.policy = policy

        def forward(self, observation: Any) -> Any:
            """Actions of all robots."""
            action = self.policy._predict(observation, deterministic=True)
            if not hasattr(space, "low"):
                return action
            low, high = (torch.as_tensor(end) for end in (space.low, space.high))
            if self.policy.squash_output:
                return low + 0.5 * (action + 1.0) * (high - low)
            return torch.minimum(torch.maximum(action, low), high)

    return Greedy().eval()


def compare(policy: TrainedPolicy, written: TrainedPolicy, checks: int) -> float:
    """Largest difference between the choices of a policy and of its file, on random observations.

    For discrete choices it is the fraction that differs.
    """
    random, worst = np.random.default_rng(0), 0.0
    for first in range(0, checks, _AT_ONCE):
        count = min(_AT_ONCE, checks - first)
        seen = random.normal(size=(count, *policy.observation_shape)).astype(np.float32)
        ours, theirs = (np.asarray(one.choices(seen)) for one in (policy, written))
        worst = np.maximum(worst, _difference(ours, theirs))  # keeps NaN
    return float(worst)


def _difference(ours: NDArray[Any], theirs: NDArray[Any]) -> float:
    if np.issubdtype(ours.dtype, np.integer):
        return float((ours != theirs).mean())
    return float(np.abs(ours - theirs).max())
