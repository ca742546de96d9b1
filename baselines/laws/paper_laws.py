"""The laws of the paper, with its equation numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, positive, shown
from rendezvous_env.safety.heading import flexible_velocity, step_scale
from rendezvous_env.safety.links import least_norm_points, link_keeping_law
from rendezvous_env.safety.turning import yaw_rate_law
from rendezvous_env.scenario.observation_layout import ObservedRows

from ..policy import (
    Policy,
    TeamPolicy,
    is_double_integrator,
    is_single_integrator,
    register,
    within_limits,
)

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

Array = NDArray[np.float64]

__all__ = [
    "LawPolicy",
    "bearing_only_law",
    "damped_law",
    "degree_of",
    "flexible_velocity",
    "link_keeping_law",
    "nonholonomic_3d_law",
    "pitch_of",
    "unicycle_cosine_law",
    "unicycle_law",
]


# ---- what a robot sees --------------------------------------------------------------------------


def degree_of(seen: ObservedRows) -> Array:
    """D_i = Σ_j a_ij, the summed lengths of the neighbour rows, (...), m/s."""
    return np.asarray(np.linalg.norm(seen.neighbours, axis=-1).sum(-1, np.float64))


def pitch_of(gravity: NDArray[Any]) -> Array:
    """Pitch β from the direction of gravity in the body frame, (−sin β, 0, −cos β).

    Args:
        gravity: (..., 3); the zero row of a robot that is gone gives 0.

    Returns:
        β, (...), rad, in (−π, π].
    """
    sin_pitch, cos_pitch = -gravity[..., 0], -gravity[..., 2]
    pitch: Array = np.arctan2(sin_pitch, cos_pitch, dtype=np.float64)
    return np.where(np.any(gravity, axis=-1), pitch, 0.0)


# ---- laws ---------------------------------------------------------------------------------------


def bearing_only_law(net_bearing: Array) -> Array:
    """Velocity of the bearing-only law.

        ṗᵢ = fᵢ                                                     (eq. 1)

    Args:
        net_bearing: fᵢ, (..., d), m/s, in the robot's own frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    return net_bearing


def unicycle_law(net_bearing: Array) -> Array:
    """Speed and turn rate of the unicycle law.

        v = hᵀf,   ω = (h^⊥)ᵀf,   h = (cos θ, sin θ)                  (eqs. 7, 8)

    Args:
        net_bearing: f, (..., 2), m/s, in the body frame, where h is the x axis and h^⊥ the y axis.

    Returns:
        (v, ω), (..., 2), m/s and rad/s.
    """
    v, omega = net_bearing[..., 0], net_bearing[..., 1]
    return np.stack([v, omega], axis=-1)


def unicycle_cosine_law(net_bearing: Array, time: ArrayLike) -> Array:
    """Speed and turn rate of a unicycle that turns to and fro whatever it sees.

        v = hᵀf,   ω = cos t                                        (eq. 7 and the remark after it)

    Args:
        net_bearing: f, (..., n, 2), m/s, in the body frame.
        time: t, (...) for each team, s.

    Returns:
        (v, ω), (..., n, 2), m/s and rad/s.

    Raises:
        ValueError: if the time is not one finite number, or one for each team.
    """
    v, t = net_bearing[..., 0], floats("time", time)[..., np.newaxis]
    if t.shape[:-1] not in ((), v.shape[:-1]) or not np.isfinite(t).all():
        raise ValueError(
            f"time is {shown(time)}; it must be one finite number, or {v.shape[:-1]} of them (s)"
        )
    omega = np.broadcast_to(np.cos(t), v.shape)
    return np.stack([v, omega], axis=-1)


def nonholonomic_3d_law(net_bearing: Array, pitch: Array) -> Array:
    """Speed, yaw rate and pitch rate of the 3-D nonholonomic law.

        v = hᵀf,   (α̇, β̇) = (AᵀA)⁻¹ Aᵀ P_h f                         (eqs. 12, 17)

    In the body frame (x = h, y = horizontal left, z = up-ish) this is v = f_x, α̇ = f_y/cos β,
    β̇ = f_z. At β = ±π/2 it is singular, of which the paper says nothing: here α̇ grows until it is
    saturated at the action bound, and it is 0 where f_y = 0.

    Args:
        net_bearing: f, (..., 3), m/s, in the body frame.
        pitch: β, (...), rad.

    Returns:
        (v, ω_α, ω_β), (..., 3), m/s and rad/s, not yet saturated.
    """
    f_x, f_y, f_z = np.moveaxis(net_bearing, -1, 0)
    return np.stack([f_x, yaw_rate_law(f_y, pitch), f_z], axis=-1)


def damped_law(net_bearing: Array, velocity: Array, *, damping: float) -> Array:
    """Acceleration of a robot with inertia that goes where law (1) would, with friction.

        a = f − k v

    It is no law of the paper. The energy H = ½ Σ‖v‖² + V/2 falls, Ḣ = −k Σ‖v‖², while no limit
    holds it back; V itself may rise. Left alone with a constant f a robot comes to v = f/k.

    Args:
        net_bearing: f, (..., d), m/s, in the robot's own frame; taken in m/s², one per second.
        velocity: v, (..., d), m/s, in the same frame.
        damping: k, 1/s.

    Returns:
        Accelerations, (..., d), m/s².
    """
    f, v, k = net_bearing, velocity, damping
    return f - k * v


# ---- as policies --------------------------------------------------------------------------------


@dataclass(frozen=True)
class LawPolicy(TeamPolicy):
    """A law without memory as a policy; its actions are kept within the scenario's limits."""

    scenario: Scenario
    """Whose robots it steers."""
    law: Callable[[Array, ObservedRows, ArrayLike], Array]
    """Actions (..., n, a) from the net bearing (..., n, d), all that is seen, and the time in s."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``."""
        layout = self.scenario.observation_layout
        seen = layout.split(observations)
        return within_limits(self.law(layout.net_bearing(observations), seen, time), self.scenario)


# Functions of the module with what they need bound to them, not closures: policies are pickled.


def _bearing_only_velocities(
    f: Array, seen: ObservedRows, time: ArrayLike, *, scenario: Scenario
) -> Array:
    velocity = bearing_only_law(f)
    if not scenario.scales_velocity:
        return velocity
    scale: Array = step_scale(degree_of(seen), scenario.merge_radius, scenario.tau)
    return velocity * scale[..., np.newaxis]


@register("bearing-only", fits=is_single_integrator, kind="law")
def _bearing_only(scenario: Scenario) -> Policy:
    """Law (1): along the net bearing, as fast as it is long."""
    return LawPolicy(scenario, partial(_bearing_only_velocities, scenario=scenario))


def _link_keeping_velocities(
    f: Array, seen: ObservedRows, time: ArrayLike, *, merge_radius: float, duration: float
) -> Array:
    point, degree = least_norm_points(seen.neighbours), degree_of(seen)
    return link_keeping_law(point, degree, merge_radius=merge_radius, duration=duration)


@register("link-keeping", fits=is_single_integrator, kind="law", on_request=True)
def _link_keeping(scenario: Scenario) -> Policy:
    """Law (R b): into the middle of all that is seen, so that no link grows longer."""
    law = partial(
        _link_keeping_velocities, merge_radius=scenario.merge_radius, duration=scenario.tau
    )
    return LawPolicy(scenario, law)


# The paper's laws are in continuous time. Held over a step, a turn rate may swing the body past the
# net bearing and back in the next step, for ever; so no turn goes farther than to f (our departure:
# it is felt where ‖f‖τ > 1, and in 3-D near β = ±π/2 too).


def _no_farther(rate: Array, angle: Array, duration: float) -> Array:
    """A turn rate, rad/s, held so long, s, that turns an axis by no more than the angle."""
    most = np.abs(angle) / duration
    return np.clip(rate, -most, most)


def _unicycle_actions(f: Array, seen: ObservedRows, time: ArrayLike, *, duration: float) -> Array:
    actions = unicycle_law(f)
    actions[..., 1] = _no_farther(actions[..., 1], np.arctan2(f[..., 1], f[..., 0]), duration)
    return actions


@register("unicycle", fits=lambda scenario: scenario.robot_model == "unicycle", kind="law")
def _unicycle(scenario: Scenario) -> Policy:
    """Laws (7) and (8) of unicycles: the speed along f, turning towards it."""
    return LawPolicy(scenario, partial(_unicycle_actions, duration=scenario.tau))


def _unicycle_cosine_actions(f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
    return unicycle_cosine_law(f, time)


@register("unicycle-cosine", fits=lambda scenario: scenario.robot_model == "unicycle", kind="law")
def _unicycle_cosine(scenario: Scenario) -> Policy:
    """Law (7) of unicycles that turn to and fro, ω = cos t, whatever they see."""
    return LawPolicy(scenario, _unicycle_cosine_actions)


def _nonholonomic_3d_actions(
    f: Array, seen: ObservedRows, time: ArrayLike, *, duration: float
) -> Array:
    assert seen.gravity is not None  # these robots always sense it
    pitch = pitch_of(seen.gravity)
    actions = nonholonomic_3d_law(f, pitch)
    upright = np.copysign(1.0, np.cos(pitch))
    ahead = np.abs(np.cos(pitch)) * f[..., 0] - upright * np.sin(pitch) * f[..., 2]
    azimuth = np.arctan2(upright * f[..., 1], ahead)
    actions[..., 1] = _no_farther(actions[..., 1], azimuth, duration)
    actions[..., 2] = _no_farther(actions[..., 2], np.arctan2(f[..., 2], f[..., 0]), duration)
    return actions


@register(
    "nonholonomic-3d", fits=lambda scenario: scenario.robot_model == "nonholonomic_3d", kind="law"
)
def _nonholonomic_3d(scenario: Scenario) -> Policy:
    """Laws (12) and (17) of nonholonomic robots in 3-D."""
    return LawPolicy(scenario, partial(_nonholonomic_3d_actions, duration=scenario.tau))


def _damped_accelerations(
    f: Array, seen: ObservedRows, time: ArrayLike, *, damping: float
) -> Array:
    assert seen.velocity is not None  # these robots always sense it
    return damped_law(f, seen.velocity.astype(np.float64), damping=damping)


@register("damped", fits=is_double_integrator, kind="law")
def _damped(scenario: Scenario, damping: float = 1.0) -> Policy:
    """For robots with inertia: where law (1) would go, with friction; not of the paper."""
    law = partial(_damped_accelerations, damping=positive("damping", damping, "1/s"))
    return LawPolicy(scenario, law)
