#!/usr/bin/env bash
# ONNX Runtime 1.32.0 on a CPU: standard operators lack double precision, each in its own way.
#
# Guess, written down first: a graph that onnx.checker accepts, of operators for which the ONNX
# standard allows double, runs on the CPU in double; at least the trigonometric ones are alike.
# Seen: Sin, Cos and Atan are all allowed in double by opset 20 and pass the checker. Sin and Cos
# run, Atan raises NOT_IMPLEMENTED when the session is made. Atan2 is no operator at all.
# For a user: compute headings from double precision with Atan in float, or by Sin and Cos.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q onnx==1.23.2 onnxruntime==1.32.0
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper

seen = {}
for name in ("Sin", "Cos", "Atan"):
    for kind, dtype in (("float", np.float32), ("double", np.float64)):
        element = getattr(TensorProto, kind.upper())
        values = [helper.make_tensor_value_info(key, element, [1]) for key in ("x", "y")]
        graph = helper.make_graph([helper.make_node(name, ["x"], ["y"])], "g", values[:1], values[1:])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        onnx.checker.check_model(model, full_check=True)
        try:
            session = onnxruntime.InferenceSession(model.SerializeToString())
            session.run(None, {"x": np.ones(1, dtype)})
            seen[name, kind] = "runs"
        except Exception as error:
            seen[name, kind] = type(error).__name__
        print(f"{name} {kind}: {seen[name, kind]}")
expected = {(name, kind): "runs" for name in ("Sin", "Cos", "Atan") for kind in ("float", "double")}
expected["Atan", "double"] = "NotImplemented"
assert seen == expected, "ONNX Runtime behaves otherwise now"
PY
