#!/usr/bin/env bash
# torch 2.13.0 with onnxscript 0.7.1: a float64 model becomes an ONNX file whose numbers are float32.
#
# Guess, written down first: a module in float64, exported by torch.onnx.export(dynamo=True), gives
# the same values as the module to about 1e-15, for every node of the file is in double.
# Seen: the nodes and their constants are in double, but a Python number of an expression has been
# rounded to float32 before: x * 0.1, x + 0.1 and x / 0.3 are off by 1e-9 to 3e-7 for x in [1, 2].
# A tensor in float64 in place of the number, x * torch.tensor(0.1, dtype=torch.float64), is exact.
# For a user: angles of a lidar, -pi + k * increment, are off by 1e-7 rad in a file that is double.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 numpy==2.4.6 onnx==1.23.2 onnxscript==0.7.1 onnxruntime==1.32.0
"$folder/venv/bin/python" - "$folder/model.onnx" <<'PY'
import sys

import numpy as np
import onnxruntime
import torch

TENTH = torch.tensor(0.1, dtype=torch.float64)


class Model(torch.nn.Module):
    def forward(self, x):
        return x * 0.1, x + 0.1, x / 0.3, x * TENTH


example = torch.ones(4, dtype=torch.float64)
program = torch.onnx.export(Model(), (example,), input_names=["x"], dynamo=True, verbose=False)
kinds = {str(value.dtype) for node in program.model.graph for value in node.inputs}
program.save(sys.argv[1])
session = onnxruntime.InferenceSession(sys.argv[1], providers=["CPUExecutionProvider"])
x = torch.linspace(1.0, 2.0, 4, dtype=torch.float64)
found = session.run(None, {"x": x.numpy()})
errors = [float(np.abs(a - b.numpy()).max()) for a, b in zip(found, Model()(x))]
print("types of all inputs of nodes:", kinds)
for text, error in zip(("x * 0.1", "x + 0.1", "x / 0.3", "x * tensor(0.1)"), errors):
    print(f"{text:16s} off by {error:.1e}")
assert kinds == {"DOUBLE"}, "torch writes other types now"
assert min(errors[:3]) > 1e-10 and errors[3] < 1e-15, "torch writes numbers otherwise now"
PY
