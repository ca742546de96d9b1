"""Sensing graphs: undirected or directed, fixed, random per episode, or time-varying."""

from .directed import directed as directed
from .directed import directed_cycle as directed_cycle
from .fixed import complete as complete
from .fixed import cycle as cycle
from .fixed import from_edges as from_edges
from .fixed import from_matrix as from_matrix
from .fixed import path as path
from .fixed import star as star
from .graph import Graph as Graph
from .graph import GraphLike as GraphLike
from .graph import parse as parse
from .proximity import proximity as proximity
from .random_graphs import erdos_renyi as erdos_renyi
from .random_graphs import family as family
from .random_graphs import random_tree as random_tree
from .switching import switching as switching
from .weights import bottleneck_weight as bottleneck_weight
from .weights import components as components
