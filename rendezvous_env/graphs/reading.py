"""Conversion of graphs of other packages: networkx graphs and edge views, matrices, tables.

No package is imported: a value is recognised by its methods.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import floats, is_int, is_sequence, raise_invalid

GIVEN = "a Graph, a name, an (n, n) matrix of weights, a list of edges or a networkx graph"
REMEDY = "graphs.from_edges takes lists of (i, j) or (i, j, weight)"


def is_networkx(value: Any) -> bool:
    """True if a value is a networkx graph, or has the same methods."""
    names = ("is_directed", "nodes", "edges", "adj")
    return all(hasattr(value, name) for name in names) and not isinstance(value, type)


def is_sparse(value: Any) -> bool:
    """True if a value is a sparse matrix or array of SciPy."""
    return hasattr(value, "tocsr") and hasattr(value, "dtype")


def networkx_edges(graph: Any) -> list[tuple[int, int, float]]:
    """Edges (i, j, a_ij) of a networkx graph, m/s, from the attribute "weight", by default 1.

    Nodes 0 to n − 1 are the robots of these indices; other nodes are numbered in the order of
    ``graph.nodes``, as in ``networkx.to_numpy_array``.
    """
    nodes = list(graph.nodes)
    own = all(is_int(node) for node in nodes) and set(nodes) == set(range(len(nodes)))
    index = {node: node if own else k for k, node in enumerate(nodes)}
    links = graph.edges(data=True)
    return [(int(index[i]), int(index[j]), weight_of(about)) for i, j, about in links]


def weight_of(given: Any) -> Any:
    """Weight of an edge from its third entry: a number, networkx attributes, or None for 1."""
    if isinstance(given, dict):
        given = given.get("weight")
    return 1.0 if given is None else given


def is_edge_view(value: Any) -> bool:
    """True if a value is an edge view of a networkx graph."""
    made = type(value)
    return made.__module__.partition(".")[0] == "networkx" and "Edge" in made.__name__


def is_directed_view(value: Any) -> bool:
    """True if a value is an edge view of a directed networkx graph."""
    return is_edge_view(value) and type(value).__name__.startswith(("Out", "In"))


def is_plain(value: Any) -> bool:
    """True if a value is a mapping of plain data, as opposed to edge views and sparse matrices."""
    return isinstance(value, Mapping) and not (is_edge_view(value) or is_sparse(value))


def rows_of(edges: Iterable[Any]) -> list[Any]:
    """Rows of an edge list; an edge view has keys of parallel edges, unless it is called."""
    return list(edges() if is_edge_view(edges) and callable(edges) else edges)


def edge_rows(value: Any) -> list[Any] | None:
    """Rows of a possible edge list, each of two or three entries; None for a matrix."""
    if is_sparse(value) or isinstance(value, str | bytes):
        return None
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        rows = array.tolist() if array.ndim == 2 and array.shape[1] in (2, 3) else []
    else:
        rows = rows_of(value) if isinstance(value, Iterable) else []
    short = all(is_sequence(row) and len(row) in (2, 3) for row in rows)
    return rows if rows and short else None


def is_square(value: Any) -> bool:
    """True if a value is a table with as many columns as rows."""
    if hasattr(value, "shape"):
        return len(value.shape) == 2 and value.shape[0] == value.shape[1]
    rows = value if is_sequence(value) else ()
    return bool(rows) and all(is_sequence(row) and len(row) == len(rows) for row in rows)


def as_matrix(field: str, value: Any) -> Any:
    """Weights as an array of numbers, or as a CSR matrix of SciPy, row by row."""
    if not is_sparse(value):
        return floats(field, value)
    if value.dtype.kind not in "fiub":
        raise_invalid(field, value, "a matrix of real numbers")
    matrix = value.tocsr(copy=True).astype(np.float64)
    matrix.sum_duplicates()
    return matrix


def as_dense(field: str, value: Any) -> NDArray[np.float64]:
    """Weights as an array: of numbers, of a sparse matrix, or of a networkx graph."""
    if is_networkx(value):
        dense = np.zeros((len(value), len(value)))
        for i, j, weight in networkx_edges(value):
            dense[i, j] = weight
            if not value.is_directed():
                dense[j, i] = weight
        return dense
    matrix = as_matrix(field, value)
    return matrix.toarray() if is_sparse(matrix) else matrix
