"""Moving obstacles: motion over a step, and contact in relative motion."""
