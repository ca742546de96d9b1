"""Falsification of theorems and certificates: claims, random scenarios, adversaries."""
