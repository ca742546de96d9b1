"""How the physics is done for many teams: memory, the step, threads."""
