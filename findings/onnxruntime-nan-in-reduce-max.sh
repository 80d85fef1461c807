#!/usr/bin/env bash
# ONNX Runtime 1.32.0 on a CPU: ReduceMax of a row with a NaN is neither NaN nor the largest number.
#
# Guess, written down first: ReduceMax gives NaN if any value is NaN, as Max, numpy and torch do; at
# worst it skips NaN and gives the largest of the others, as fmax does.
# Seen: Max gives NaN. ReduceMax gives NaN only if the first value of the row is NaN. For a NaN in the
# second place of [1, NaN, 3, 4, 5, 6, 7, 8] it gives 7, while ArgMax points at the 8. ReduceMin and
# MaxPool hide a NaN too. The lost value depends on the length of the row, so some row is searched.
# For a user: a graph that looks for NaN readings of a sensor by ReduceMax misses them, and exported
# checks that work in torch do not: use IsNaN and Where before any reduction.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q onnx==1.23.2 onnxruntime==1.32.0
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import onnxruntime
from onnx import TensorProto, helper


def run(name, *inputs, **attributes):
    kinds = {np.dtype("float32"): TensorProto.FLOAT, np.dtype("int64"): TensorProto.INT64}
    keys = [f"x{i}" for i in range(len(inputs))]
    given = [
        helper.make_tensor_value_info(key, kinds[value.dtype], value.shape)
        for key, value in zip(keys, inputs)
    ]
    node = helper.make_node(name, keys, ["y"], **attributes)
    graph = helper.make_graph([node], "g", given, [helper.make_empty_tensor_value_info("y")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, dict(zip(keys, inputs)))[0].item()


def row(length, place):
    values = np.arange(1, length + 1, dtype=np.float32)
    values[place] = np.nan
    return values


one, axis = np.ones(1, np.float32), np.zeros(1, np.int64)
is_max_nan = np.isnan(run("Max", one * np.nan, one)) and np.isnan(run("Max", one, one * np.nan))
print("Max of NaN and 1 is NaN in both orders:", is_max_nan)
lost = []
for length in range(3, 65):
    first = run("ReduceMax", row(length, 0), axis, keepdims=0)
    second = run("ReduceMax", row(length, 1), axis, keepdims=0)
    lowest = run("ReduceMin", row(length, 1), axis, keepdims=0)
    assert np.isnan(first), "a NaN in front is hidden now"
    assert not np.isnan(second) and not np.isnan(lowest), "a NaN in the second place is seen now"
    if second < length:
        lost.append((length, second))
print("NaN in front: NaN; in the second place: never NaN, for all lengths from 3 to 64")
print("lengths whose largest number, equal to the length, is lost too:", lost)
assert is_max_nan and lost, "ONNX Runtime behaves otherwise now"
print("ArgMax of the row of 8 points at", run("ArgMax", row(8, 1), axis=0, keepdims=0) + 1)
PY
