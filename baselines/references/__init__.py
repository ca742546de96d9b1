"""Blind and oracle baselines, which stand below and above every law."""
