"""Three robot models: one exact step each, with the inputs held.

Angles are in radians, yaw α about the vertical, pitch β above the horizontal. In 2-D the pitch is 0
and the yaw is the heading θ of the unicycle.
"""

import math
from dataclasses import dataclass

from ..compilation import kernel


@dataclass(frozen=True)
class RobotModel:
    """What a robot model needs to know about itself."""

    name: str
    dims: tuple[int, ...]
    """Dimensions of space it exists in."""
    n_angles: int
    """Angles that make up its attitude; 0 for a single integrator, whose frame is fixed."""

    def action_size(self, dim: int) -> int:
        """Numbers in an action: a velocity, or (v, ω), or (v, ω_α, ω_β)."""
        return 1 + self.n_angles if self.n_angles else dim

    @property
    def nonholonomic(self) -> bool:
        """Whether the robot can only move along its body axis."""
        return self.n_angles > 0

    @property
    def senses_gravity(self) -> bool:
        """Whether the observation has a gravity row: law (17) needs the pitch."""
        return self.n_angles == 2


ROBOT_MODELS = {
    model.name: model
    for model in (
        RobotModel("single_integrator", dims=(2, 3), n_angles=0),
        RobotModel("unicycle", dims=(2,), n_angles=1),
        RobotModel("nonholonomic_3d", dims=(3,), n_angles=2),
    )
}


@kernel
def mean_cos_sin(angle, swept):
    """Means of cos and sin over an angle that grows evenly from ``angle`` by ``swept``, both rad.

    With S = sin(x)/x and C = (1 − cos x)/x they are (S cos a − C sin a, S sin a + C cos a); C is
    written as sin²(x/2)/(x/2), which loses no digits as x → 0.
    """
    half = 0.5 * swept
    if abs(half) < 1e-8:
        mean_sin, mean_cos = half, 1.0
    else:
        sin_half = math.sin(half)
        mean_sin = sin_half * sin_half / half
        mean_cos = sin_half * math.cos(half) / half
    c, s = math.cos(angle), math.sin(angle)
    return mean_cos * c - mean_sin * s, mean_cos * s + mean_sin * c


@kernel
def arc_displacement(speed, yaw, pitch, yaw_rate, pitch_rate, duration, out):
    """Exact displacement of a nonholonomic robot over a step with held inputs.

        ẋ = v cos β cos α,  ẏ = v cos β sin α,  ż = v sin β,  α̇ = ω_α,  β̇ = ω_β     (eq. 9)

    In 2-D (β = 0) this is the circular arc of the unicycle (eq. 5). The products of cosines are
    written as sums of cosines of α + β and α − β, each of which grows evenly.

    Args:
        speed: v, m/s.
        yaw: α at the start, rad.
        pitch: β at the start, rad; 0 in 2-D.
        yaw_rate: ω_α, rad/s.
        pitch_rate: ω_β, rad/s; 0 in 2-D.
        duration: of the step, s.
        out: (d,) array for the displacement, m.
    """
    distance = speed * duration
    if out.shape[0] == 2:
        mean_cos, mean_sin = mean_cos_sin(yaw, yaw_rate * duration)
        out[0] = distance * mean_cos
        out[1] = distance * mean_sin
        return
    cos_sum, sin_sum = mean_cos_sin(yaw + pitch, (yaw_rate + pitch_rate) * duration)
    cos_difference, sin_difference = mean_cos_sin(yaw - pitch, (yaw_rate - pitch_rate) * duration)
    _, mean_sin_pitch = mean_cos_sin(pitch, pitch_rate * duration)
    out[0] = distance * 0.5 * (cos_sum + cos_difference)
    out[1] = distance * 0.5 * (sin_sum + sin_difference)
    out[2] = distance * mean_sin_pitch


@kernel
def body_frame(yaw, pitch, out):
    """Rotation from the body frame to the global frame, (d, d): x = h, y = left, z = up-ish."""
    ca, sa = math.cos(yaw), math.sin(yaw)
    if out.shape[0] == 2:
        out[0, 0], out[0, 1], out[1, 0], out[1, 1] = ca, -sa, sa, ca
        return
    cb, sb = math.cos(pitch), math.sin(pitch)
    out[0, 0], out[0, 1], out[0, 2] = cb * ca, -sa, -sb * ca
    out[1, 0], out[1, 1], out[1, 2] = cb * sa, ca, -sb * sa
    out[2, 0], out[2, 1], out[2, 2] = sb, 0.0, cb
