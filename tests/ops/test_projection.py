"""Points read as ranges by bearing."""

import math

import pytest
import torch

from navrl.ops import se2
from navrl.ops.pooling import min_pool
from navrl.ops.projection import project_ranges
from navrl.ops.scan_layout import bin_centers


def scan(num_beams=1440, worlds=5):
    generator = torch.Generator().manual_seed(0)
    return 0.3 + 4.0 * torch.rand(worlds, num_beams, generator=generator)


@pytest.mark.parametrize(("num_beams", "group_size"), [(1440, 8), (180, 1), (1536, 3)])
def test_identity_projection_preserves_the_scan(num_beams, group_size):
    pooled = min_pool(scan(num_beams), group_size)
    ranges = project_ranges(pooled.points, torch.zeros(()).expand_as(pooled.ranges), group_size)
    torch.testing.assert_close(ranges, pooled.ranges)


def test_rotation_by_whole_bins_rolls_the_scan():
    pooled = min_pool(scan(), 8)
    turn = torch.tensor([0.0, 0.0, 10 * 2 * math.pi / 180])
    turned = project_ranges(se2.transform_points(turn, pooled.points), pooled.ranges)
    torch.testing.assert_close(turned, pooled.ranges.roll(10, -1))


def test_nearest_point_wins_and_empty_bins_are_filled():
    center = bin_centers(8, 1, torch.float32)
    points = torch.zeros(8, 2)
    points[:, 0] = torch.tensor([3.0, 2.0, 2.5, 9.0, 3.4, 3.4, 3.4, 3.4])  # all in the first bin
    fill = torch.arange(8.0)
    assert project_ranges(points, fill, 1).tolist() == [2.0, *range(1, 8)]
    far = 9.0 * torch.stack([center.cos(), center.sin()], -1)
    assert project_ranges(far, fill, 1, max_range=3.5).tolist() == [3.5] * 8


def test_non_finite_points_are_in_no_bin():
    points = torch.full((3, 4, 2), 1.0)
    points[0] = math.nan
    points[1] = math.inf
    points[2, :, 1] = math.nan
    fill = torch.tensor([1.0, 2.0, 3.0, 4.0]).expand(3, 4)
    assert torch.equal(project_ranges(points, fill, 1), fill)


@pytest.mark.parametrize(("points", "fill"), [((180, 3), (180,)), ((180, 2), (90,)), ((2,), (2,))])
def test_shapes_are_checked(points, fill):
    with pytest.raises(ValueError, match=r"points, fill: must have shapes \[\*B, N, 2\]"):
        project_ranges(torch.zeros(points), torch.zeros(fill))
