"""The quality of an alignment, and odometry that holds what a corridor leaves free."""

from functools import partial

import pytest
import torch
from rooms import corridor_pairs, errors, sample_scan_pairs

from navrl.ops import se2
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST
from navrl.ops.icp_quality import align_from_prior, alignment_quality

ODOMETRY = torch.tensor([0.01, 0.002, 0.01])  # m, m, rad, standard deviation of a step's error


@pytest.fixture(params=["torch", "numba"])
def backend(request):
    return request.param


def scans_of(pairs):
    return (*pairs.source[1:], *pairs.target[1:])


def odometry(pairs, scale=1.0):
    generator = torch.Generator().manual_seed(2)
    noise = torch.randn(pairs.T_target_source.shape, generator=generator)
    return se2.compose(pairs.T_target_source, scale * ODOMETRY * noise)


def test_walker_in_a_corridor_misleads_icp_without_prior(backend):
    pairs = corridor_pairs()
    for options in (PAPER, ROBUST):
        result = align(*scans_of(pairs), options, backend=backend)
        position, _ = errors(result.transform, pairs.T_target_source)
        assert (position > 0.03).float().mean() > 0.8
        assert result.converged.all()  # which is no measure of quality


@pytest.mark.parametrize("options", [PAPER, ROBUST], ids=["paper", "robust"])
def test_prior_holds_the_direction_along_a_corridor(options, backend):
    pairs = corridor_pairs()
    prior = odometry(pairs)
    result = align_from_prior(prior, *scans_of(pairs), options, backend=backend)
    position, rotation = errors(result.transform, pairs.T_target_source)
    assert (position > 0.03).float().mean() < 0.05
    assert rotation.max() < 2.0
    free = align_from_prior(prior, *scans_of(pairs), options, 0.0, backend=backend)
    position, _ = errors(free.transform, pairs.T_target_source)
    assert (position > 0.03).float().mean() > 0.5


def test_scans_correct_the_prior_across_a_corridor(backend):
    """The prior is 0.08 m off across and 0.05 rad in yaw, and right along the corridor."""
    pairs = corridor_pairs()
    along_world = torch.zeros(len(pairs.T_target_source), 3)
    error = torch.tensor([0.0, 0.0, 0.05]).expand_as(along_world)
    prior = se2.compose(pairs.T_target_source, error)
    result = align_from_prior(prior, *scans_of(pairs), ROBUST, backend=backend)
    _, rotation = errors(result.transform, pairs.T_target_source)
    assert rotation.median() < 0.5  # of 2.9 deg


def test_backends_agree_from_a_prior():
    pairs = sample_scan_pairs(30, seed=7)
    scans = [part.double() if part.is_floating_point() else part for part in scans_of(pairs)]
    run = partial(align_from_prior, odometry(pairs).double(), *scans, ROBUST)
    kernel, oracle = run(backend="numba"), run(backend="torch")
    same = (kernel.transform - oracle.transform).abs().amax(-1) < 1e-6
    assert same.all()
    assert torch.equal(kernel.inliers, oracle.inliers)


def test_failed_alignment_returns_the_prior(backend):
    points, returns = torch.zeros(1, 20, 2), torch.zeros(1, 20, dtype=torch.bool)
    prior = torch.tensor([[0.1, 0.0, 0.2]])
    result = align_from_prior(prior, points, returns, points, returns, PAPER, backend=backend)
    torch.testing.assert_close(result.transform, prior)
    assert not result.converged.any()


def test_eigenvalues_distinguish_rooms_from_corridors():
    pairs = sample_scan_pairs(100, seed=2, beams_per_point=8)
    rooms = alignment_quality(pairs.T_target_source, *scans_of(pairs), ROBUST)
    assert (rooms.eigenvalues[:, 0] > 0.1).float().mean() > 0.95
    pairs = corridor_pairs()
    corridor = alignment_quality(pairs.T_target_source, *scans_of(pairs), ROBUST)
    assert (corridor.eigenvalues[:, 0] < 0.1).float().mean() > 0.9
    assert (corridor.eigenvalues[:, 1] > 0.2).all()
    free = corridor.eigenvectors[:, :, 0]  # along the corridor, in the robot's present frame
    assert free[:, 2].abs().median() < 0.2
    assert (rooms.inlier_share > 0.8).float().mean() > 0.95
    assert rooms.rms.median() == pytest.approx(0.02, abs=0.005)


def test_eigenvalues_of_a_square_room_are_its_shares():
    """Two of four walls constrain each translation."""
    side = torch.linspace(-1.0, 1.0, 401)[:-1]  # few of the points are beside a corner
    one = torch.ones_like(side)
    walls = [(one, side), (-side, one), (-one, -side), (side, -one)]
    room = torch.cat([torch.stack(wall, dim=-1) for wall in walls])
    returns = torch.ones(len(room), dtype=torch.bool)
    found = alignment_quality(torch.zeros(3), room, returns, room, returns, ROBUST)
    assert found.eigenvalues[1:].tolist() == pytest.approx([0.5, 0.5], abs=0.02)
    # levers of a wall are uniform in -1..1: mean square 1/3, of a mean square distance of 4/3
    assert float(found.eigenvalues[0]) == pytest.approx(0.25, abs=0.02)
    assert float(found.length) == pytest.approx((4 / 3) ** 0.5, abs=0.02)


def test_wrong_alignment_has_few_inliers():
    pairs = sample_scan_pairs(50, seed=3)
    wrong = se2.compose(pairs.T_target_source, torch.tensor([0.2, 0.1, 0.3]).expand(50, 3))
    right = alignment_quality(pairs.T_target_source, *scans_of(pairs), ROBUST)
    found = alignment_quality(wrong, *scans_of(pairs), ROBUST)
    assert (found.inlier_share < right.inlier_share - 0.1).all()
    assert (found.inlier_share < 0.8).float().mean() > 0.95


def test_quality_without_returns_is_zero():
    points, returns = torch.full((2, 8, 2), torch.nan), torch.zeros(2, 8, dtype=torch.bool)
    found = alignment_quality(torch.zeros(2, 3), points, returns, points, returns, PAPER)
    for value in (found.inlier_share, found.rms, found.eigenvalues):
        assert (value == 0).all()
