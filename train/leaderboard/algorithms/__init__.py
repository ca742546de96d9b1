"""One module per algorithm or family of algorithms; see ``registry.Algorithm``."""
