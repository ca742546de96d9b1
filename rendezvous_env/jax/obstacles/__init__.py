"""Obstacles over arrays: shapes, contact, random fields, and their angular extents."""
