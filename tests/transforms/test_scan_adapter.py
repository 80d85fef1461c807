"""The scan adapter writes what a simulated lidar with blind beams would."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Unbounded

from navrl.ops.scanner import Scanner
from navrl.transforms import MinPool, ScanAdapter, compose

HALF = math.radians(135.0)
FRONT = Scanner(-HALF, HALF / 540, range_min=0.1, range_max=30.0)
SEEN_KEYS = ["ranges_pooled", "points", "returns", "seen"]


def test_pooled_scan_equals_that_of_the_scanner_itself():
    """Two ways to read a 270 degree scanner: bins of its beams, and beams of the policy."""
    generator = torch.Generator().manual_seed(0)
    ranges = 1.0 + 2.0 * torch.rand(3, 1081, generator=generator)
    direct = MinPool(None, 3.5, num_points=180, angle_min=-HALF, angle_increment=HALF / 540)
    steps = compose(
        adapter=ScanAdapter(FRONT),
        pool=MinPool(in_keys=["ranges", "measured"], out_keys=SEEN_KEYS),
    )
    adapted = steps(TensorDict({"ranges": ranges}, [3]))
    pooled, _, returns = direct(ranges=ranges)
    assert (adapted["returns"] == returns).float().mean() > 0.98  # bins begin half a beam apart
    assert (adapted["ranges_pooled"] - pooled).abs().median() == 0.0
    assert torch.equal(adapted["seen"], adapted["returns"])
    assert 134 <= adapted["seen"].sum(-1)[0] <= 137


def test_free_and_unseen_beams_read_the_maximum_range():
    readings = torch.full((1, 1081), 12.0)
    readings[0, 500:600], readings[0, 300] = math.inf, -math.inf
    ranges, measured = ScanAdapter(FRONT)(ranges=readings)
    assert ranges.shape == measured.shape == (1, 1440)
    assert (ranges.unique() == torch.tensor([0.1, 3.5])).all()
    assert measured[0, :500].all() and not measured[0, 560:880].any()


def test_motion_is_read_from_a_further_key():
    adapter = ScanAdapter(Scanner(), num_beams=4, in_keys=["ranges", "scan_motion"])
    moved = torch.tensor([[[-0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]]])
    ranges, _ = adapter(ranges=torch.tensor([[2.0, 1.0, 2.0, 1.0]]), scan_motion=moved)
    assert ranges[0, [0, 2]].tolist() == pytest.approx([1.5, 2.5])


def test_specs_have_the_shape_of_the_result():
    ranges, measured = ScanAdapter(FRONT).map_specs(Unbounded((2, 1081)))
    assert ranges.shape == measured.shape == (2, 1440)
    with pytest.raises(ValueError, match="must be within one revolution"):
        ScanAdapter(FRONT).map_specs(Unbounded((2, 2000)))
