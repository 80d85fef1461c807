"""Projection and interpolation on a path against brute force, and where paths are awkward."""

import math

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from navrl.ops.path import path_length, point_at, project_onto_path
from navrl.ops.path_search import LEAVING_RATIO

BACKENDS = ["torch", "numba"]
backends = st.sampled_from(BACKENDS)


def random_path(seed, batch=(), num_points=20):
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randn(*batch, num_points, 2, generator=generator, dtype=torch.float64)
    return 0.2 * steps.cumsum(-2), generator


@given(st.integers(0, 10_000), backends)
def test_projection_is_the_nearest_point(seed, backend):
    path, generator = random_path(seed)
    position = torch.randn(2, generator=generator, dtype=torch.float64)
    progress, distance = project_onto_path(path, position, backend=backend)
    arcs = torch.linspace(0, path_length(path).item(), 5000, dtype=torch.float64)
    dense = point_at(path, arcs, backend)
    nearest = (dense - position).norm(dim=-1).min()
    assert distance <= nearest + 1e-9
    assert distance > nearest - 5e-3
    on_path = point_at(path, progress)
    torch.testing.assert_close((on_path - position).norm(), distance)


@given(
    st.integers(0, 10_000),
    st.floats(0.0, 1.2),
    st.floats(0.05, 2.0),
    st.floats(0.0, 1.0),
    backends,
)
def test_search_window_is_respected(seed, fraction, ahead, behind, backend):
    path, generator = random_path(seed)
    total = path_length(path)
    previous = fraction * total
    position = torch.randn(2, generator=generator, dtype=torch.float64)
    progress, distance = project_onto_path(path, position, previous, ahead, behind, backend)
    start = torch.minimum(previous, total)
    low, high = (start - behind).clamp(min=0), torch.minimum(start + ahead, total)
    assert low - 1e-9 <= progress <= high + 1e-9
    arcs = torch.linspace(low.item(), high.item(), 3000, dtype=torch.float64)
    dense = (point_at(path, arcs) - position).norm(dim=-1)
    ratio = dense / torch.where(arcs >= start, dense, math.inf).cummin(-1).values
    assume(not ((ratio - LEAVING_RATIO).abs() < 0.02).any())  # the samples decide it otherwise
    left = (ratio > LEAVING_RATIO).cumsum(-1) > 0  # from there on the path is another branch
    nearest = dense[~left].min()
    assert distance <= nearest + 1e-9
    assert distance > nearest - 5e-3


@given(st.integers(0, 10_000), backends)
def test_progress_never_decreases(seed, backend):
    path, generator = random_path(seed, batch=(20,), num_points=5)
    path = path.float()
    progress = torch.zeros(20)
    for _ in range(10):
        position = torch.randn(20, 2, generator=generator)
        following, distance = project_onto_path(path, position, progress, backend=backend)
        assert (following >= progress).all()
        assert distance.isfinite().all()  # also where the whole path lies behind
        progress = following


def figure_of_eight(num_points=400):
    t = torch.linspace(0, 2 * math.pi, num_points)
    return torch.stack([2 * t.sin(), (2 * t).sin()], dim=-1)  # crosses itself at the origin


@pytest.mark.parametrize("backend", BACKENDS)
def test_does_not_jump_where_the_path_crosses_itself(backend):
    path = figure_of_eight()
    total = path_length(path)
    progress, lateral = torch.tensor(0.0), torch.tensor([0.03, -0.02])
    for arc in torch.arange(0.0, total.item(), 0.2):
        progress, _ = project_onto_path(
            path, point_at(path, arc) + lateral, progress, backend=backend
        )
        assert (progress - arc).abs() < 0.1
    aside = torch.tensor([0.02, 0.02])  # halfway, beside the crossing, on the other branch
    kept = project_onto_path(path, aside, total / 2 - 0.2, backend=backend).progress
    assert (kept - total / 2).abs() < 0.1
    assert project_onto_path(path, aside).progress < 0.1  # without the window it does jump


def hairpin(width, depth=2.0):
    """Return a U: up along y, ``width`` to the right, and down again."""
    corners = torch.tensor([[0.0, 0.0], [0.0, depth], [width, depth], [width, 0.0]])
    arcs = torch.linspace(0.0, 2.0 * depth + width, 150)
    return point_at(corners, arcs)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("width", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_does_not_jump_to_the_other_leg_of_a_hairpin(backend, width, dtype):
    """A robot beside its leg, nearer to the other one, stays on its leg until the bend."""
    path, progress = hairpin(width).to(dtype), torch.tensor(0.0, dtype=dtype)
    for y in torch.arange(0.0, 2.0 - 0.75 * width, 0.05):
        position = torch.tensor([0.6 * width, y], dtype=dtype)
        progress, _ = project_onto_path(path, position, progress, backend=backend)
        assert abs(progress - y) < 0.02
    for angle in torch.linspace(0.0, math.pi, 30):  # around the bend
        center = torch.tensor([0.5 * width, 2.0 - 0.5 * width], dtype=dtype)
        around = torch.stack([-angle.cos(), angle.sin()]).to(dtype)
        position = center + 0.5 * width * around
        progress, _ = project_onto_path(path, position, progress, backend=backend)
    assert abs(progress - (2.0 + 1.5 * width)) < 0.03


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("bend", [30.0, 60.0, 90.0, 120.0])
def test_progress_passes_a_skipped_corner(backend, bend):
    """The robot leaves the first leg 0.5 m before the corner, straight to the second."""
    angle = math.radians(bend)
    end = torch.tensor([1.0 + math.cos(angle), math.sin(angle)])
    path = torch.stack([torch.zeros(2), torch.tensor([1.0, 0.0]), end])
    begin, goal = point_at(path, torch.tensor([0.5, 1.5]))
    progress = torch.tensor(0.5)
    for share in torch.linspace(0.0, 1.0, 11):
        position = torch.lerp(begin, goal, share)
        progress, _ = project_onto_path(path, position, progress, backend=backend)
    assert progress == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize("backend", BACKENDS)
def test_large_coordinates_keep_their_digits(backend):
    """Also if only one of the two is in float64."""
    path, generator = random_path(3, batch=(8,))
    position = path[:, 4] + 0.1 * torch.randn(8, 2, generator=generator, dtype=torch.float64)
    shift = torch.tensor([5e5, 5.6e6], dtype=torch.float64)
    before = torch.rand(8, generator=generator)
    near = project_onto_path(path, position, before, backend=backend)
    far = project_onto_path(path + shift, position + shift, before, backend=backend)
    torch.testing.assert_close(far, near, atol=1e-6, rtol=0)
    rounded = (position + shift).float()
    mixed = project_onto_path(path + shift, rounded, before, backend=backend)
    exact = project_onto_path(path, rounded.double() - shift, before, backend=backend)
    torch.testing.assert_close(mixed, exact, atol=1e-6, rtol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_integer_paths_have_fractional_results(backend):
    """In millimeters."""
    path = torch.tensor([[0, 0], [1000, 333], [2000, 1000]])
    position = torch.tensor([501, 100])
    ours = project_onto_path(path, position, backend=backend)
    expected = project_onto_path(path.float(), position.float(), backend="torch")
    torch.testing.assert_close(ours, expected)
    arcs = torch.tensor([7, 500, 1500])
    points = point_at(path, arcs, backend)
    torch.testing.assert_close(points, point_at(path.float(), arcs.float(), "torch"))
    assert points.is_floating_point() and path_length(path).is_floating_point()


@pytest.mark.parametrize("backend", BACKENDS)
def test_point_at_follows_the_polyline(backend):
    path = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    arcs = torch.tensor([-1.0, 0.0, 0.25, 1.0, 2.0, 3.0, 9.0])
    expected = [[0, 0], [0, 0], [0.25, 0], [1, 0], [1, 1], [1, 2], [1, 2]]
    torch.testing.assert_close(
        point_at(path, arcs, backend), torch.tensor(expected, dtype=torch.float32)
    )
    torch.testing.assert_close(point_at(path, arcs[2], backend), torch.tensor([0.25, 0.0]))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("repeats", [1, 50])
def test_padding_with_the_goal_has_no_effect(repeats, backend):
    path, generator = random_path(7, batch=(16,))
    padded = torch.cat([path, path[:, -1:].expand(-1, repeats, -1)], dim=1)
    position = torch.randn(16, 2, generator=generator, dtype=torch.float64)
    previous = torch.linspace(0, 2, 16).double() * path_length(path)
    for start in (None, previous):
        plain = project_onto_path(path, position, start, backend=backend)
        same = project_onto_path(padded, position, start, backend=backend)
        torch.testing.assert_close(plain, same)
    arcs = torch.linspace(0, 1.2, 16).double() * path_length(path)
    torch.testing.assert_close(point_at(path, arcs, backend), point_at(padded, arcs, backend))
    torch.testing.assert_close(path_length(path), path_length(padded))


@pytest.mark.parametrize("backend", BACKENDS)
def test_path_of_one_repeated_point(backend):
    path = torch.ones(5, 2)
    progress, distance = project_onto_path(path, torch.zeros(2), torch.tensor(3.0), backend=backend)
    assert progress == 0.0
    assert distance == pytest.approx(math.sqrt(2))
    assert (point_at(path, torch.tensor([0.0, 1.0]), backend) == 1.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
def test_any_batch_shape(batch, backend):
    path, _ = random_path(0, batch)
    progress, distance = project_onto_path(path, torch.zeros(*batch, 2).double(), backend=backend)
    assert progress.shape == distance.shape == batch
    assert point_at(path, progress, backend).shape == (*batch, 2)
    assert point_at(path, progress.unsqueeze(-1).expand(*batch, 4), backend).shape == (*batch, 4, 2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: project_onto_path(path[:1], torch.zeros(2)), "P >= 2"),
        (lambda path: project_onto_path(path, torch.zeros(3)), "position"),
        (lambda path: project_onto_path(path, torch.zeros(5, 2)), "position.*batch"),
        (lambda path: project_onto_path(path, torch.zeros(2), None, 0.0), "ahead.*0.0"),
        (lambda path: project_onto_path(path, torch.zeros(2), None, 1.0, -1.0), "behind.*-1"),
        (lambda path: point_at(path, torch.zeros(1, 2)), "arc: must have shape"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(torch.rand(4, 2))


@pytest.mark.parametrize("seed", range(5))
def test_kernels_equal_the_reference(seed):
    generator = torch.Generator().manual_seed(seed)
    path = torch.randn(64, 60, 2, generator=generator).mul(0.1).cumsum(1)
    path[:, 40:] = path[:, 40:41]  # padded with the goal
    position = path[:, 10] + 0.3 * torch.randn(64, 2, generator=generator)
    previous = 3 * torch.rand(64, generator=generator)
    for before in (None, previous):
        for ahead, behind in ((1.0, 0.0), (0.5, 0.3)):
            args = (path, position, before, ahead, behind)
            fast = project_onto_path(*args, backend="numba")
            slow = project_onto_path(*args, backend="torch")
            torch.testing.assert_close(fast.distance, slow.distance, atol=1e-4, rtol=0)
            # Two stretches can be equally near; then any of them is right.
            same = (fast.progress - slow.progress).abs() < 1e-3
            assert same.float().mean() > 0.95
    arc = 6 * torch.rand(64, 7, generator=generator) - 0.5
    torch.testing.assert_close(
        point_at(path, arc, "numba"), point_at(path, arc, "torch"), atol=1e-4, rtol=0
    )
