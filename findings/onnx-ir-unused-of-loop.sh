#!/usr/bin/env bash
# onnx-ir 1.1.0: what only the body of a removed Loop read remains in the graph.
#
# Guess: RemoveUnusedNodesPass removes a Loop whose result is unused, and then the nodes and initializers that
# nothing reads any more, also those that were read within the Loop's body; at the latest when it runs again.
# Seen: the Loop and its own inputs go, but a Mul and an initializer that the body read from the outer graph
# stay, and a second and third run change nothing. ONNX Runtime computes such nodes and warns of the initializers.
# For a user: count what graphs within nodes read when removing; navrl's export does (navrl/export/passes.py).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q onnx==1.23.2 onnx-ir==1.1.0
cat > "$folder/unused.py" <<'PY'
import numpy as np
import onnx
import onnx_ir
from onnx import TensorProto, helper, numpy_helper
from onnx_ir.passes.common import RemoveUnusedNodesPass


def scalar(name, kind):
    return helper.make_tensor_value_info(name, kind, [])


REAL, FLAG = TensorProto.FLOAT, TensorProto.BOOL
body = helper.make_graph(
    [
        helper.make_node("Add", ["sum", "step"], ["next"]),  # step is of the outer graph
        helper.make_node("Identity", ["condition"], ["again"]),
    ],
    "body",
    [scalar("turn", TensorProto.INT64), scalar("condition", FLAG), scalar("sum", REAL)],
    [scalar("again", FLAG), scalar("next", REAL)],
)
values = {"two": np.float32(2), "turns": np.int64(3), "start": np.array(True), "zero": np.float32(0)}
graph = helper.make_graph(
    [
        helper.make_node("Mul", ["x", "two"], ["step"]),
        helper.make_node("Loop", ["turns", "start", "zero"], ["unused"], body=body),
        helper.make_node("Neg", ["x"], ["y"]),
    ],
    "graph",
    [scalar("x", REAL)],
    [scalar("y", REAL)],
    [numpy_helper.from_array(value, name) for name, value in values.items()],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
onnx.checker.check_model(model)
model = onnx_ir.from_proto(model)
for run in range(3):
    changed = RemoveUnusedNodesPass()(model).modified
    left = [node.op_type for node in model.graph], sorted(model.graph.initializers)
    print(f"run {run}: changed {changed}, nodes {left[0]}, initializers {left[1]}")
    assert changed == (run == 0) and left == (["Mul", "Neg"], ["two"])
PY
"$folder/venv/bin/python" "$folder/unused.py"
