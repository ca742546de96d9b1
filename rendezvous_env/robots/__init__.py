"""The protocol of a robot model, and one file for each."""

from . import double_integrator, nonholonomic_3d, single_integrator, unicycle

__all__ = ["double_integrator", "nonholonomic_3d", "single_integrator", "unicycle"]
