"""A policy for another lidar is one file too: the adapter's ONNX form reads scans as it does."""

import math

import numpy as np
import pytest
import torch
from nightly import mostly

from navrl.config import compose
from navrl.jobs.changed_bundle import export_bundle
from navrl.jobs.exporting import export
from navrl.ops.scan_layout import ScanLayout
from navrl.ops.scanner import Scanner
from navrl.transforms import ScanAdapter

pytest.importorskip("onnxscript", reason="needs the extra onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")

SCANNERS = {
    "center": {},
    "backwards, off center, clockwise": {
        "angle_min": math.pi,
        "angle_increment": -2.0 * math.pi / 360,
        "mount": (-0.08, 0.05, math.pi),
    },
    "240 degrees, own parts": {
        "angle_min": -2.0944,
        "angle_increment": 4.1888 / 359,
        "mount": (0.1, 0.0, 0.0),
        "own_radius": 0.2,
    },
}
REVOLUTION = torch.tensor([[-0.05, 0.01, -0.2], [-0.02, 0.0, -0.1]])  # at the first and last beam


def scans(count: int) -> torch.Tensor:
    """Readings [count, 360] m of all kinds: returns, free, too near and invalid ones."""
    generator = torch.Generator().manual_seed(3)
    ranges = 0.1 + 4.0 * torch.rand(count, 360, generator=generator)
    kinds = torch.rand(count, 360, generator=generator)
    for low, value in ((0.9, math.inf), (0.93, -math.inf), (0.96, math.nan), (0.98, 0.0)):
        ranges = torch.where(kinds > low, value, ranges)
    return ranges


@pytest.mark.slow
@pytest.mark.parametrize("has_motion", mostly([False, True], [True]))
@pytest.mark.parametrize("name", mostly(SCANNERS, ["240 degrees, own parts"]))
def test_graph_resamples_as_the_transform(name, has_motion, tmp_path):
    from navrl.export.writing import _converted

    angles = {"angle_min": -math.pi, "angle_increment": 2.0 * math.pi / 360}
    scanner = Scanner(**(angles | {"range_min": 0.15, "range_max": 12.0} | SCANNERS[name]))
    names = ["ranges", "scan_motion"] if has_motion else ["ranges"]
    adapter = ScanAdapter(scanner, num_beams=1440, in_keys=names)

    class Graph(torch.nn.Module):
        def forward(self, *inputs):
            return adapter.map_values(*inputs)

    examples = [torch.ones(1, 360), REVOLUTION[None]][: len(names)]
    model = _converted(Graph(), names, examples, ["ranges_adapted", "measured"])
    import onnx_ir

    file = tmp_path / "adapter.onnx"
    onnx_ir.save(model, file)
    given = [scans(20), REVOLUTION.expand(20, 2, 3)][: len(names)]
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    inputs = {key: value.numpy() for key, value in zip(names, given, strict=True)}
    ranges, measured = session.run(None, inputs)
    expected = adapter.map_values(*given)
    np.testing.assert_array_equal(measured, expected[1].numpy())
    np.testing.assert_allclose(ranges, expected[0].numpy(), rtol=0.0, atol=1e-6)
    assert 0.05 < (ranges < 3.5).mean() < 1.0


def test_number_of_covered_beams_is_bounded():
    """The width that a graph allows for is that of a robot that turns at pi rad a revolution."""
    from navrl.ops.scan_adapter import _MAX_WIDENING, _frames, _rays, _widest

    scanner = Scanner(angle_min=-math.pi, angle_increment=2.0 * math.pi / 360, mount=(0.3, 0, 0))
    turn = torch.tensor([[[0.0, 0.0, -3.1], [0.0, 0.0, 0.0]]])
    near = torch.full((1, 360), 0.31)
    target = ScanLayout(1440, 1)
    rays = _rays(near.double(), scanner, _frames(near, scanner, target, turn))
    assert rays.width.max() <= _MAX_WIDENING * _widest(360, scanner)


@pytest.mark.slow
def test_file_of_a_policy_for_another_lidar_drives(tmp_path):
    """The writer compares 100 recorded steps with the runner, and fails beyond 1e-5."""
    adapted = compose("export", ["policy=paper", "perturbation=rplidar_a1", "format=bundle"])
    export_bundle(adapted, tmp_path / "a1")
    mount = "[-0.08,0.05,3.14159]"
    changes = [
        f"+change.lidar.mount={mount}",
        f"+change.transforms.scan_adapter.scanner.mount={mount}",
    ]
    cfg = compose("export", [f"policy={tmp_path / 'a1'}", "num_threads=1", *changes])
    assert export(cfg, tmp_path / "a1.onnx") < 1e-5
