"""Blind and oracle references, which stand below and above every law."""
