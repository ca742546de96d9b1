"""Analytic rules of obstacle avoidance."""
