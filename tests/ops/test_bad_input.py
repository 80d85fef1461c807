"""Broken scans are errors or defined; none is a silently wrong result."""

import math

import pytest
import torch

from navrl.ops import se2
from navrl.ops.grouping import tagd
from navrl.ops.icp import align
from navrl.ops.icp_options import IcpOptions
from navrl.ops.pooling import min_pool
from navrl.ops.projection import project_ranges
from navrl.ops.raycast import cast_rays

BACKENDS = ("numba", "torch")


@pytest.fixture
def scans():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(2, 180, 2, generator=generator) * 4 - 2
    return points, torch.ones(2, 180, dtype=torch.bool)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
def test_invalid_beam_has_no_return_and_no_effect_on_others(backend, broken):
    ranges = torch.full((1, 16), 2.0)
    ranges[0, 3] = broken
    pooled = min_pool(ranges, 8, 3.5, backend=backend)
    assert pooled.ranges.tolist() == [[2.0, 2.0]] and pooled.returns.all()
    pooled = min_pool(torch.full((1, 8), broken), 8, 3.5, backend=backend)
    assert pooled.ranges.item() == 3.5 and not pooled.returns.any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_invalid_point_counts_as_no_return(scans, backend, broken):
    points, returns = scans
    broken_points, without = points.clone(), returns.clone()
    broken_points[0, 7, 1], without[0, 7] = broken, False
    for ours, other in (
        (align(broken_points, returns, points, returns, backend=backend),
         align(points, without, points, returns, backend=backend)),
        (align(points, returns, broken_points, returns, backend=backend),
         align(points, returns, points, without, backend=backend)),
        (tagd(broken_points, returns, points, returns, backend=backend),
         tagd(points, without, points, returns, backend=backend)),
        (tagd(points, returns, broken_points, returns, backend=backend),
         tagd(points, returns, points, without, backend=backend)),
    ):  # fmt: skip
        for value, expected in zip(ours, other, strict=True):
            torch.testing.assert_close(value, expected, rtol=0, atol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_integer_input_equals_float_input(backend):
    """Points, poses and boxes in whole millimeters: nothing is cut off."""
    generator = torch.Generator().manual_seed(4)
    points = torch.randint(-2000, 2000, (2, 60, 2), generator=generator)
    moved = points + torch.tensor([13, -7])
    returns = torch.ones(2, 60, dtype=torch.bool)
    options = IcpOptions(gate=300.0, translation_tolerance=0.1, min_pairs=10)
    for ours, other in (
        (align(points, returns, moved, returns, options, backend),
         align(points.float(), returns, moved.float(), returns, options, backend)),
        (tagd(points, returns, moved, returns, 8, 250.0, 3500.0, backend=backend),
         tagd(points.float(), returns, moved.float(), returns, 8, 250.0, 3500.0, backend=backend)),
    ):  # fmt: skip
        for value, expected in zip(ours, other, strict=True):
            assert torch.equal(value, expected)
    pose, boxes = torch.tensor([[10, -20, 1]]), torch.tensor([[[900, 0, 101, 50, 1]]])
    ray = {"num_beams": 45, "max_range": 3500.0, "backend": backend}
    assert torch.equal(cast_rays(pose, boxes, **ray), cast_rays(pose.float(), boxes.float(), **ray))
    assert torch.equal(cast_rays(pose.float(), boxes, **ray), cast_rays(pose, boxes.float(), **ray))
    transform = torch.tensor([[3, 4, 1], [0, 0, 2]])
    turned = se2.transform_points(transform, points)
    torch.testing.assert_close(turned, se2.transform_points(transform.float(), points.float()))
    fill = torch.full((2, 60), 3500)
    projected = project_ranges(points, fill, 1, 3500.0)
    assert torch.equal(projected, project_ranges(points.float(), fill.float(), 1, 3500.0))


@pytest.mark.parametrize("backend", BACKENDS)
def test_scans_without_a_single_return_are_defined(scans, backend):
    points, returns = scans
    nothing = torch.zeros_like(returns)
    result = align(points, nothing, points, nothing, backend=backend)
    assert not result.converged.any() and result.inliers.eq(0).all()
    assert result.transform.eq(0).all()
    groups = tagd(points, nothing, points, nothing, num_groups=4, backend=backend)
    assert not groups.valid.any()
    torch.testing.assert_close(groups.tagd.norm(dim=-1), torch.full((2, 4), 3.5 * 2**0.5))


@pytest.mark.parametrize("backend", BACKENDS)
def test_raycast_without_boxes_or_inside_a_box_is_defined(backend):
    pose = torch.zeros(2, 3)
    free = cast_rays(pose, torch.zeros(2, 0, 5), num_beams=8, max_range=3.5, backend=backend)
    assert free.eq(3.5).all()
    around = torch.tensor([0.0, 0.0, 1.0, 1.0, 0.3]).expand(2, 1, 5)
    assert cast_rays(pose, around, num_beams=8, max_range=3.5, backend=backend).eq(0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_invalid_arguments_are_named(scans, backend):
    points, returns = scans
    pose, boxes = torch.zeros(1, 3), torch.tensor([[[1.0, 0.0, -0.1, 0.1, 0.0]]])
    ray = {"num_beams": 8, "max_range": 3.5, "backend": backend}
    with pytest.raises(ValueError, match="half sizes"):
        cast_rays(pose, boxes, **ray)
    with pytest.raises(ValueError, match="pose: must be finite"):
        cast_rays(pose * math.nan, boxes.abs(), **ray)
    with pytest.raises(ValueError, match="boxes: must be"):
        cast_rays(pose.expand(2, 3), boxes.abs(), **ray)
    with pytest.raises(ValueError, match="one device"):
        cast_rays(pose, boxes.to("meta"), **ray)
    with pytest.raises(ValueError, match="same batch"):
        align(points, returns, points[:1], returns[:1], backend=backend)
    with pytest.raises(ValueError, match="device"):
        align(points, returns, points.to("meta"), returns.to("meta"), backend=backend)
    with pytest.raises(ValueError, match="device"):
        tagd(points, returns, points.to("meta"), returns.to("meta"), backend=backend)
    with pytest.raises(ValueError, match="group_size"):
        min_pool(torch.ones(1, 10), 3, 3.5, backend=backend)
