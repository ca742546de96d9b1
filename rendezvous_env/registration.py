"""Enter the environments into the registries of PettingZoo and Gymnasium."""

from __future__ import annotations


def register() -> None:
    """Register ``rendezvous/rendezvous-v0`` in PettingZoo, and in Gymnasium
    ``rendezvous/Rendezvous-v0`` and, with certified headings, ``rendezvous/RendezvousHeading-v0``,
    once; time is ours, so without ``max_episode_steps``.
    """
    import gymnasium

    _register_in_pettingzoo()
    module = "rendezvous_env.gymnasium_env"
    for name, one, many in (
        ("rendezvous/Rendezvous-v0", "make_env", "make_vec"),
        ("rendezvous/RendezvousHeading-v0", "make_heading_env", "make_heading_vec"),
    ):
        if name not in gymnasium.registry:
            gymnasium.register(
                name, entry_point=f"{module}:{one}", vector_entry_point=f"{module}:{many}"
            )


def _register_in_pettingzoo() -> None:
    try:
        from pettingzoo.env_registry import registration
    except ImportError:  # PettingZoo before 1.27 has no registry
        return
    name, module = "rendezvous/rendezvous-v0", "rendezvous_env.rendezvous_v0"
    if name not in registration.parallel_registry:
        registration.register("parallel", name, entry_point=f"{module}:parallel_env")
    if name not in registration.aec_registry:
        registration.register("aec", name, entry_point=f"{module}:env")
