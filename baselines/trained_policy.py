"""Models trained in a training environment, as policies."""

import json
import os
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_shape, flag, raise_invalid
from rendezvous_env.envs.vector_wrappers import GuaranteeWrapper
from rendezvous_env.safety.safety_filter import SafetyFilter
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike
from rendezvous_env.vector import training_env

from .filtered_policies import DecidingPolicy, FilteredPolicy, guarantee_with
from .learned import checkpoints, learned_policy
from .learned.learned_policy import ControllerPolicy, LearnedPolicy
from .learned.onnx_network import SUFFIX, checked_session
from .learned.training_environment import FeatureVectorEnv
from .policy import AT_PATH, Float32, Mask, TeamPolicy, register_reader, within_limits

Predict = Callable[[Float32], NDArray[Any]]
"""Observations (B, n, ...) → actions (B, n, ...)."""


class TrainedPolicy(TeamPolicy):
    """Policy from a model of any library, trained in ``vector.training_env``.

        policy = TrainedPolicy("clutter-8", model.predict)          # stable-baselines3
        policy = TrainedPolicy("clutter-8", lambda seen: seen[:, :2], learning_preset=False)

    ``compare``, ``report``, ``render`` and ``rollout`` accept it like any other policy.
    Observations, decision period and guarantee are those of ``vector.training_env`` with the same
    arguments. As on a robot, contacts and merges are not observed: for a tank every step counts as
    commanded.

    Args:
        scenario: any scenario that the model supports, not only that of training, with the scenario
            fields among ``arguments``.
        predict: observations of robots, (N, size) float32 → actions, (N, a), or (N,) if discrete. A
            pair counts as actions and an unused state. An argument ``deterministic`` is set to
            True, as in stable-baselines3. A model with such a ``predict``, or a torch module of
            observations, is also accepted.
        by_team: whether ``predict`` takes (B, n, size) and returns (B, n, a); observations of
            merged robots are zero.
        arguments: arguments of ``vector.training_env`` in training: ``guarantee="heading"``,
            ``learning_preset=True``, ``flatten=True``, ``discrete=False``, those of the guarantee's
            wrapper, and scenario fields. Errors are the same.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        predict: Callable[..., Any],
        *,
        by_team: bool = False,
        **arguments: Any,
    ) -> None:
        self.model = predict
        """Model, or function of it."""
        predict = getattr(predict, "predict", predict)
        if not callable(predict):
            raise_invalid(
                "predict", predict, "a function of observations, or a model with predict()"
            )
        if hasattr(predict, "parameters") and hasattr(predict, "forward"):
            predict = partial(_run_module, predict)
        self._predict, self.by_team = predict, flag("by_team", by_team)
        self.arguments = arguments
        """Arguments of ``vector.training_env`` in training."""
        # stable-baselines3 samples actions by default
        takes: Collection[str] = ()
        with suppress(TypeError, ValueError):  # compiled functions may have no signature
            takes = signature(predict).parameters
        self._options = {"deterministic": True} if "deterministic" in takes else {}
        self._arguments = {"on_merge": "follow", **arguments, "autoreset_mode": "Disabled"}
        env = training_env(scenario, 1, **self._arguments)
        self.scenario = chosen = env.scenario
        self._sees: Any = env.single_observation_space
        self._chooses: Any = env.single_action_space
        inner: Any = env.env
        self._guarantee: dict[str, Any] | None = None
        self._policy: DecidingPolicy | None = None  # without a guarantee, choices are actions
        if isinstance(inner, FeatureVectorEnv):
            self._policy = preset = _PresetPolicy(chosen, self._ask, inner)
            self._guarantee = preset.guarantee
        elif isinstance(inner, GuaranteeWrapper):
            period = inner.decision_period
            self._policy = FilteredPolicy(chosen, self._choose, self._make_filter, period)
            self._guarantee = guarantee_with(arguments.get("guarantee", "heading"), arguments)
        owner = getattr(self.model, "__self__", self.model)  # of model.predict, the model
        space = getattr(owner, "observation_space", None)
        self._check_trained_for(getattr(space, "shape", None))

    def _check_trained_for(self, shape: tuple[int, ...] | None, what: str = "predict") -> None:
        """Raise a ValueError for a model of observations of another shape, None if unknown."""
        if shape is None or shape == self.observation_shape:
            return
        layout = self.scenario.observation_layout
        raise ValueError(
            f"{what} was trained for observations of shape {shape}; in {self.scenario.name!r} it "
            f"gets {self.observation_shape}, with neighbour_slots = {layout.neighbour_slots} and "
            f"obstacle_slots = {layout.obstacle_slots}. Give the arguments of training_env in "
            "training, or train with neighbour_slots and obstacle_slots that fit both scenarios"
        )

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: the guarantee of the training filter, for any model."""
        return self._guarantee

    def _make_filter(self, teams: int) -> SafetyFilter:
        env: Any = training_env(self.scenario, teams, **self._arguments).env
        found: SafetyFilter = env.filter
        return found

    def _choose(self, seen: Float32) -> NDArray[Any]:
        """Actions of the filter, (..., n, k), for observations (..., n, rows, d)."""
        return self._ask(seen).reshape(*seen.shape[:-2], -1)

    def _ask(self, seen: Float32) -> NDArray[Any]:
        """Actions of the model, (B, n, ...), for observations (B, n, ...)."""
        seen = seen.reshape(-1, *self._sees.shape)
        rows = seen if self.by_team else seen.reshape(-1, *seen.shape[2:])
        choices = self.choices(rows)
        robot = self._chooses.shape[1:]
        wanted = (*rows.shape[: 1 + self.by_team], *robot)
        check_shape(f"output of predict for observations {rows.shape}", choices, wanted)
        return choices.reshape(*seen.shape[:2], *robot)

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Shape of the model's input, without the axis of all robots, or of all environments."""
        shape: tuple[int, ...] = self._sees.shape
        return shape if self.by_team else shape[1:]

    def choices(self, seen: Float32) -> NDArray[Any]:
        """Output of the model for observations (N, …)."""
        found = self._predict(seen, **self._options)
        return np.asarray(found[0] if isinstance(found, tuple) else found)

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``Policy``; a ValueError for predictions of another shape, or naming a robot."""
        if self._policy is not None:
            return self._policy.act(observations, time)
        seen = self.scenario.observation_layout.checked(observations)
        actions = self._choose(np.asarray(seen, np.float32)).astype(np.float64)
        return within_limits(actions, self.scenario)

    def reset(self, mask: Mask | None = None) -> None:
        """As ``Policy.reset``."""
        if self._policy is not None:
            self._policy.reset(mask)


def _run_module(module: Any, seen: Float32) -> NDArray[Any]:
    """Output of a torch module for observations, without gradients."""
    like = next(iter(module.parameters()))
    try:
        found: NDArray[Any] = module(like.new_tensor(seen)).detach().cpu().numpy()
    except RuntimeError as error:
        raise ValueError(
            f"predict fails for observations of shape {seen.shape}: {error}; give the arguments of "
            "training_env in training"
        ) from error
    return found


ARGUMENTS_KEY = "rendezvous_trained"
"""Key in the metadata of an ONNX file of the training arguments, as JSON."""
OBSERVATION = "observation"
"""Name of the input of such a file."""


def load(path: str | os.PathLike[str], scenario: ScenarioLike) -> LearnedPolicy | TrainedPolicy:
    """Load a policy from a path, see ``learned_policy.load``, or from an exported model.

    The model is an ONNX file that ``rendezvous export`` wrote from a stable-baselines3 or torch
    model. Errors are the same.
    """
    path = checkpoints.as_path(path)
    if path.suffix.lower() == SUFFIX and path.is_file():
        with checkpoints.refusing(path):
            content = path.read_bytes()
        if ARGUMENTS_KEY.encode() in content:
            return _load_model(path, content, scenario)
    return learned_policy.load(path, scenario)


def _load_model(path: Path, content: bytes, scenario: ScenarioLike) -> TrainedPolicy:
    """Policy of a model in an ONNX file, run by onnxruntime."""
    session = checked_session(path, content)
    with checkpoints.refusing(path, "is not a policy of this version"):
        about = json.loads(session.get_modelmeta().custom_metadata_map[ARGUMENTS_KEY])
        shape, arguments = tuple(about["shape"]), about["arguments"]

    def predict(seen: Float32) -> NDArray[Any]:
        found: NDArray[Any] = session.run(None, {OBSERVATION: seen})[0]
        return found

    policy = TrainedPolicy(scenario, predict, by_team=about["by_team"], **arguments)
    policy._check_trained_for(shape, str(path))
    return policy


register_reader(AT_PATH, load)


class _PresetPolicy(ControllerPolicy):
    """Policy with the observations and base controller of the shipped policies."""

    def __init__(self, scenario: Scenario, ask: Predict, env: FeatureVectorEnv) -> None:
        super().__init__(scenario, env.settings)
        self._ask, self._discrete, self._one = ask, env.discrete, env.single_action_space

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._held = np.zeros((teams, *(self._one.shape or ())), np.float32)

    def _choose(self, shown: Float32, due: Mask) -> None:
        self._held[due] = self._ask(shown)[due]
        (self._controller.choose if self._discrete else self._controller.head)(self._held)
