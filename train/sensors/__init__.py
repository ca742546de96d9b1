"""Sensor models from logs of real robots: readers, reports, and replay of policies."""
