#!/usr/bin/env bash
# networkx.algebraic_connectivity(method="lanczos") returns a larger eigenvalue for paths and cycles.
#
# Versions: networkx 3.6.1, scipy 1.17.1, numpy 2.4.6, Python 3.11.
# Input: cycle of 60 nodes, ladder of 32 rungs, path of 80 nodes; connected, unit weights; seed 0.
# Guess: every method agrees with numpy.linalg.eigvalsh to 1e-5, as the default method does.
# Seen: lanczos gives 4.0 times the second eigenvalue without a warning: in 100 of 100 calls for cycle
#   and ladder, in most calls for the path, although the seed is one. ARPACK reports convergence at
#   tol=1e-8, but it has skipped an eigenvalue. So consensus rates computed with lanczos are up to
#   four times too fast on sparse graphs.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet networkx==3.6.1 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" -W error - <<'PYTHON'
import networkx as nx
import numpy as np

CALLS = 20
for name, graph in {"cycle": nx.cycle_graph(60), "ladder": nx.ladder_graph(32), "path": nx.path_graph(80)}.items():
    exact = np.linalg.eigvalsh(nx.laplacian_matrix(graph).toarray().astype(float))[1]
    default = nx.algebraic_connectivity(graph, seed=0) / exact
    ratios = [nx.algebraic_connectivity(graph, method="lanczos", seed=0) / exact for _ in range(CALLS)]
    wrong = sum(ratio > 1.001 for ratio in ratios)
    print(f"{name}: default {default:.6f}, lanczos up to {max(ratios):.3f}, wrong in {wrong} of {CALLS} calls")
    assert abs(default - 1) < 1e-5
    assert max(ratios) > 3.9, "lanczos finds the second eigenvalue now"
PYTHON
