"""Stages of a step, over the lanes of a block."""
