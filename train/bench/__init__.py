"""Benchmarks of speed, reported as ratios."""
