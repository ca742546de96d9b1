"""Everything that learns or compares: commands, evaluation, the bridge to stable-baselines3."""
