"""A policy with the scan flow is one file too: its network and its shield have an ONNX form."""

import math

import numpy as np
import pytest
import torch

from navrl.config import compose
from navrl.jobs.exporting import export
from navrl.ops.motion import FAR
from navrl.ops.tracking import track_groups
from navrl.transforms import ActionShield, EstimateFlow

pytest.importorskip("onnxscript", reason="needs the extra onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")

NAMES = ["action", "points", "returns", "flow_ranges"]


def scenes(count):
    """Commands, points, returns and past ranges; the robot is in the free part of a noisy room."""
    generator = torch.Generator().manual_seed(5)
    bearing = torch.arange(60) * (2.0 * math.pi / 60)
    ranges = 0.3 + 2.0 * torch.rand(count, 6, 60, generator=generator)
    around = torch.stack([bearing.cos(), bearing.sin()], dim=-1)
    points = ranges[:, 0, :, None] * around
    returns = torch.rand(count, 60, generator=generator) < 0.3
    turn = torch.rand(count, generator=generator) - 0.5
    action = torch.stack([torch.rand(count, generator=generator), turn], dim=-1)
    return action, points, returns, ranges


@pytest.mark.slow
def test_graph_shields_as_the_transforms(lively, tmp_path):
    import onnx_ir

    from navrl.export.writing import _converted

    flow = EstimateFlow(lively)
    shield = ActionShield(
        num_speeds=3,
        num_turn_rates=5,
        group_radius=0.05,
        max_descriptor_speed=2.5,
        moving_margin=0.2,
        moving_horizon=0.8,
    )

    class Graph(torch.nn.Module):
        def forward(self, action, points, returns, ranges):
            seen = flow.map_values(points, returns, ranges)
            return shield.command(action, points, returns, *seen), *seen

    given = scenes(40)
    examples = [value[:1] for value in given]
    model = _converted(Graph(), NAMES, examples, ["command", "flow", "flow_valid"])
    onnx_ir.save(model, tmp_path / "shield.onnx")
    session = onnxruntime.InferenceSession(
        tmp_path / "shield.onnx", providers=["CPUExecutionProvider"]
    )
    inputs = {name: value.numpy() for name, value in zip(NAMES, given, strict=True)}
    command, places, valid = session.run(None, inputs)
    seen = flow.map_values(*given[1:])
    np.testing.assert_allclose(places, seen[0].numpy(), rtol=0.0, atol=1e-5)
    np.testing.assert_array_equal(valid, seen[1].numpy())
    expected = shield.command(*given[:3], *seen)
    np.testing.assert_allclose(command, expected.numpy(), rtol=0.0, atol=1e-5)
    same = ActionShield(num_speeds=3, num_turn_rates=5, group_radius=0.05)
    plain = same.command(*given[:3], *seen)
    assert (expected != given[0]).any() and (expected != plain).any()


def test_graph_tracks_as_the_transform(tmp_path):
    import onnx_ir

    from navrl.export.writing import _converted

    class Graph(torch.nn.Module):
        def forward(self, points, moving, past):
            return track_groups(points, moving, past)

    generator = torch.Generator().manual_seed(5)
    _, points, moving, _ = scenes(40)
    drift = 0.1 * torch.randn(40, 5, 1, 2, generator=generator).cumsum(1)
    past = points.unsqueeze(1) + drift + 0.02 * torch.randn(40, 5, 60, 2, generator=generator)
    past = torch.where(torch.rand(40, 5, 60, 1, generator=generator) < 0.5, past, FAR)
    given = [points, moving, past]
    names = ["points", "moving", "past"]
    examples = [value[:1] for value in given]
    model = _converted(Graph(), names, examples, ["tracks", "tracks_valid"])
    onnx_ir.save(model, tmp_path / "tracks.onnx")
    session = onnxruntime.InferenceSession(
        tmp_path / "tracks.onnx", providers=["CPUExecutionProvider"]
    )
    inputs = {name: value.numpy() for name, value in zip(names, given, strict=True)}
    tracks, valid = session.run(None, inputs)
    expected = track_groups(*given)
    np.testing.assert_array_equal(valid, expected.valid.numpy())
    np.testing.assert_allclose(tracks, expected.tagd.numpy(), rtol=0.0, atol=1e-4)
    assert 0.1 < valid.mean() < 0.9


@pytest.mark.slow
def test_file_of_a_policy_with_the_flow_drives(lively, tmp_path):
    """The writer compares 100 recorded steps with the runner, and fails beyond 1e-5."""
    words = ["policy=navrl-best-places", "+transforms/steps@change.transforms=track_shield"]
    words += [f"+change.transforms.flow.weights={lively}", "num_threads=1"]
    assert export(compose("export", words), tmp_path / "flow.onnx") < 1e-5
