"""Numeric limits of all fields.

Lengths, times, speeds, rates and weights are between ``SMALLEST`` and ``LARGEST``. A second at the
extreme values then keeps all squares and sums finite in float64, and all observations and actions
finite in float32. Integer step counts are exact in float64.
"""

SMALLEST = 1e-9  # of what must be positive: m, s, m/s, rad/s
LARGEST = 1e9  # of any length, time, speed, rate, angle, weight or reward
MOST_STEPS = 10**15  # of an episode
MOST_ROBOTS = 10_000  # in a team: its graph is a matrix of so many squared
MOST_OBSTACLES = 10_000  # in a scenario, and slots for them in an observation
MOST_VERTICES = 1_000  # of a polygon
MOST_TEAMS = 10**9  # in a batch; memory ends sooner
MOST_HELD_STEPS = 100_000  # base steps for which a decision may be held
LONGEST_NAME = 255  # characters
LARGEST_SEED = 2**63 - 1  # of any team
MOST_DELAY = 10_000  # steps by which a sensor may be late: so many observations are kept
MOST_SECTORS = 1_000_000  # directions to which bearings may be rounded
