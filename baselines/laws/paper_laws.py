"""The laws of the paper, with its equation numbers."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, positive, shown
from rendezvous_env.safety.heading import step_scale
from rendezvous_env.safety.links import least_norm_points, link_keeping_law
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
    """D_i = Σ_j a_ij, the summed lengths of the neighbour rows, (...), m/s."""
    return np.asarray(np.linalg.norm(seen.neighbours, axis=-1).sum(-1, np.float64))


def pitch_of(gravity: NDArray[Any]) -> Array:
    """β, (...), rad, of gravity in the body frame, (−sin β, 0, −cos β), (..., 3); 0 for zeros."""
    pitch: Array = np.arctan2(-gravity[..., 0], -gravity[..., 2], dtype=np.float64)
    return np.where(np.any(gravity, axis=-1), pitch, 0.0)


def bearing_only_law(net_bearing: Array) -> Array:
    """The bearing-only law: ṗᵢ = fᵢ, (..., d), m/s, in the robot's own frame (eq. 1)."""
    return net_bearing


def unicycle_law(net_bearing: Array) -> Array:
    """Speed and turn rate of the unicycle law, (..., 2), m/s and rad/s, of f, (..., 2), m/s.

        v = hᵀf,   ω = (h^⊥)ᵀf,   h = (cos θ, sin θ)                  (eqs. 7, 8)

    f is in the body frame, where h is the x axis and h^⊥ the y axis.
    """
    v, omega = net_bearing[..., 0], net_bearing[..., 1]
    return np.stack([v, omega], axis=-1)


def unicycle_cosine_law(net_bearing: Array, time: ArrayLike) -> Array:
    """Speed and turn rate, (..., n, 2), of a unicycle that turns to and fro whatever it sees.

        v = hᵀf,   ω = cos t                                        (eq. 7 and the remark after it)

    Of f, (..., n, 2), m/s, in the body frame, and t, (...) for each team, s; a ValueError if that
    is not one finite number, or one for each team.
    """
    v, t = net_bearing[..., 0], floats("time", time)[..., np.newaxis]
    if t.shape[:-1] not in ((), v.shape[:-1]) or not np.isfinite(t).all():
        raise ValueError(
            f"time is {shown(time)}; it must be one finite number, or {v.shape[:-1]} of them (s)"
        )
    return np.stack([v, np.broadcast_to(np.cos(t), v.shape)], axis=-1)


def nonholonomic_3d_law(net_bearing: Array, pitch: Array) -> Array:
    """Speed, yaw and pitch rate, (..., 3), m/s and rad/s, of f, (..., 3), m/s, and β, (...), rad.

        v = hᵀf,   (α̇, β̇) = (AᵀA)⁻¹ Aᵀ P_h f                         (eqs. 12, 17)

    In the body frame (x = h, y = horizontal left, z = up-ish) this is v = f_x, α̇ = f_y/cos β,
    β̇ = f_z. At β = ±π/2 it is singular, of which the paper says nothing: here α̇ grows until it is
    saturated at the action bound, and it is 0 where f_y = 0.
    """
    f_x, f_y, f_z = np.moveaxis(net_bearing, -1, 0)
    return np.stack([f_x, yaw_rate_law(f_y, pitch), f_z], axis=-1)


def damped_law(net_bearing: Array, velocity: Array, *, damping: float) -> Array:
    """Accelerations, (..., d), m/s², of robots with inertia that go where law (1) would.

        a = f − k v

    Not a law of the paper. The energy H = ½ Σ‖v‖² + V/2 falls, Ḣ = −k Σ‖v‖², while no limit
    applies; V itself may rise. Under a constant f a robot tends to v = f/k.

    Of f and v, (..., d), m/s, in one frame, f taken in m/s², one per second, and k, 1/s.
    """
    f, v, k = net_bearing, velocity, damping
    return f - k * v


@dataclass(frozen=True)
class Law(TeamPolicy):
    """A law without memory; its actions are kept within the scenario's limits."""

    scenario: Scenario

    @abstractmethod
    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        """Actions (..., n, a) from f, (..., n, d), m/s, all that is seen, and the time in s."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        return within_limits(self.actions(f, seen, time), self.scenario)

    def slowed(self, velocity: Array, seen: ObservedRows) -> Array:
        """Velocities (..., n, d), m/s, slowed down where the default step is long (theory 4)."""
        if not self.scenario.scales_velocity:
            return velocity
        scale = step_scale(degree_of(seen), self.scenario.merge_radius, self.scenario.tau)
        return np.asarray(velocity * scale[..., np.newaxis])


@dataclass(frozen=True)
class LawPolicy(Law):
    """A function as a law."""

    law: Callable[[Array, ObservedRows, ArrayLike], Array]
    """Arguments and result as of ``Law.actions``."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        """What the function gives."""
        return self.law(f, seen, time)


@register("bearing-only", fits=is_single_integrator, kind="law")
class _BearingOnly(Law):
    """Law (1): along the net bearing, as fast as it is long."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return self.slowed(bearing_only_law(f), seen)


@register("link-keeping", fits=is_single_integrator, kind="law")
class _LinkKeeping(Law):
    """Law (R b): into the middle of all that is seen, so that no link in sight grows longer."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "links", "share": 1.0}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        step = {"merge_radius": self.scenario.merge_radius, "duration": self.scenario.tau}
        return link_keeping_law(least_norm_points(seen.neighbours), degree_of(seen), **step)


# The paper's laws are in continuous time. Held over a step, a turn rate may swing the body past the
# net bearing and back in the next step, for ever; so no turn goes farther than to f (our departure:
# it is felt where ‖f‖τ > 1, and in 3-D near β = ±π/2 too).


def _no_farther(rate: Array, angle: Array, duration: float) -> Array:
    """A turn rate, rad/s, that turns an axis by no more than the angle within the duration."""
    most = np.abs(angle) / duration
    return np.clip(rate, -most, most)


is_unicycle = of_model("unicycle")
"""Whether actions are a speed and a turn rate in the plane."""


@register("unicycle", fits=is_unicycle, kind="law")
class _Unicycle(Law):
    """Laws (7) and (8) of unicycles: the speed along f, turning towards it."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        actions, angle = unicycle_law(f), np.arctan2(f[..., 1], f[..., 0])
        actions[..., 1] = _no_farther(actions[..., 1], angle, self.scenario.tau)
        return actions


@register("unicycle-cosine", fits=is_unicycle, kind="law")
class _UnicycleCosine(Law):
    """Law (7) of unicycles that turn to and fro, ω = cos t, whatever they see."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return unicycle_cosine_law(f, time)


@register("nonholonomic-3d", fits=of_model("nonholonomic_3d"), kind="law")
class _Nonholonomic3D(Law):
    """Laws (12) and (17) of nonholonomic robots in 3-D."""

    @property
    def guarantee(self) -> dict[str, Any]:
        """As ``TeamPolicy``."""
        return {"by": "law"}

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        assert seen.gravity is not None  # these robots always sense it
        pitch = pitch_of(seen.gravity)
        actions = nonholonomic_3d_law(f, pitch)
        upright = np.copysign(1.0, np.cos(pitch))
        ahead = np.abs(np.cos(pitch)) * f[..., 0] - upright * np.sin(pitch) * f[..., 2]
        azimuth, rise = np.arctan2(upright * f[..., 1], ahead), np.arctan2(f[..., 2], f[..., 0])
        actions[..., 1] = _no_farther(actions[..., 1], azimuth, self.scenario.tau)
        actions[..., 2] = _no_farther(actions[..., 2], rise, self.scenario.tau)
        return actions


@register("damped", fits=is_double_integrator, kind="law")
@dataclass(frozen=True)
class _Damped(Law):
    """For robots with inertia: where law (1) would go, with friction; not of the paper."""

    damping: float = 1.0  # k, 1/s

    def __post_init__(self) -> None:
        positive("damping", self.damping, "1/s")

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        assert seen.velocity is not None  # these robots always sense it
        return damped_law(f, seen.velocity.astype(np.float64), damping=self.damping)
