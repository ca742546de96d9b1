"""Independent PPO (de Witt et al. 2020): a critic sees what its robot sees."""

from ..multi_agent import family

ALGORITHMS = family("ippo", "IPPO of BenchMARL", lmbda=0.95, entropy_coef=0.003)
