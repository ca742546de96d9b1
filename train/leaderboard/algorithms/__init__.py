"""Every file has an algorithm, or a table of several; see ``registry.Algorithm``."""
