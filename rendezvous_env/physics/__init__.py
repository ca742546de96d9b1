"""Pure functions of the physics, independent of batches, lanes and threads."""
