"""One team of its own, to play by hand."""

from rendezvous_env import make_vec
from rendezvous_env.vector import GuaranteeWrapper


def alone(scenario, by, **settings):
    """A team at its start under what keeps a guarantee, choices in local frames; its simulator."""
    env = GuaranteeWrapper(make_vec(scenario, num_envs=1), by, **{"frame": "local"} | settings)
    env.reset(seed=0)
    return env, env.unwrapped.simulator
