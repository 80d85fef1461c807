"""TAGD against Algorithm 1, written as the two loops it is."""

import math
from functools import partial

import pytest
import torch

from navrl.ops.grouping import tagd
from navrl.ops.pooling import min_pool

MAX, RADIUS = 3.5, 0.25


@pytest.fixture(autouse=True, params=["torch", "numba"])
def backend(request, monkeypatch):
    """Every test of this file holds for both implementations."""
    monkeypatch.setitem(globals(), "tagd", partial(tagd, backend=request.param))


def algorithm_1(
    scan,
    previous,
    num_groups,
    *,
    empty_now="center",
    empty_previous="current",
    empty_scans="groups",
):
    """The paper's Algorithm 1 for one sample; ``scan`` and ``previous`` hold returns only."""
    descriptors, valid = [], []
    for i in range(num_groups):
        theta_ref = 2 * math.pi * i / num_groups
        r_min = MAX
        for x, y in scan:
            off = math.remainder(math.atan2(y, x) - theta_ref, 2 * math.pi)
            if abs(off) <= math.pi / num_groups + 1e-6:
                r_min = min(r_min, math.hypot(x, y))
        g = (r_min * math.cos(theta_ref), r_min * math.sin(theta_ref))
        group_now = [b for b in scan if math.dist(b, g) <= RADIUS]
        group_previous = [b for b in previous if math.dist(b, g) <= RADIUS]
        fill = {"center": g, "zeros": (0.0, 0.0)}
        c_now = centroid(group_now) or fill[empty_now]
        c_previous = centroid(group_previous) or {**fill, "current": c_now}[empty_previous]
        if empty_scans == "zeros" and not scan and not previous:
            c_now = c_previous = (0.0, 0.0)
        descriptors.append([*c_previous, *c_now])
        valid.append([bool(group_previous), bool(group_now)])
    return torch.tensor(descriptors), torch.tensor(valid)


def centroid(points):
    if not points:
        return None
    return tuple(sum(p[axis] for p in points) / len(points) for axis in (0, 1))


def random_scans(count, seed, num_points=60):
    """Two scans of broken walls, near and far; some have gaps, some no return at all."""
    generator = torch.Generator().manual_seed(seed)
    wall = 0.1 + 4.0 * torch.rand(count, num_points // 5, 1, generator=generator)
    scans = []
    for empty in (slice(0, None, 5), slice(0, None, 4)):
        ranges = wall + 0.2 * torch.rand(count, num_points // 5, 5, generator=generator)
        gap = torch.rand(count, num_points // 5, 1, generator=generator) < 0.3
        ranges = torch.where(gap, torch.inf, ranges).flatten(-2)
        ranges[empty] = torch.inf
        scans.append(min_pool(ranges, 1, MAX))
    return scans


FILLS = [
    {},
    {"empty_now": "zeros", "empty_previous": "zeros"},
    {"empty_previous": "center"},
    {"empty_scans": "zeros"},
]


@pytest.mark.parametrize("fills", FILLS, ids=str)
@pytest.mark.parametrize("num_groups", [30, 12, 7, 1])
def test_equals_algorithm_1(num_groups, fills):
    now, before = random_scans(count=12, seed=num_groups)
    shift = torch.tensor([0.1, -0.05])  # the aligned previous scan is not in polar order
    result = tagd(
        now.points,
        now.returns,
        before.points + shift,
        before.returns,
        num_groups=num_groups,
        group_radius=RADIUS,
        max_range=MAX,
        **fills,
    )
    for row in range(len(now.points)):
        scan = now.points[row][now.returns[row]].double().tolist()
        previous = (before.points + shift)[row][before.returns[row]].double().tolist()
        expected, valid = algorithm_1(scan, previous, num_groups, **fills)
        assert (result.valid[row] == valid).all()
        torch.testing.assert_close(result.tagd[row], expected, atol=2e-6, rtol=0)
    kinds = result.valid.flatten(0, -2).unique(dim=0)
    assert num_groups < 10 or len(kinds) == 4, "the random scans should show every kind of group"


def one_point(x, y):
    return torch.tensor([[x, y]]), torch.tensor([True])


def test_static_and_moving_obstacles_have_their_motion():
    points, returns = one_point(1.0, 0.0)
    moved, _ = one_point(1.1, 0.05)
    still = tagd(points, returns, points, returns).tagd[0]
    torch.testing.assert_close(still[:2], still[2:])
    walker = tagd(points, returns, moved, returns).tagd[0]  # it was at (1.1, 0.05) before
    torch.testing.assert_close(walker[2:] - walker[:2], torch.tensor([-0.1, -0.05]))


def test_single_ray_defines_a_descriptor():
    points, returns = one_point(0.0, 2.0)
    result = tagd(points, returns, points, returns, num_groups=4)
    assert result.valid.any(-1).tolist() == [False, True, False, False]
    torch.testing.assert_close(result.tagd[1], torch.tensor([0.0, 2.0, 0.0, 2.0]))


def test_border_belongs_to_both_sectors():
    angle = math.pi / 6  # between ray 0 and ray 1 of six
    points, returns = one_point(0.4 * math.cos(angle), 0.4 * math.sin(angle))
    result = tagd(points, returns, points, returns, num_groups=6)
    assert result.valid[:, 1].tolist() == [True, True, False, False, False, False]


def test_empty_groups_match_a_manual_example():
    points, returns = one_point(3.0, 0.0)
    none = torch.tensor([False])
    ahead, behind = tagd(points, returns, points, none, num_groups=2).tagd
    torch.testing.assert_close(ahead, torch.tensor([3.0, 0.0, 3.0, 0.0]))  # at rest
    torch.testing.assert_close(behind, torch.tensor([-MAX, 0.0, -MAX, 0.0]), atol=1e-6, rtol=0)


def test_maximum_range_points_are_in_no_group():
    points, returns = one_point(MAX, 0.0)
    assert not tagd(points, ~returns, points, ~returns).valid.any()


def test_points_that_are_no_returns_may_be_nan():
    points = torch.tensor([[1.0, 0.0], [math.nan, math.inf]])
    returns = torch.tensor([True, False])
    result = tagd(points, returns, points, returns)
    assert result.tagd.isfinite().all()


def test_previous_scan_may_have_another_number_of_points():
    now, before = random_scans(2, 0, num_points=60)[0], random_scans(2, 0, num_points=90)[0]
    assert tagd(now.points, now.returns, before.points, before.returns).tagd.shape == (2, 30, 4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": torch.zeros(5, 3)}, r"points: must have shape .*\(5, 3\)"),
        ({"returns": torch.ones(5)}, "returns: must be bool"),
        ({"previous_returns": torch.ones(4, dtype=torch.bool)}, "previous_returns"),
        ({"num_groups": 0}, "num_groups"),
        ({"empty_now": "current"}, "empty_now.*'current'"),
    ],
)
def test_bad_input_is_named(change, message):
    points, returns = torch.zeros(5, 2), torch.ones(5, dtype=torch.bool)
    arguments = {
        "points": points,
        "returns": returns,
        "previous_points": points,
        "previous_returns": returns,
    }
    with pytest.raises(ValueError, match=message):
        tagd(**{**arguments, **change})
