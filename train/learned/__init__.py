"""A trained policy: what it perceives, chooses and weighs, and its checkpoint."""
