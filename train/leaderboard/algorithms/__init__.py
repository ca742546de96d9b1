"""A file for each algorithm; ``registry.Algorithm`` says what it must have."""
