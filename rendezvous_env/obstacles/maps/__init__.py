"""Obstacles from maps: occupancy grids of ROS, MovingAI maps, WKT and GeoJSON polygons."""

from .obstacle_map import ObstacleMap as ObstacleMap
from .reading import from_map as from_map
