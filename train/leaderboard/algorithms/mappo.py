"""Multi-agent PPO (Yu et al. 2022): a critic sees what all robots see."""

from ..multi_agent import family

ALGORITHMS = family("mappo", "MAPPO of BenchMARL", lmbda=0.95, entropy_coef=0.003)
