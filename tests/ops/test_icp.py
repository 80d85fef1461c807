"""ICP recovers known motions: exactly without noise, closely with it, in both directions."""

import math
from functools import partial

import pytest
import torch
from rooms import errors, sample_scan_pairs

from navrl.ops import se2
from navrl.ops.icp import _line_step, align
from navrl.ops.icp_options import PAPER, ROBUST, IcpOptions
from navrl.ops.lines import ScanLines, fit_lines
from navrl.ops.rigid_fit import fit_rigid
from navrl.ops.rotation_search import rotation_search


@pytest.fixture(autouse=True, params=["torch", "numba"])
def backend(request, monkeypatch):
    """Every test of this file holds for both implementations."""
    monkeypatch.setitem(globals(), "align", partial(align, backend=request.param))


def both_ways(pairs):
    """Yield (source, target, T_target_source) forwards and backwards."""
    yield pairs.source, pairs.target, pairs.T_target_source
    yield pairs.target, pairs.source, se2.inverse(pairs.T_target_source)


def run(source, target, options):
    return align(source.points, source.returns, target.points, target.returns, options)


@pytest.mark.parametrize(
    ("options", "success", "median_m", "median_deg"),
    [
        (PAPER, 0.93, 0.02, 0.5),
        (IcpOptions(initialization="rotation_search", gate=0.3), 0.97, 0.02, 0.5),
        (ROBUST, 0.98, 0.005, 0.12),
    ],
    ids=["paper", "rotation search", "robust"],
)
def test_recovers_the_motion_among_pedestrians(options, success, median_m, median_deg):
    """1,440 beams with 2.5 cm noise pooled to 180; turns to 36 deg, 0.2 m, two walkers."""
    for source, target, truth in both_ways(sample_scan_pairs(200, seed=2, beams_per_point=8)):
        result = run(source, target, options)
        position, rotation = errors(result.transform, truth)
        assert ((position < 0.1) & (rotation < 2.0)).float().mean() >= success
        assert position.median() <= median_m
        assert rotation.median() <= median_deg
        assert result.converged.float().mean() > 0.97


@pytest.mark.slow
def test_robust_is_accurate_with_up_to_eight_pedestrians():
    """95 % within 10 cm and 2 deg, median 0.5 cm and 0.1 deg, over rooms with none to eight."""
    found = []
    for count in range(9):
        pairs = sample_scan_pairs(100, seed=20 + count, beams_per_point=8, num_pedestrians=count)
        found.append(
            errors(run(pairs.source, pairs.target, ROBUST).transform, pairs.T_target_source)
        )
    position, rotation = (torch.cat(parts) for parts in zip(*found, strict=True))
    assert ((position < 0.1) & (rotation < 2.0)).float().mean() >= 0.95
    assert position.median() <= 0.005
    assert rotation.median() <= 0.1


def test_robust_alignment_of_180_single_beams():
    for source, target, truth in both_ways(sample_scan_pairs(200, seed=3)):
        position, rotation = errors(run(source, target, ROBUST).transform, truth)
        assert ((position < 0.1) & (rotation < 2.0)).float().mean() >= 0.97
        assert position.median() <= 0.01
        assert rotation.median() <= 0.2


@pytest.mark.parametrize("options", [PAPER, ROBUST], ids=["paper", "robust"])
def test_known_transform_of_the_same_points(options):
    """The same points moved by hand: the answer is exact, and its sign and direction are right."""
    target = sample_scan_pairs(20, seed=4, noise_std=0.0, num_pedestrians=0).target
    T_target_source = torch.tensor([0.05, -0.03, 0.06]).expand(20, 3)
    source_points = se2.transform_points(se2.inverse(T_target_source), target.points)
    result = align(source_points, target.returns, target.points, target.returns, options)
    position, rotation = errors(result.transform, T_target_source)
    assert position.median() < 1e-3
    assert rotation.median() < 0.05


@pytest.mark.parametrize("options", [PAPER, ROBUST], ids=["paper", "robust"])
def test_equal_scans_have_not_moved(options):
    scan = sample_scan_pairs(20, seed=5).source
    result = run(scan, scan, options)
    assert result.transform.abs().max() < 1e-6
    assert result.converged.all()
    assert result.iterations.max() <= 2
    assert (result.inliers == scan.returns.sum(-1)).all()
    assert result.rmse.max() < 1e-6


def test_maximum_range_points_reduce_accuracy():
    """Why returns are asked for: used as points, misses make it worse."""
    pairs = sample_scan_pairs(200, seed=6, beams_per_point=8)
    source, target = pairs.source, pairs.target
    every = torch.ones_like(source.returns)
    rates = []
    for source_returns, target_returns in ((every, every), (source.returns, target.returns)):
        result = align(source.points, source_returns, target.points, target_returns)
        position, rotation = errors(result.transform, pairs.T_target_source)
        rates.append(((position < 0.1) & (rotation < 2.0)).float().mean())
    assert rates[1] > rates[0] + 0.05


@pytest.mark.parametrize("options", [PAPER, ROBUST], ids=["paper", "robust"])
def test_too_few_points_is_the_identity_not_converged(options):
    points = torch.rand(2, 40, 2) + 0.5
    returns = torch.zeros(2, 40, dtype=torch.bool)
    returns[:, :9] = True
    result = align(points, returns, points + 0.1, returns, options)
    assert (result.transform == 0).all()
    assert not result.converged.any()
    assert (result.inliers <= 9).all()
    none = align(points, returns & False, points, returns & False, options)
    assert (none.transform == 0).all()
    assert not none.converged.any()
    assert (none.inliers == 0).all()


def test_failed_alignment_returns_the_identity():
    angle = torch.arange(9) * 0.1
    points = torch.zeros(180, 2)
    points[:9] = torch.stack([angle.cos(), angle.sin()], dim=-1) * (1.0 + angle.unsqueeze(-1))
    returns = torch.arange(180) < 9
    turned = align(points, returns, points.roll(7, 0), returns.roll(7), ROBUST)
    assert (turned.transform == 0).all()
    assert not turned.converged


def test_targets_without_return_are_not_matched():
    angle = torch.arange(12) * 0.5
    ring = torch.stack([angle.cos(), angle.sin()], dim=-1)
    real = torch.ones(24, dtype=torch.bool)
    source = torch.cat([0.5 * ring, 0.6 * ring])  # so near the robot that the origin is in the gate
    target = torch.cat([3.0 * ring, 0.5 * ring])
    result = align(source, real, target, torch.arange(24) < 12)
    assert result.inliers == 0
    assert not result.converged


def test_a_step_is_taken_in_the_target_frame():
    """Matches that are right from the start are solved in one step; the second finds no more."""
    angle = torch.arange(12) * (math.pi / 6)
    ranges = torch.tensor([1.0, 3, 2, 4, 1.5, 3.5, 2.5, 4.5, 1.2, 3.3, 2.2, 4.2])
    target = ranges.unsqueeze(-1) * torch.stack([angle.cos(), angle.sin()], dim=-1)
    truth = torch.tensor([0.12, -0.09, math.pi / 6])
    source = se2.transform_points(se2.inverse(truth), target).roll(-1, 0)  # by bearing
    real = torch.ones(12, dtype=torch.bool)
    result = align(source, real, target, real, IcpOptions(initialization="rotation_search"))
    torch.testing.assert_close(result.transform, truth, atol=1e-5, rtol=0)
    assert result.iterations == 2


def test_iteration_limit_is_respected_and_reported():
    pairs = sample_scan_pairs(30, seed=7)
    result = run(pairs.source, pairs.target, IcpOptions(max_iterations=2))
    assert result.iterations.max() == 2
    assert not result.converged.all()
    assert (result.transform[~result.converged] != 0).any(), "the best so far is kept"


def test_a_sample_does_not_depend_on_its_batch():
    pairs = sample_scan_pairs(24, seed=8, beams_per_point=4)
    whole = run(pairs.source, pairs.target, ROBUST)
    for row in (0, 11, 23):
        parts = [scan[row] for scan in (*pairs.source[1:], *pairs.target[1:])]
        alone = align(*parts, ROBUST)
        torch.testing.assert_close(alone.transform, whole.transform[row], atol=1e-5, rtol=0)
        assert alone.iterations == whole.iterations[row]


def test_points_that_are_no_returns_may_be_nan():
    pairs = sample_scan_pairs(10, seed=9)
    clean = run(pairs.source, pairs.target, ROBUST)
    source, target = (
        torch.where(scan.returns.unsqueeze(-1), scan.points, math.nan)
        for scan in (pairs.source, pairs.target)
    )
    dirty = align(source, pairs.source.returns, target, pairs.target.returns, ROBUST)
    torch.testing.assert_close(clean.transform, dirty.transform, rtol=0, atol=0)


def test_scans_may_have_different_numbers_of_points():
    source = sample_scan_pairs(10, seed=10, noise_std=0.0).source
    target = type(source)(*(part[:, ::2] for part in source))
    assert run(source, target, PAPER).transform.abs().max() < 0.05
    with pytest.raises(ValueError, match="180 and 90"):
        run(source, target, ROBUST)


def test_endless_corridor_is_well_posed():
    """Two parallel walls say nothing about motion along them; it must not run away."""
    x = torch.linspace(-3, 3, 90)
    points = torch.cat(
        [torch.stack([x, torch.ones(90)], -1), torch.stack([x.flip(0), -torch.ones(90)], -1)]
    )
    returns = torch.ones(180, dtype=torch.bool)
    truth = torch.tensor([0.0, 0.05, 0.02])
    source = se2.transform_points(se2.inverse(truth), points)
    result = align(source, returns, points, returns, IcpOptions(metric="point_to_line"))
    assert result.converged
    torch.testing.assert_close(result.transform[1:], truth[1:], atol=2e-3, rtol=0)
    assert result.transform[0].abs() < 0.05


def test_line_step_uses_points_along_lines():
    """Across a corridor's walls the lines decide; along them only the matched points can."""
    points = torch.tensor([[[x, y] for x in (-2.0, -1, 0, 1, 2) for y in (-1.0, 1.0)]])
    every = torch.ones(1, 10, dtype=torch.bool)
    lines = ScanLines(torch.tensor([0.0, 1.0]).expand(1, 10, 2), every)
    closest = points + torch.tensor([0.02, -0.03])
    step = _line_step(points, closest, every, lines, robust_scale=None)
    torch.testing.assert_close(step, torch.tensor([[0.02, -0.03, 0.0]]), atol=1e-4, rtol=0)


def test_closed_form_equals_svd():
    """Arun et al. 1987: R = V diag(1, det) U^T of the cross-covariance's SVD."""
    generator = torch.Generator().manual_seed(0)
    source = torch.randn(200, 12, 2, generator=generator, dtype=torch.float64)
    target = torch.randn(200, 12, 2, generator=generator, dtype=torch.float64)  # any, also mirrored
    weight = torch.rand(200, 12, generator=generator, dtype=torch.float64)
    fit = fit_rigid(source, target, weight)

    share = (weight / weight.sum(-1, keepdim=True)).unsqueeze(-1)
    source_mean, target_mean = (share * source).sum(1), (share * target).sum(1)
    a, b = source - source_mean.unsqueeze(1), target - target_mean.unsqueeze(1)
    u, _, vh = torch.linalg.svd((share * a).mT @ b)
    det = torch.linalg.det(vh.mT @ u.mT)
    assert (det < 0).any()
    assert (det > 0).any()
    middle = torch.diag_embed(torch.stack([torch.ones_like(det), det], dim=-1))
    rotation = vh.mT @ middle @ u.mT
    yaw = torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0])
    translation = target_mean - (rotation @ source_mean.unsqueeze(-1)).squeeze(-1)
    expected = torch.cat([translation, yaw.unsqueeze(-1)], dim=-1)
    torch.testing.assert_close(fit, expected)


def test_fit_without_points_is_the_identity():
    points = torch.rand(5, 2)
    assert (fit_rigid(points, points + 1.0, torch.zeros(5)) == 0).all()


@pytest.mark.parametrize("turn_deg", [-36, -14, 0, 8, 36])
def test_rotation_search_finds_an_in_place_rotation(turn_deg):
    scan = sample_scan_pairs(20, seed=11).source
    shift = turn_deg // 2  # 2 deg a point
    turned = (scan.points.roll(shift, 1), scan.returns.roll(shift, 1))
    yaw = rotation_search(scan.points, scan.returns, *turned)
    torch.testing.assert_close(yaw, torch.full((20,), math.radians(turn_deg)))


@pytest.mark.parametrize("turn_deg", [-36, -14, 8, 36])
@pytest.mark.parametrize("field_of_view_deg", [270, 180, 90])
def test_rotation_search_ignores_blind_sectors(turn_deg, field_of_view_deg):
    """What a turn brings into a blind sector is no reason against it."""
    scan = sample_scan_pairs(40, seed=12, num_pedestrians=0).source
    shift = turn_deg // 2
    bearing = (torch.arange(180) + 0.5) * (2 * math.pi / 180)
    seen = (bearing.cos() > math.cos(math.radians(field_of_view_deg / 2))).expand(40, -1)
    points = se2.rotate(scan.points, torch.tensor(math.radians(turn_deg)))
    turned = (points.roll(shift, 1), scan.returns.roll(shift, 1) & seen)
    scans = (scan.points, scan.returns & seen, *turned)
    options = IcpOptions(initialization="rotation_search", gate=0.02, min_pairs=2)
    found = {
        "alone": rotation_search(*scans, seen=seen),
        "aligned": align(*scans, options, seen=seen).transform[:, 2],
        "blind taken for free": rotation_search(*scans),
    }
    share = {
        name: (yaw - math.radians(turn_deg)).abs().lt(2e-3).float().mean().item()
        for name, yaw in found.items()
    }
    assert share["alone"] > 0.9 and share["aligned"] > 0.9  # a bare wall fits in several ways
    assert share["alone"] >= share["blind taken for free"]


def test_bearings_seen_must_fit_the_scan():
    scan = sample_scan_pairs(2, seed=12).source
    scans = (scan.points, scan.returns, scan.points, scan.returns)
    with pytest.raises(ValueError, match=r"seen: must be bool of shape \(2, 180\)"):
        align(*scans, seen=torch.ones(180, dtype=torch.bool))


def test_rotation_search_of_empty_scans_is_zero():
    points, returns = torch.zeros(3, 30, 2), torch.zeros(3, 30, dtype=torch.bool)
    assert (rotation_search(points, returns, points, returns) == 0).all()


def test_lines_of_a_square_room():
    scan = sample_scan_pairs(10, seed=12, noise_std=0.0, num_pedestrians=0).source
    lines = fit_lines(scan.points, scan.returns)
    assert lines.is_line.float().mean() > 0.5
    assert not lines.is_line[~scan.returns].any()
    following = scan.points.roll(-1, 1) - scan.points
    both = lines.is_line & lines.is_line.roll(-1, 1) & (following.norm(dim=-1) < 0.2)
    slide = (following * lines.normal).sum(-1).abs() / following.norm(dim=-1).clamp(min=1e-6)
    assert slide[both].median() < 0.01  # neighbors lie along the line


def test_lines_do_not_reach_across_a_gap():
    """A near wall before a far one: where one ends, its line does not bend to the other."""
    y = torch.linspace(-1, 1, 40)
    points = torch.stack([torch.where(y < 0, 1.0, 2.0), y], dim=-1)
    returns = torch.ones(40, dtype=torch.bool)
    lines = fit_lines(points, returns)
    ahead = slice(3, -3)  # the first and last points are neighbors across the scan's seam
    assert lines.is_line[ahead].all()
    torch.testing.assert_close(lines.normal[ahead, 0].abs(), torch.ones(34))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"source_points": torch.zeros(12, 3)}, r"source_points: .*\(12, 3\)"),
        ({"target_returns": torch.ones(12)}, "target_returns: must be bool"),
        ({"source_returns": torch.ones(11, dtype=torch.bool)}, "source_returns"),
        ({"target_points": torch.zeros(2, 12, 2)}, "target_"),
    ],
)
def test_bad_input_is_named(change, message):
    points, returns = torch.zeros(12, 2), torch.ones(12, dtype=torch.bool)
    arguments = {
        "source_points": points,
        "source_returns": returns,
        "target_points": points,
        "target_returns": returns,
    }
    with pytest.raises(ValueError, match=message):
        align(**{**arguments, **change})


def test_scans_larger_than_a_block_are_aligned_separately(monkeypatch):
    monkeypatch.setattr("navrl.ops.icp.PAIRS_PER_BLOCK", 1)
    source = torch.rand(3, 40, 2, generator=torch.Generator().manual_seed(0)) * 4.0 - 2.0
    returns = torch.ones(3, 40, dtype=torch.bool)
    found = align(source, returns, source + torch.tensor([0.05, 0.0]), returns)
    torch.testing.assert_close(
        found.transform, torch.tensor([[0.05, 0.0, 0.0]] * 3), atol=1e-3, rtol=0
    )
