"""Obstacles: what a user sets, their geometry, fields and walls that are drawn for each episode."""
