"""Theorems: assumptions, bounds, certificates."""
