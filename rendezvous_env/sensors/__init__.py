"""Sensors: exact bearings and imperfections, applied in order."""
