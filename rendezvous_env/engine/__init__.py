"""Physics of a batch of environments: memory, stages of a step, threads."""
