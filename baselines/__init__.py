"""Scripted policies: observations in, actions out, never a position."""

from . import laws, obstacle_avoidance
from .policy import Policy, make, names

__all__ = ["Policy", "laws", "make", "names", "obstacle_avoidance"]
