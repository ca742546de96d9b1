"""Obstacles: where they are, what is seen of them, when a moving point comes to them."""
