"""Learned policies in NumPy: features, network, base controller and shipped weights."""

from . import shipped

__all__ = ["shipped"]
