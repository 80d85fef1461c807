"""Transforms of the plane against homogeneous matrices."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from navrl.ops import se2

angles = st.floats(-50.0, 50.0)
transforms = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9)).map(
    lambda values: torch.tensor(values, dtype=torch.float64)
)


def matrix(transform: torch.Tensor) -> torch.Tensor:
    x, y, yaw = transform.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    return torch.tensor([[cos, -sin, x], [sin, cos, y], [0, 0, 1]], dtype=torch.float64)


@given(transforms, transforms)
def test_compose_is_the_matrix_product(T_a_b, T_b_c):
    T_a_c = se2.compose(T_a_b, T_b_c)
    torch.testing.assert_close(matrix(T_a_c), matrix(T_a_b) @ matrix(T_b_c))
    assert -math.pi < T_a_c[2] <= math.pi + 1e-12


@given(transforms)
def test_inverse_composes_to_the_identity(T_a_b):
    identity = se2.compose(T_a_b, se2.inverse(T_a_b))
    torch.testing.assert_close(identity, torch.zeros_like(identity), atol=1e-12, rtol=0)


@given(transforms, transforms)
def test_relative_of_two_poses(T_w_a, T_w_b):
    T_a_b = se2.relative(T_w_a, T_w_b)
    torch.testing.assert_close(matrix(T_w_a) @ matrix(T_a_b), matrix(T_w_b))


@given(transforms)
def test_transform_points_equals_the_matrix_product(T_a_b):
    points = torch.tensor([[0.3, -2.0], [1.0, 0.0]], dtype=torch.float64)
    homogeneous = torch.cat([points, torch.ones(2, 1, dtype=torch.float64)], dim=-1)
    expected = (matrix(T_a_b) @ homogeneous.T).T[:, :2]
    torch.testing.assert_close(se2.transform_points(T_a_b, points), expected)


@given(angles)
def test_wrap_angle_keeps_the_direction(angle):
    wrapped = se2.wrap_angle(torch.tensor(angle, dtype=torch.float64)).item()
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_a_quarter_turn_is_counter_clockwise():
    turned = se2.rotate(torch.tensor([1.0, 0.0]), torch.tensor(math.pi / 2))
    torch.testing.assert_close(turned, torch.tensor([0.0, 1.0]))


def test_wrap_angle_maps_minus_pi_to_pi():
    seam = torch.tensor([math.pi, -math.pi], dtype=torch.float64)
    torch.testing.assert_close(se2.wrap_angle(seam), torch.full_like(seam, math.pi))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_transform_points_broadcasts_over_rows(dtype):
    """The first is a kernel's work, the second torch's; to the last bit."""
    generator = torch.Generator().manual_seed(3)
    motion = torch.rand(7, 3, generator=generator).to(dtype) * 6 - 3
    points = torch.rand(7, 180, 2, generator=generator).to(dtype) * 7 - 3.5
    row_by_row = se2.transform_points(motion, points)
    assert row_by_row.dtype == dtype
    broadcast = torch.stack([se2.transform_points(motion, points[n])[n] for n in range(7)])
    assert torch.equal(row_by_row, broadcast)
