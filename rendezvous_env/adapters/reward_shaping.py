"""Robot rewards under custom wrappers that change the team reward."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy, deepcopy
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Env, Space
from gymnasium.vector import VectorEnv, VectorRewardWrapper, VectorWrapper
from gymnasium.wrappers.vector import NormalizeReward
from numpy.typing import NDArray

from ..envs.guarantee import layers_of
from ..envs.training import TrainingVectorEnv
from ..envs.vector_env import RendezvousVectorEnv, Transition
from ..envs.vector_wrappers import GuaranteeWrapper

_ROUNDING = 1e-6  # of a ratio of rewards, in float32


class RewardShaping:
    """Robot rewards under custom wrappers that change the team reward.

    | wrapper | robot rewards |
    |---|---|
    | Gymnasium's ``NormalizeReward`` | divided by the same number |
    | ``VectorRewardWrapper``, as ``TransformReward`` | its ``rewards``, applied to each robot |
    | any other | plus the change of the team reward, or times a common factor |

    The last row uses a factor if different rewards are multiplied by the same number. A wrapper
    that changes ``infos["robot_rewards"]`` itself takes precedence. A wrapper that scales the
    environments by different factors should do so. With ``on_merge="remove"`` inactive robots
    receive reward 0. A recorder is inserted beneath each external wrapper to detect its changes. A
    wrapper that changes observations must also change ``infos["final_obs"]``.
    """

    def __init__(self, vector_env: VectorEnv[Any, Any, Any]) -> None:
        self._top: _Changes | None = None
        above: Any = None
        for layer in [*layers_of(vector_env)]:
            if not isinstance(layer, _OURS) and hasattr(layer, "env"):
                if type(layer.env) is not _Recorder:
                    layer.env = _Recorder(layer.env)
                changes = _Changes(layer, layer.env)
                if above is None:
                    self._top = changes
                elif not isinstance(above, _Shaper):
                    above.env = _Shaper(layer, changes)
                above = layer.env
            else:
                above = layer

    def robot_rewards(
        self, rewards: NDArray[np.float64], infos: Mapping[str, Any], acted: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Robot rewards of the last step, (B, n).

        They follow from the result of the outermost wrapper and the robots (B, n) that acted.
        """
        given: NDArray[np.float64] = infos["robot_rewards"]
        return given if self._top is None else self._top.rewards(rewards, given, acted)

    def check_final(self, observations: NDArray[np.float32], infos: Mapping[str, Any]) -> None:
        """Reject an outermost wrapper that changes observations, but not the final ones."""
        if self._top is not None:
            self._top.check_final(observations, infos)


class _Given(NamedTuple):
    """Result of a step, passed to the wrapper above."""

    rewards: NDArray[np.float64]  # (B,)
    robot_rewards: NDArray[np.float64]  # (B, n)
    acted: NDArray[np.bool_]  # (B, n)
    observations: NDArray[np.float32] | None  # (B, n, ...), if episodes ended in it
    final: list[NDArray[np.float32]]  # (n, ...) each, of the episodes that ended


class _Recorder(VectorWrapper):
    """Wrapper that records the result of the last step for the wrapper above."""

    given: _Given

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, actions: Any) -> Transition:
        """As the vector environment."""
        simulator = self.env.unwrapped.simulator  # type: ignore[attr-defined]
        acted = simulator.active | (simulator.scenario.on_merge == "follow")
        seen, rewards, ends, cuts, infos = self.env.step(actions)
        final = _final_of(infos)
        self.given = _Given(
            np.array(rewards, np.float64),
            infos["robot_rewards"].copy(),
            acted,
            seen.copy() if final else None,
            [each.copy() for each in final],
        )
        return seen, rewards, ends, cuts, infos


class _Shaper(_Recorder):
    """Wrapper that passes on robot rewards, as changed by the wrapper beneath."""

    def __init__(self, env: VectorEnv[Any, Any, Any], changes: _Changes) -> None:
        super().__init__(env)
        self._changes = changes

    def step(self, actions: Any) -> Transition:
        """As the vector environment, with consistent ``robot_rewards``."""
        seen, rewards, ends, cuts, infos = self.env.step(actions)
        self._changes.check_final(seen, infos)
        given = infos["robot_rewards"]
        infos["robot_rewards"] = self._changes.rewards(rewards, given)
        return seen, rewards, ends, cuts, infos


class _Changes:
    """Changes by one wrapper in the last step."""

    def __init__(self, layer: Any, recorder: _Recorder) -> None:
        self._layer, self._recorder, self._factor = layer, recorder, _Factor()
        self._applies = (
            isinstance(layer, VectorRewardWrapper) and type(layer).step is VectorRewardWrapper.step
        )

    def rewards(
        self,
        rewards: NDArray[np.float64],
        given: NDArray[np.float64],
        acted: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """Robot rewards, (B, n), from the wrapper's result and the robots (B, n) that acted.

        None means the same robots as recorded.
        """
        layer, below = self._layer, self._recorder.given
        if not np.array_equal(given, below.robot_rewards):
            return given
        if isinstance(layer, NormalizeReward):
            changed = given / np.sqrt(layer.return_rms.var + layer.epsilon)
        elif self._applies:
            twin, columns = _twin(layer), given.T
            changed = np.stack([np.asarray(twin.rewards(each.copy())) for each in columns], axis=1)
        else:
            rewards = np.asarray(rewards, np.float64)
            factor = self._factor.between(below.rewards, rewards)
            added = (rewards - below.rewards)[:, np.newaxis]
            changed = given + added if factor is None else given * factor
        follows = self._recorder.unwrapped.simulator.scenario.on_merge == "follow"  # type: ignore[attr-defined]
        acted = below.acted if acted is None or follows else acted
        return np.where(acted, changed, given)

    def check_final(self, observations: NDArray[np.float32], infos: Mapping[str, Any]) -> None:
        """Reject a wrapper that changes observations, but not the final ones."""
        below = self._recorder.given
        if below.observations is None or np.array_equal(below.observations, observations):
            return
        pairs = zip(below.final, _final_of(infos), strict=True)
        if all(np.array_equal(before, now) for before, now in pairs if before.any()) and any(
            before.any() for before in below.final
        ):
            raise TypeError(
                f"environments are wrapped in {type(self._layer).__name__}, which changes "
                "observations "
                "but not infos['final_obs'], the last ones of episodes, by which time-outs are "
                "valued; it must change both alike"
            )


class _Factor:
    """Detector of wrappers that multiply rewards rather than add to them.

    A factor is the same ratio for different rewards, of a batch or of two steps.
    """

    def __init__(self) -> None:
        self._multiplies, self._reward, self._ratio = False, 0.0, 0.0

    def between(self, before: NDArray[np.float64], after: NDArray[np.float64]) -> float | None:
        """Factor applied to the rewards (B,) of a step; None if there is none."""
        counts = before != 0.0
        if not counts.any():
            return None
        ratios, rewards = after[counts] / before[counts], before[counts]
        if after[~counts].any() or np.ptp(ratios) > _ROUNDING * np.abs(ratios).max():
            self._multiplies = False
            return None
        ratio, reward = float(ratios[0]), float(rewards[0])
        again = abs(ratio - self._ratio) <= _ROUNDING * abs(ratio)
        if np.ptp(rewards) > 0.0 or (self._reward not in (0.0, reward) and again):
            self._multiplies = True
        self._reward, self._ratio = reward, ratio
        return ratio if self._multiplies else None


def _final_of(infos: Mapping[str, Any]) -> list[Any]:
    """Final observations of environments that ended in a step, (n, ...) each."""
    return [each for each in infos.get("final_obs", ()) if each is not None]


def _twin(layer: Any) -> Any:
    """Copy of a wrapper with separate memory, for side-effect-free evaluation."""
    twin = copy(layer)
    for name, value in vars(layer).items():
        if not (callable(value) or isinstance(value, Env | VectorEnv | Space)):
            setattr(twin, name, deepcopy(value))
    return twin


_OURS = (RendezvousVectorEnv, GuaranteeWrapper, TrainingVectorEnv, _Recorder)
