"""Several threads that do the blocks of one kernel call."""
