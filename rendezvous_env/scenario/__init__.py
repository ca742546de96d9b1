"""Experiments: scenarios, named scenarios, files, observation layout and reset options."""
