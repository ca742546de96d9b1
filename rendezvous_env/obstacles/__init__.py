"""Obstacles: shapes, their geometry, and random obstacle and wall fields."""
