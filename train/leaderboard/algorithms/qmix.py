"""QMIX (Rashid et al. 2018): a team's value is a monotonic function of its robots' values."""

from ..multi_agent import family

ALGORITHMS = family("qmix", "QMIX of BenchMARL")
