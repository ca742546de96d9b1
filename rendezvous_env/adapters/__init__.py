"""Bridges to libraries that train policies; each is loaded by whoever imports it."""
