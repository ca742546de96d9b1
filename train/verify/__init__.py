"""The theorems as a command: claims, cases, adversaries."""
