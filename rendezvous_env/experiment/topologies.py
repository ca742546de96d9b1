"""How an episode chooses its edges: numbers that compiled code knows, too."""

FIXED, RANDOM_TREE, ERDOS_RENYI, DIRECTED, SWITCHING, PROXIMITY = range(6)
"""The same edges in every episode; a family drawn anew for each; fixed arcs; a list of graphs that
take turns; links that follow who sees whom."""
