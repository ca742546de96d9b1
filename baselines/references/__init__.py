"""Blind and oracle baselines: lower and upper references for every law."""
