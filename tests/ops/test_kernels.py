"""The perception kernels give the numbers of the torch forms, whatever they are given."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from rooms import sample_scan_pairs

from navrl.ops.grouping import tagd
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST
from navrl.ops.kernels.icp import weigh_pairs
from navrl.ops.kernels.nearest import SMALLEST, WINDOW
from navrl.ops.kernels.rotation_search import search_rotation
from navrl.ops.pooling import min_pool
from navrl.ops.rotation_search import rotation_search
from navrl.ops.se2 import transform_points

OPTIONS = {
    "paper": PAPER,
    "robust": ROBUST,
    "no_robust_weight": replace(ROBUST, robust_scale=None),
    "line_from_identity": replace(PAPER, metric="point_to_line"),
    "searched_point_to_point": replace(PAPER, initialization="rotation_search"),
    "short": replace(ROBUST, max_iterations=3),
    "tight": replace(PAPER, gate=0.05),
}


def double(scans):
    return [scan.double() if scan.is_floating_point() else scan for scan in scans]


def scan_pairs(count=48, **options):
    pairs = sample_scan_pairs(count, beams_per_point=2, **options)
    return [pairs.source.points, pairs.source.returns, pairs.target.points, pairs.target.returns]


def assert_same_alignment(scans, options, share=1.0):
    """The kernel against the torch form in double precision: same steps to the last."""
    kernel = align(*double(scans), options, backend="numba")
    oracle = align(*double(scans), options, backend="torch")
    same = (kernel.transform - oracle.transform).abs().amax(-1) < 1e-6
    same &= kernel.converged == oracle.converged
    same &= kernel.inliers == oracle.inliers
    same &= (kernel.rmse - oracle.rmse).abs() < 1e-6
    assert same.double().mean() >= share
    return kernel


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("num_pedestrians", [0, 8])
def test_alignment_equals_torch(options, num_pedestrians):
    scans = scan_pairs(seed=4, num_pedestrians=num_pedestrians)
    result = assert_same_alignment(scans, options, share=0.95 if options.gate == 0.05 else 1.0)
    assert result.iterations.float().mean() > 2.5  # the search had something to do
    single = align(*scans, options)
    assert single.transform.dtype == torch.float32
    assert (single.transform - result.transform).abs().amax(-1).lt(1e-4).float().mean() > 0.9


@pytest.mark.parametrize("num_points", [12, WINDOW - 1, 24, SMALLEST - 1, SMALLEST, 60, 360])
def test_alignment_equals_torch_for_any_number_of_points(num_points):
    scans = scan_pairs(seed=5, num_points=num_points)
    assert_same_alignment(scans, replace(ROBUST, gate=0.5))
    assert_same_alignment(scans, replace(PAPER, min_pairs=3))


@pytest.mark.parametrize("scale", [0.1, 0.2, 1.0])
def test_alignment_equals_torch_far_from_the_start(scale):
    """Beside a wall a step moves bearings by more than any window; no neighbor may be missed."""
    source, returns, target, target_returns = scan_pairs(seed=6)
    generator = torch.Generator().manual_seed(8)
    motion = 0.4 * torch.rand(len(source), 3, generator=generator) - 0.2
    scans = [transform_points(motion, source * scale), returns, target * scale, target_returns]
    assert_same_alignment(scans, replace(PAPER, gate=2.0))
    assert_same_alignment(scans, replace(ROBUST, gate=0.1))


@pytest.mark.parametrize("order", ["shuffled", "clockwise", "two rounds"])
def test_alignment_equals_torch_without_order(order):
    """Points in any other order, and scans of different lengths, are searched without windows."""
    source, returns, target, target_returns = scan_pairs(seed=7)
    index = {
        "shuffled": torch.randperm(180, generator=torch.Generator().manual_seed(0)),
        "clockwise": torch.arange(179, -1, -1),
        "two rounds": torch.cat((torch.arange(0, 180, 2), torch.arange(1, 180, 2))),
    }[order]
    scans = [source, returns, target[:, index], target_returns[:, index]]
    assert_same_alignment(scans, PAPER)
    assert_same_alignment([source[:, :90], returns[:, :90], *scans[2:]], PAPER)


def test_equally_good_rotations_are_chosen_as_in_torch():
    """Two returns fit to both sides, to the last bit: the turn to the right is taken."""
    rows = np.zeros((2, 3, 180))  # x, y and whether it is a return, of source and target
    rows[0][:, [10, 60]] = rows[1][:, [7, 13, 57, 63]] = [[1.0], [0.0], [1.0]]
    source, target = (torch.from_numpy(part[:2].T.copy()) for part in rows)
    seen, twice = (torch.from_numpy(part[2] > 0) for part in rows)
    yaw = rotation_search(source, seen, target, twice)
    assert yaw == pytest.approx(-3 * 2 * math.pi / 180)
    everywhere = np.ones(180, dtype=bool)
    assert search_rotation(*rows, everywhere, False, 0.7) == pytest.approx(yaw.item())


def test_rotations_of_partial_scans_are_compared_as_in_torch():
    scans = scan_pairs(seed=3)
    seen = torch.cos(torch.arange(180) * (2 * math.pi / 180)) > 0.2  # ahead
    scans[1] &= seen
    scans[3] &= seen
    covered = seen.expand_as(scans[1])
    expected = rotation_search(*(scan.double() if scan.ndim == 3 else scan for scan in scans),
                               seen=covered)  # fmt: skip
    for row, yaw in enumerate(expected):
        rows = [
            np.concatenate([points[row].double().T.numpy(), returns[row, None].numpy()])
            for points, returns in (scans[:2], scans[2:])
        ]
        found = search_rotation(*rows, seen.numpy(), True, 0.7)
        assert found == pytest.approx(yaw.item(), abs=1e-6)


@pytest.mark.parametrize("broken", [math.nan, math.inf, 0.0])
def test_alignment_never_reads_points_that_are_no_returns(broken):
    scans = scan_pairs(seed=9)
    scans[1][:, 20:60] = False
    scans[3][:, 100:130] = False
    clean = align(*scans, ROBUST)
    scans[0] = scans[0].masked_fill(~scans[1].unsqueeze(-1), broken)
    scans[2] = scans[2].masked_fill(~scans[3].unsqueeze(-1), broken)
    result = align(*scans, ROBUST)
    assert torch.allclose(result.transform, clean.transform, atol=1e-6)
    assert_same_alignment(scans, ROBUST)


def test_alignment_without_returns_is_the_identity():
    scans = scan_pairs(count=4, seed=10)
    scans[1][0] = False
    scans[3][1] = False
    scans[1][2], scans[3][2] = False, False
    result = align(*scans, ROBUST)
    assert (result.transform[:3] == 0.0).all()
    assert not result.converged[:3].any()
    assert (result.inliers[:3] == 0).all()
    assert result.converged[3]
    assert_same_alignment(scans, ROBUST)


@pytest.mark.parametrize(
    "fills",
    [*itertools.product(("center", "zeros"), ("current", "center", "zeros"), ("groups", "zeros"))],
)
def test_descriptors_equal_torch(fills):
    source, returns, target, target_returns = scan_pairs(count=16, seed=11, num_pedestrians=4)
    returns[0], target_returns[0] = False, False
    returns[1], target_returns[2] = False, False
    options = dict(zip(("empty_now", "empty_previous", "empty_scans"), fills, strict=True))
    for num_groups in (1, 2, 7, 30):
        scans = (target, target_returns, source, returns)
        kernel = tagd(*double(scans), num_groups, backend="numba", **options)
        oracle = tagd(*double(scans), num_groups, backend="torch", **options)
        assert torch.equal(kernel.valid, oracle.valid)
        torch.testing.assert_close(kernel.tagd, oracle.tagd, atol=1e-9, rtol=0)
        single = tagd(*scans, num_groups, **options)
        assert single.tagd.dtype == torch.float32
        torch.testing.assert_close(single.tagd.double(), oracle.tagd, atol=1e-5, rtol=0)


def test_descriptors_on_sector_borders_equal_torch():
    """A point exactly between two rays counts for both of them."""
    angle = torch.arange(60, dtype=torch.float64) * (2 * math.pi / 60)
    points = (1.0 + 0.1 * torch.rand(60, 1).double()) * torch.stack((angle.cos(), angle.sin()), -1)
    seen = torch.ones(60, dtype=torch.bool)
    turned = transform_points(torch.tensor([0.05, 0.0, 0.02], dtype=torch.float64), points)
    for scans in ((points, seen, turned, seen), (points.float(), seen, turned.float(), seen)):
        kernel = tagd(*scans, backend="numba")
        oracle = tagd(*double(scans), backend="torch")
        torch.testing.assert_close(kernel.tagd.double(), oracle.tagd, atol=1e-5, rtol=0)


@pytest.mark.parametrize("bearing", ["bin", "beam"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("beams", "group_size"), [(1440, 8), (360, 1), (90, 90), (21, 7)])
def test_pooling_equals_torch_bit_for_bit(bearing, dtype, beams, group_size):
    generator = torch.Generator().manual_seed(12)
    ranges = (5.0 * torch.rand(32, beams, generator=generator, dtype=dtype)).clamp(max=3.5)
    odd = torch.tensor([math.nan, math.inf, -math.inf, -1.0, 0.0, 3.4999, 3.49995, 3.5, 4.0])
    spots = torch.randint(0, beams, (32, 9), generator=generator)
    ranges.scatter_(1, spots, odd.to(dtype).expand(32, 9))
    ranges[0], ranges[1] = 3.5, math.nan
    kernel = min_pool(ranges, group_size, bearing=bearing, backend="numba")
    oracle = min_pool(ranges, group_size, bearing=bearing, backend="torch")
    for ours, theirs in zip(kernel, oracle, strict=True):
        assert torch.equal(ours, theirs)
        assert ours.dtype == theirs.dtype


def test_results_do_not_depend_on_the_number_of_threads():
    scans = scan_pairs(seed=13)
    threads = torch.get_num_threads()
    results = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            alignment = align(*scans, ROBUST)
            groups = tagd(scans[2], scans[3], scans[0], scans[1])
            results.append((*alignment, *groups))
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(one, two) for one, two in zip(*results, strict=True))


def test_gradients_use_the_torch_implementation():
    ranges = torch.rand(2, 16, requires_grad=True)
    min_pool(ranges, 8).points.sum().backward()
    assert ranges.grad.abs().sum() > 0
    with pytest.raises(ValueError, match="requires a gradient"):
        min_pool(ranges, 8, backend="numba")
    with pytest.raises(ValueError, match="auto, numba, torch"):
        min_pool(ranges, 8, backend="c")
    assert min_pool(ranges.detach().half(), 8).points.dtype == torch.float16


def test_unsearched_points_do_not_affect_the_error():
    """What a point without a return holds is whatever was in memory: NaN, infinity, anything."""
    returns, weights = np.array([1.0, 0.0, 0.0, 1.0]), np.empty(4)
    squared = np.array([0.25, np.nan, np.inf, 9.0], dtype=np.float32)
    assert weigh_pairs(returns, squared, 1.0, weights) == (1.0, 0.25)
    assert weights.tolist() == [1.0, 0.0, 0.0, 0.0]
