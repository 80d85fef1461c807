"""Forms of operators for an exported graph equal those of torch, and align those of the kernel."""

import math

import pytest
import torch
from aligned_scans import Aligned, scans
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from navrl.ops import exporting, se2
from navrl.ops.icp_graph import Tables, rigid_step, step_matrix
from navrl.ops.icp_options import PAPER, ROBUST
from navrl.ops.icp_pairs import nearest_by_product, nearest_returns
from navrl.ops.path import point_at, project_onto_path
from navrl.ops.rigid_fit import fit_rigid


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=40))
def test_doubled_minimum_is_the_cumulative_minimum(values):
    values = torch.tensor([values, values[::-1]], dtype=torch.float64)
    assert torch.equal(exporting.doubled_minimum(values), values.cummin(dim=-1).values)


@given(st.lists(st.sampled_from([0.0, 1.0, 2.0, math.inf]), min_size=1, max_size=40))
def test_minimum_of_blocks_is_the_first_smallest(values):
    rows = torch.tensor([values, values[::-1]])
    assert torch.equal(exporting.first_minimum(rows), rows.argmin(-1))


def test_elimination_solves_the_normal_equations(generator):
    factors = torch.rand(20, 3, 3, generator=generator, dtype=torch.float64)
    matrix = factors @ factors.mT + 1e-3 * torch.eye(3)
    vector = torch.rand(20, 3, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(
        exporting.eliminate(matrix, vector), torch.linalg.solve(matrix, vector)
    )


def test_product_finds_the_nearest_returns(generator):
    points = 3.5 * torch.rand(8, 50, 2, generator=generator, dtype=torch.float64)
    target = 3.5 * torch.rand(8, 40, 2, generator=generator, dtype=torch.float64)
    returns = torch.rand(8, 40, generator=generator) < 0.7
    returns[0] = False
    squared, index = nearest_by_product(points, target, returns)
    expected, expected_index = nearest_returns(points, target, returns)
    torch.testing.assert_close(squared, expected)
    assert torch.equal(index[1:], expected_index[1:])
    assert squared[0].isinf().all()


def test_product_gives_the_rigid_fit(generator):
    source = 3.5 * torch.rand(8, 50, 2, generator=generator, dtype=torch.float64)
    target = 3.5 * torch.rand(8, 50, 2, generator=generator, dtype=torch.float64)
    weight = (torch.rand(8, 50, generator=generator) < 0.5).double()
    weight[0] = 0.0
    ones = torch.ones(8, 50, 1, dtype=torch.float64)
    rows = [torch.cat([points, ones], dim=-1) for points in (source, target)]
    tables = Tables.like(source)
    step, pairs = rigid_step(*rows, weight.unsqueeze(-1), tables)
    expected = fit_rigid(source, target, weight)
    yaw = torch.atan2(step[:, 0, 1], step[:, 0, 0])
    torch.testing.assert_close(torch.cat([step[:, 0, 2:], yaw[:, None]], -1), expected)
    torch.testing.assert_close(pairs.flatten(), weight.sum(-1))
    moved = (rows[0] @ step_matrix(step, tables))[..., :2]
    torch.testing.assert_close(moved, se2.transform_points(expected, source))


def test_rows_are_taken_per_scan(generator):
    values = torch.rand(3, 5, 2, generator=generator)
    index = torch.tensor([[0, 4], [2, 2], [1, 3]])
    expected = torch.stack([scan[own] for scan, own in zip(values, index, strict=True)])
    assert torch.equal(exporting.take_rows(values, index), expected)


@pytest.mark.slow
@pytest.mark.parametrize("options", [PAPER, ROBUST], ids=["paper", "robust"])
def test_exported_alignment_equals_the_kernel(options, generator):
    inputs = scans(generator)
    batch = {0: torch.export.Dim("batch", min=1)}
    module = Aligned(options)
    with torch.no_grad():
        program = torch.export.export(module, inputs, dynamic_shapes=(batch,) * 3, strict=False)
        exported = program.module()
        for rows in (slice(0, 4), slice(0, 1)):
            part = [value[rows] for value in inputs]
            transform, *flags = exported(*part)
            expected, *expected_flags = module(*part)
            torch.testing.assert_close(transform, expected, atol=1e-6, rtol=0.0)
            assert all(map(torch.equal, flags, expected_flags))
    assert transform[0].abs().max() > 0.01


class Projected(nn.Module):
    def forward(self, path, position, previous):
        found = project_onto_path(path, position, previous)
        return found.progress, found.distance, point_at(path, found.progress + 0.3)


def test_exported_projection_equals_the_kernel(generator):
    along = torch.linspace(0.0, 6.0, 40, dtype=torch.float64)
    path = torch.stack([along, (2.0 * along).sin()], dim=-1).repeat(5, 1, 1)
    position = path[:, 10] + 0.2 * torch.rand(5, 2, generator=generator, dtype=torch.float64)
    previous = torch.linspace(1.0, 2.5, 5, dtype=torch.float64)
    inputs = (path, position, previous)
    batch = {0: torch.export.Dim("batch", min=1)}
    with torch.no_grad():
        program = torch.export.export(
            Projected(), inputs, dynamic_shapes=(batch,) * 3, strict=False
        )
        exported = program.module()(*inputs)
        torch.testing.assert_close(exported, Projected()(*inputs), atol=1e-9, rtol=0.0)
