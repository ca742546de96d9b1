"""Robot models: the protocol and one module per model."""

from . import double_integrator, nonholonomic_3d, single_integrator, unicycle

__all__ = ["double_integrator", "nonholonomic_3d", "single_integrator", "unicycle"]
