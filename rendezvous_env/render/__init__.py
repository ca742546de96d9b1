"""How a picture is made; ``rendering.py`` is its door. Only ``camera`` and ``history`` load without
pygame-ce.
"""
