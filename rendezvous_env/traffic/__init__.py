"""Obstacles that move: motion over a step, and contact in relative motion."""
