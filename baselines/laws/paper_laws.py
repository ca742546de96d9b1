"""Laws of Zhao & Zheng (2017), with equation numbers."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, positive, short_repr
from rendezvous_env.safety.heading import step_scale
from rendezvous_env.safety.links import link_keeping_law, min_norm_points
from rendezvous_env.safety.turning import yaw_rate_law
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario

from ..policy import (
    Float32,
    TeamPolicy,
    is_double_integrator,
    is_single_integrator,
    of_model,
    register,
    within_limits,
)

Array = NDArray[np.float64]


def degree_of(seen: ObservedRows) -> Array:
    """Degree D_i = Σ_j a_ij, the sum of the neighbour rows' lengths, (...), m/s."""
    return np.asarray(np.linalg.norm(seen.neighbours, axis=-1).sum(-1, np.float64))


def pitch_of(gravity: NDArray[Any]) -> Array:
    """Pitch β, (...), rad, from gravity (−sin β, 0, −cos β) in the body frame, (..., 3), or 0."""
    pitch: Array = np.arctan2(-gravity[..., 0], -gravity[..., 2], dtype=np.float64)
    return np.where(np.any(gravity, axis=-1), pitch, 0.0)


def bearing_only_law(net_bearing: Array) -> Array:
    """The bearing-only law: ṗᵢ = fᵢ, (..., d), m/s, in the robot's own frame (eq. 1)."""
    return net_bearing


def unicycle_law(net_bearing: Array) -> Array:
    """Speed and turn rate of the unicycle law, (..., 2), m/s and rad/s, for f, (..., 2), m/s.

        v = hᵀf,   ω = (h^⊥)ᵀf,   h = (cos θ, sin θ)                  (eqs. 7, 8)

    f is in the body frame, where h is the x axis and h^⊥ the y axis.
    """
    v, omega = net_bearing[..., 0], net_bearing[..., 1]
    return np.stack([v, omega], axis=-1)


def unicycle_cosine_law(net_bearing: Array, time: ArrayLike) -> Array:
    """Speed and turn rate, (..., n, 2), of a unicycle with the open-loop rate cos t.

        v = hᵀf,   ω = cos t                                        (eq. 7 and the remark after it)

    Args:
        net_bearing: f, (..., n, 2), m/s, in the body frame.
        time: t, s, one number or (...).

    Raises:
        ValueError: if the time is not finite or of another shape.
    """
    v, t = net_bearing[..., 0], floats("time", time)[..., np.newaxis]
    if t.shape[:-1] not in ((), v.shape[:-1]) or not np.isfinite(t).all():
        raise ValueError(
            f"time is {short_repr(time)}; it must be one finite number, or {v.shape[:-1]} of "
            "them (s)"
        )
    return np.stack([v, np.broadcast_to(np.cos(t), v.shape)], axis=-1)


def nonholonomic_3d_law(net_bearing: Array, pitch: Array) -> Array:
    """Speed, yaw and pitch rate, (..., 3), m/s and rad/s, for f, (..., 3), m/s, and β, (...), rad.

        v = hᵀf,   (α̇, β̇) = (AᵀA)⁻¹ Aᵀ P_h f                         (eqs. 12, 17)

    In the body frame (x = h, y = horizontal left, z = upward) this is v = f_x, α̇ = f_y/cos β,
    β̇ = f_z. The law is singular at β = ±π/2, a case that the paper does not treat: here α̇ saturates
    at the action bound, and is 0 if f_y = 0.
    """
    f_x, f_y, f_z = np.moveaxis(net_bearing, -1, 0)
    return np.stack([f_x, yaw_rate_law(f_y, pitch), f_z], axis=-1)


def damped_law(net_bearing: Array, velocity: Array, *, damping: float) -> Array:
    """Accelerations, (..., d), m/s², of double integrators towards the net bearing.

        a = f − k v

    Not a law of the paper. While no limit applies, the energy H = ½ Σ‖v‖² + V/2 decreases,
    Ḣ = −k Σ‖v‖²; V itself may increase. Under a constant f the velocity tends to f/k.

    f and v are (..., d) in the same frame, m/s, with f interpreted in m/s²; k in 1/s.
    """
    f, v, k = net_bearing, velocity, damping
    return f - k * v


@dataclass(frozen=True)
class Law(TeamPolicy):
    """Base class of memoryless laws; actions are limited to the scenario's bounds."""

    scenario: Scenario

    @abstractmethod
    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        """Actions (..., n, a) from f, (..., n, d), m/s, the observations and the time, s."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        return within_limits(self.actions(f, seen, time), self.scenario)

    def slowed(self, velocity: Array, seen: ObservedRows) -> Array:
        """Velocities (..., n, d), m/s, scaled down if the default step is long (theory 4)."""
        if not self.scenario.scales_velocity:
            return velocity
        scale = step_scale(degree_of(seen), self.scenario.merge_radius, self.scenario.tau)
        return np.asarray(velocity * scale[..., np.newaxis])


@dataclass(frozen=True)
class LawPolicy(Law):
    """Law from a function."""

    law: Callable[[Array, ObservedRows, ArrayLike], Array]
    """Function with arguments and result of ``Law.actions``."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        """Result of the function."""
        return self.law(f, seen, time)


@register("bearing-only", fits=is_single_integrator, kind="law")
class _BearingOnly(Law):
    """Law (1): the velocity is the net bearing f."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return self.slowed(bearing_only_law(f), seen)


@register("link-keeping", fits=is_single_integrator, kind="law")
class _LinkKeeping(Law):
    """Law (R b): connectivity maintenance; no visible link grows longer."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "links", "share": 1.0}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        step = {"merge_radius": self.scenario.merge_radius, "duration": self.scenario.tau}
        return link_keeping_law(min_norm_points(seen.neighbours), degree_of(seen), **step)


# The paper's laws are in continuous time. With zero-order hold a turn rate may rotate the body past
# f, and back in the next step. Turns therefore end at f. This departs from the paper for ‖f‖τ > 1,
# and in 3-D near β = ±π/2.


def _no_farther(rate: Array, angle: Array, duration: float) -> Array:
    """Turn rate, rad/s, limited so that the axis turns at most by the angle within the duration."""
    most = np.abs(angle) / duration
    return np.clip(rate, -most, most)


def unicycle_inputs(net_bearing: Array, duration: float) -> Array:
    """``unicycle_law`` for steps of a duration, s: turns end at f."""
    f = net_bearing
    rate = _no_farther(f[..., 1], np.arctan2(f[..., 1], f[..., 0]), duration)
    return unicycle_law(np.stack([f[..., 0], rate], axis=-1))


def nonholonomic_3d_inputs(net_bearing: Array, pitch: Array, duration: float) -> Array:
    """``nonholonomic_3d_law`` for steps of a duration, s: turns end at f."""
    f = net_bearing
    speed, yaw_rate, pitch_rate = np.moveaxis(nonholonomic_3d_law(f, pitch), -1, 0)
    upright = np.copysign(1.0, np.cos(pitch))
    ahead = np.abs(np.cos(pitch)) * f[..., 0] - upright * np.sin(pitch) * f[..., 2]
    azimuth, rise = np.arctan2(upright * f[..., 1], ahead), np.arctan2(f[..., 2], f[..., 0])
    turns = _no_farther(yaw_rate, azimuth, duration), _no_farther(pitch_rate, rise, duration)
    return np.stack([speed, *turns], axis=-1)


is_unicycle = of_model("unicycle")
"""True if actions are a speed and a turn rate in the plane."""


@register("unicycle", fits=is_unicycle, kind="law")
class _Unicycle(Law):
    """Laws (7) and (8) for unicycles: speed along f, turning towards it."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return unicycle_inputs(f, self.scenario.tau)


@register("unicycle-cosine", fits=is_unicycle, kind="law")
class _UnicycleCosine(Law):
    """Law (7) for unicycles with the open-loop turn rate ω = cos t."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return unicycle_cosine_law(f, time)


@register("nonholonomic-3d", fits=of_model("nonholonomic_3d"), kind="law")
class _Nonholonomic3D(Law):
    """Laws (12) and (17) for 3-D nonholonomic robots."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        assert seen.gravity is not None  # these robots always sense it
        return nonholonomic_3d_inputs(f, pitch_of(seen.gravity), self.scenario.tau)


@register("damped", fits=is_double_integrator, kind="law")
@dataclass(frozen=True)
class _Damped(Law):
    """Law (1) with damping for double integrators; not from the paper."""

    damping: float = 1.0  # k, 1/s

    def __post_init__(self) -> None:
        positive("damping", self.damping, "1/s")

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        assert seen.velocity is not None  # these robots always sense it
        return damped_law(f, seen.velocity.astype(np.float64), damping=self.damping)


LAW_OF_MODEL = {
    "single_integrator": "bearing-only",
    "unicycle": "unicycle",
    "nonholonomic_3d": "nonholonomic-3d",
    "double_integrator": "damped",
}
"""Name of the law of each robot model."""
_INPUTS: dict[str, Callable[[Array, ObservedRows, float], Array]] = {
    "single_integrator": lambda f, seen, tau: bearing_only_law(f),
    "unicycle": lambda f, seen, tau: unicycle_inputs(f, tau),
    "nonholonomic_3d": lambda f, seen, tau: nonholonomic_3d_inputs(f, _pitch_in(seen), tau),
    "double_integrator": lambda f, seen, tau: damped_law(f, _velocity_in(seen), damping=1.0),
}
"""Inputs of each robot model, (..., a), for f, (..., d), m/s, observations, and τ, s."""


def _pitch_in(seen: ObservedRows) -> Array:
    assert seen.gravity is not None
    return pitch_of(seen.gravity)


def _velocity_in(seen: ObservedRows) -> Array:
    assert seen.velocity is not None
    return np.asarray(seen.velocity, np.float64)


def _is_mixed(scenario: Scenario) -> bool:
    """True for mixed teams with a law for each model."""
    return scenario.mixes_models and set(scenario.robot_model) <= set(_INPUTS)


@register("by-model", fits=_is_mixed, kind="law")
class _ByModel(Law):
    """The law of each robot of a mixed team: (1), (7) and (8), (12) and (17), or damped."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        scenario = self.scenario
        actions = np.zeros((*f.shape[:-1], scenario.action_size))
        for name in _INPUTS.keys() & set(scenario.robot_model):
            own = np.array([model == name for model in scenario.robot_model])
            actions[..., own, :] = _INPUTS[name](f, seen, scenario.tau)[..., own, :]
        points = np.array([model == "single_integrator" for model in scenario.robot_model])
        size = np.linalg.norm(actions, axis=-1)
        limit = scenario.speed_limits / np.maximum(size, scenario.speed_limits)
        return np.where(points[:, np.newaxis], actions * limit[..., np.newaxis], actions)
