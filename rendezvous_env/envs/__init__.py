"""Environments for PettingZoo and Gymnasium, and their wrappers."""
