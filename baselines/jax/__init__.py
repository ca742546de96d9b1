"""Policies as pure JAX functions, from the equations of ``baselines``.

    policy = baselines.jax.make("tangent-merged-tuned", "clutter-8")
    memory = policy.begin((num_envs,))
    actions, memory = policy.act(observations, memory)

``names`` lists the policies that have a JAX form.
"""

try:
    import jax as _jax  # noqa: F401
except ImportError as error:
    raise ImportError("policies in JAX need it: pip install 'rendezvous-env[jax]'") from error

from . import laws, learned, rules
from .policy import JaxPolicy, make, names

__all__ = ["JaxPolicy", "laws", "learned", "make", "names", "rules"]
