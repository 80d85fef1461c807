"""Min-pooling against a plain loop, and what it does with readings that are none."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from navrl.ops.pooling import min_pool

MAX = 3.5
BACKENDS = ["torch", "numba"]


@given(
    st.integers(1, 6),
    st.integers(1, 9),
    st.integers(0, 10_000),
    st.sampled_from(["bin", "beam"]),
    st.sampled_from(BACKENDS),
)
def test_pooling_equals_a_loop(group_size, num_points, seed, bearing, backend):
    beams = group_size * num_points
    ranges = 4.0 * torch.rand(beams, generator=torch.Generator().manual_seed(seed)) + 1e-3
    pooled = min_pool(ranges, group_size, MAX, bearing, backend)
    for index in range(num_points):
        group = [min(ranges[index * group_size + k].item(), MAX) for k in range(group_size)]
        nearest = min(group)
        beam = index * group_size + (group_size - 1) / 2
        if bearing == "beam" and nearest < MAX:
            beam = index * group_size + group.index(nearest)
        angle = 2 * math.pi * beam / beams
        expected = torch.tensor([nearest * math.cos(angle), nearest * math.sin(angle)])
        torch.testing.assert_close(pooled.points[index], expected, atol=1e-5, rtol=0)
        assert pooled.ranges[index].item() == pytest.approx(nearest)
        assert pooled.returns[index].item() == (nearest < MAX)


def test_pooling_retains_near_obstacles():
    ranges = MAX * torch.rand(5, 1440).clamp(min=0.01)
    assert (min_pool(ranges).ranges.amin(-1) == ranges.amin(-1)).all()


@pytest.mark.parametrize("miss", [math.nan, math.inf, -math.inf, 0.0, -1.0, MAX, MAX + 1e-6, 99.0])
@pytest.mark.parametrize("backend", BACKENDS)
def test_bin_without_return_is_the_maximum_range(miss, backend):
    pooled = min_pool(torch.full((4,), miss), group_size=2, backend=backend)
    assert (pooled.ranges == MAX).all()
    assert not pooled.returns.any()
    assert pooled.points.isfinite().all()
    ranges = torch.tensor([1.0, miss, miss, 2.0])  # it leaves its neighbour's reading alone
    pooled = min_pool(ranges, group_size=2, backend=backend)
    assert pooled.ranges.tolist() == [1.0, 2.0]
    assert pooled.returns.all()


def test_a_hit_just_below_the_maximum_is_a_return():
    assert min_pool(torch.full((8,), MAX - 1e-3)).returns.all()


def test_first_bin_looks_ahead_and_bins_turn_left():
    points = min_pool(torch.ones(1440)).points
    assert points[0, 0] > 0.99
    assert points[45, 1] > 0.99
    assert points[90, 0] < -0.99


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)])
def test_any_batch_shape(shape):
    pooled = min_pool(torch.rand(*shape, 16), group_size=4)
    assert pooled.ranges.shape == (*shape, 4)
    assert pooled.points.shape == (*shape, 4, 2)
    assert pooled.points.dtype == torch.float32


@pytest.mark.parametrize(
    ("shape", "group_size", "message"),
    [
        ((2, 10), 3, "10 beams, group_size 3"),
        ((), 1, r"shape \[\*B, beams\]"),
        ((4, 0), 1, r"shape \[\*B, beams\]"),
        ((8,), -2, "group_size.*-2"),
    ],
)
def test_bad_input_is_named(shape, group_size, message):
    with pytest.raises(ValueError, match=message):
        min_pool(torch.ones(shape), group_size)


@pytest.mark.parametrize("backend", ["torch", "numba"])
def test_float64_ranges_keep_their_digits(backend):
    ranges = torch.tensor([1.0 + 1e-12, 2.0, 3.0 - 1e-12, 3.4], dtype=torch.float64)
    pooled = min_pool(ranges, group_size=2, backend=backend)
    assert pooled.ranges.tolist() == [1.0 + 1e-12, 3.0 - 1e-12]
    assert pooled.points.dtype == torch.float64
