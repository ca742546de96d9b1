"""Obstacles that move: description, motion over a step, and contact in relative motion."""
