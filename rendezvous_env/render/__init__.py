"""Rendering; ``renderer`` is the entry point.

``scene``, ``palette``, ``camera`` and ``history`` are independent of pygame-ce and shared with
other renderers.
"""
