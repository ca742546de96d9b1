"""Trained policies: what they perceive, choose and weigh, in NumPy; the shipped ones by name."""

from . import shipped

__all__ = ["shipped"]
