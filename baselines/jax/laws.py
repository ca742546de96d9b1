"""Laws of Zhao & Zheng (2017) over arrays, from the equations of ``baselines.laws``."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.jax.laws import bearing_only_law, flexible_velocity

from ..laws import paper_laws
from .arrays import Array, angle_of
from .policy import (
    JaxPolicy,
    Memory,
    Rows,
    degree_of,
    register,
    scale_of,
    sum_of,
    within_limits,
)

__all__ = ["bearing_only_law", "flexible_velocity", "nonholonomic_3d_law", "unicycle_law"]

unicycle_law = array_form(paper_laws.unicycle_law)
"""Speed and turn rate of eqs. (7) and (8), (..., 2), of f, (..., 2), in the body frame."""
nonholonomic_3d_law = array_form(paper_laws.nonholonomic_3d_law)
"""Speed, yaw and pitch rate of eqs. (12) and (17), (..., 3), of f, (..., 3), and β, (...)."""
_unicycle_inputs = array_form(paper_laws.unicycle_inputs)
_nonholonomic_3d_inputs = array_form(paper_laws.nonholonomic_3d_inputs)
_damped_law = array_form(paper_laws.damped_law)


@dataclass(frozen=True)
class JaxLaw(JaxPolicy):
    """Memoryless law by its name in ``baselines.names``."""

    name: str
    damping: float = 1.0
    """k of the damped law, 1/s."""

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen = self.rows_of(observations)
        actions = self._actions(sum_of(seen), seen, time)
        return within_limits(actions, self.scenario), memory

    def _actions(self, f: Array, seen: Rows, time: Any) -> Array:
        tau = self.scenario.tau
        if self.name == "unicycle":
            return _unicycle_inputs(f, tau)
        if self.name == "unicycle-cosine":
            rate = jnp.cos(jnp.asarray(time, f.dtype))[..., None]
            return jnp.stack([f[..., 0], jnp.broadcast_to(rate, f.shape[:-1])], axis=-1)
        if self.name == "nonholonomic-3d":
            assert seen.gravity is not None  # these robots always sense it
            pitch = angle_of(-seen.gravity[..., 0], -seen.gravity[..., 2])
            return _nonholonomic_3d_inputs(f, pitch, tau)
        if self.name == "damped":
            return _damped_law(f, seen.velocity, damping=self.damping)
        if not self.scenario.scales_velocity:
            return bearing_only_law(f)
        return bearing_only_law(f) * scale_of(degree_of(seen), self.scenario)[..., None]


def _register(name: str) -> None:
    register(name)(
        lambda law: JaxLaw(law.scenario, name, getattr(law, "damping", 1.0)),
    )


for _name in ("bearing-only", "unicycle", "unicycle-cosine", "nonholonomic-3d", "damped"):
    _register(_name)
