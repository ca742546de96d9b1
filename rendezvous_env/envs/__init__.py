"""What the environments of PettingZoo and Gymnasium share, and their wrappers."""
