#!/usr/bin/env bash
# ONNX Runtime's ReduceMax and ReduceMin drop a NaN unless it comes first; its Max and Min keep it.
#
# Versions: onnxruntime 1.32.0, onnx 1.23.2, numpy 2.4.6, Python 3.11, CPU provider.
# Input: float32 [1, nan, 3] and [nan, 1, 3] into ReduceMax, ReduceMin and pairwise Max; opset 21.
# Guess: nan in each case, as NumPy and the ONNX reference evaluator give.
# Seen: ReduceMax [1, nan, 3] = 3, ReduceMin = 1; nan for [nan, 1, 3] and for Max. So in
#   policies that pool over neighbours, the order of neighbours decides if a faulty bearing shows.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import onnxruntime
from onnx import TensorProto, checker, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

zero = numpy_helper.from_array(np.zeros(3, np.float32), "zero")


def run(operator, values):
    """Outputs of ONNX Runtime and of the reference evaluator."""
    pools = operator.startswith("Reduce")
    inputs, options = (["x"], {"keepdims": 0}) if pools else (["x", "zero"], {})
    graph = helper.make_graph(
        [helper.make_node(operator, inputs, ["y"], **options)],
        operator,
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [3])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [] if pools else [3])],
        [] if pools else [zero],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 21)], ir_version=10)
    checker.check_model(model)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    feed = {"x": np.array(values, np.float32)}
    return [np.asarray(runner.run(None, feed)[0]).tolist() for runner in (session, ReferenceEvaluator(model))]


nan = float("nan")
results = {(op, *x): run(op, x) for op in ("ReduceMax", "ReduceMin", "Max") for x in ([1, nan, 3], [nan, 1, 3])}
for (operator, *values), (runtime, reference) in results.items():
    print(operator, values, "onnxruntime", runtime, "reference", reference)
assert results["ReduceMax", 1, nan, 3][0] == 3.0 and results["ReduceMin", 1, nan, 3][0] == 1.0, "nan is kept now"
assert np.isnan(results["ReduceMax", nan, 1, 3][0]) and np.isnan(results["ReduceMin", nan, 1, 3][0])
assert np.isnan(results["Max", 1, nan, 3][0][1]) and np.isnan(results["Max", nan, 1, 3][0][0])
assert all(np.isnan(reference).any() for _, reference in results.values())
PYTHON
