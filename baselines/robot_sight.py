"""Former module of ``ObservationBuilder``, which is in ``observation_builder``."""

from typing import Any

from rendezvous_env.deprecation import warn_renamed

from . import observation_builder


def __getattr__(name: str) -> Any:
    """Names of ``observation_builder``, with a warning."""
    new = "ObservationBuilder" if name == "RobotSight" else name
    if new.startswith("_") or not hasattr(observation_builder, new):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_renamed(f"{__name__}.{name}", f"baselines.observation_builder.{new}")
    return getattr(observation_builder, new)
