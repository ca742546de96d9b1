"""The largest and smallest numbers that make sense, in one place.

Lengths, times, speeds, rates and weights keep within ``SMALLEST`` and ``LARGEST``: a second spent
at the wildest of them leaves all squares and sums finite in float64, and all that is observed or
done in float32. Whole numbers of steps are exact in float64.
"""

SMALLEST = 1e-9
"""Of what must be positive: m, s, m/s, rad/s."""
LARGEST = 1e9
"""Of any length, time, speed, rate, angle, weight or reward: m, s, m/s, rad/s, rad."""
MOST_STEPS = 10**15
"""Steps of an episode."""
MOST_ROBOTS = 10_000
"""In a team: its graph is a matrix of so many squared."""
MOST_OBSTACLES = 10_000
"""In a scenario, and slots for them in an observation."""
MOST_VERTICES = 1_000
"""Of a polygon."""
MOST_TEAMS = 10**9
"""In a batch; memory ends sooner."""
MOST_HELD_STEPS = 100_000
"""Base steps for which a decision may be held."""
LONGEST_NAME = 255
"""Characters."""
LARGEST_SEED = 2**63 - 1
"""Of any team."""
MOST_DELAY = 10_000
"""Steps by which a sensor may be late: so many observations are kept."""
MOST_SECTORS = 1_000_000
"""Directions to which bearings may be rounded."""
