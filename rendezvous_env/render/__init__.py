"""How a picture is made; ``renderer`` is the entry point, and what other renderers share lies in
``scene`` and ``palette``. Without pygame-ce load these, ``camera`` and ``history``.
"""
