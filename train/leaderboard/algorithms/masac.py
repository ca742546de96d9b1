"""Multi-agent soft actor-critic, on choices of an angle as all learners here."""

from ..multi_agent import family

ALGORITHMS = family("masac", "MASAC of BenchMARL")
