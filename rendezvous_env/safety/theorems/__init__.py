"""Theorems: assumptions, bounds and certificates."""
