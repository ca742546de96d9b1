"""Policies on the same starts: episodes, statistics, tables."""
