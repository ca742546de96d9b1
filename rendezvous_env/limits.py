"""Numeric limits of all fields.

Lengths, times, speeds, rates and weights are between ``SMALLEST`` and ``LARGEST``. A second at the
extreme values then keeps all squares and sums finite in float64, and all observations and actions
finite in float32. Integer step counts are exact in float64.
"""

SMALLEST = 1e-9  # of positive quantities: m, s, m/s, rad/s
LARGEST = 1e9  # of any length, time, speed, rate, angle, weight or reward
MAX_STEPS = 10**15  # per episode
MAX_ROBOTS = 10_000  # per environment; a dense graph has its square as entries
MAX_OBSTACLES = 10_000  # per scenario, and slots in an observation
MAX_VERTICES = 1_000  # per polygon
MAX_TEAMS = 10**9  # environments per batch; memory is exhausted earlier
MAX_HELD_STEPS = 100_000  # base steps per agent step
LONGEST_NAME = 255  # characters
LARGEST_SEED = 2**63 - 1  # of any environment
MAX_DELAY = 10_000  # sensor delay in steps; as many observations are stored
MAX_SECTORS = 1_000_000  # sectors of quantised bearings
