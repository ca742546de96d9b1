"""Enter the environments into the registries of PettingZoo and Gymnasium."""

from __future__ import annotations


def register() -> None:
    """Register ``rendezvous/rendezvous-v0`` in PettingZoo, once."""
    from pettingzoo.env_registry import registration

    name, module = "rendezvous/rendezvous-v0", "rendezvous_env.rendezvous_v0"
    if name not in registration.parallel_registry:
        registration.register("parallel", name, entry_point=f"{module}:parallel_env")
    if name not in registration.aec_registry:
        registration.register("aec", name, entry_point=f"{module}:env")
