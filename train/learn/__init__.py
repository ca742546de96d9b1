"""PPO that learns headings: settings, training, its log and its state."""
