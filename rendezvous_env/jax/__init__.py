"""The environment as pure functions of JAX: ``jit``, ``vmap``, ``grad``, on CPU and accelerators.

    env = rendezvous_env.jax.make("cloud-8", num_envs=4096)
    obs, state = env.reset(0)
    obs, state, reward, terminated, truncated, info = env.step(None, state, actions)

An integer seed repeats the experiment of ``rendezvous_env.make_vec``: the same initial conditions,
motion, merges, observations, rewards and ends. ``make`` raises NotImplementedError for fields that
are not covered, and names them.
"""

try:
    import jax as _jax  # noqa: F401
except ImportError as error:
    raise ImportError("rendezvous_env.jax needs JAX: pip install 'rendezvous-env[jax]'") from error

from .environment import RendezvousJaxEnv, State, make
from .laws import bearing_only_law, flexible_velocity, net_bearing
from .sharding import shard

__all__ = [
    "RendezvousJaxEnv", "State", "bearing_only_law", "flexible_velocity", "make", "net_bearing",
    "shard",
]  # fmt: skip
