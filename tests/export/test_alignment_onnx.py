"""The alignment of two scans as an ONNX graph: equal to the kernel, with few operations a step."""

import pytest
import torch
from aligned_scans import Aligned, scans

from navrl.export.writing import _converted
from navrl.ops.icp_options import PAPER, ROBUST

onnx_ir = pytest.importorskip("onnx_ir", reason="needs the extra onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")

NAMES = ["source", "returns", "target"]
pytestmark = pytest.mark.slow  # by day a whole policy is exported


@pytest.fixture(scope="module", params=[PAPER, ROBUST], ids=["paper", "robust"])
def converted(request):
    module = Aligned(request.param)
    inputs = scans(torch.Generator().manual_seed(0), num_points=180)
    examples = [value[:1] for value in inputs]
    return module, inputs, _converted(module, NAMES, examples, ["motion", "converged", "pairs"])


@pytest.mark.parametrize("rows", [1, 4])
def test_graph_of_an_alignment_equals_the_kernel(converted, rows):
    module, inputs, model = converted
    file = onnx_ir.to_proto(model).SerializeToString()
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    part = [value[:rows] for value in inputs]
    found = session.run(
        None, {name: value.numpy() for name, value in zip(NAMES, part, strict=True)}
    )
    for values, expected in zip(found, module(*part), strict=True):
        torch.testing.assert_close(torch.from_numpy(values), expected, atol=1e-7, rtol=0.0)


def test_steps_of_an_alignment_have_few_operations(converted):
    """Starting an operation costs more time than the numbers of one scan."""
    _, _, model = converted
    loops = [node for node in model.graph if node.op_type == "Loop"]
    counts = [len(loop.attributes["body"].as_graph()) for loop in loops]
    assert all(count <= limit for count, limit in zip(counts, [70, 160], strict=False))
    assert counts


class WithoutAlignment(Aligned):
    def forward(self, source, returns, target):
        super().forward(source, returns, target)
        return (2.0 * source,)


def test_unused_alignment_leaves_no_constants():
    """ONNX Runtime warns of each, whenever a file is loaded."""
    inputs = scans(torch.Generator().manual_seed(0), num_points=20)
    model = _converted(WithoutAlignment(PAPER), NAMES, inputs, ["doubled"])
    assert [node.op_type for node in model.graph] == ["Mul"]
    assert len(model.graph.initializers) == 1
