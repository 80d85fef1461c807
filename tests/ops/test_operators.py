"""Kernels as operators of torch.library: compiled and mapped results equal eager ones."""

import math

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from navrl.ops import icp, se2
from navrl.ops.grouping import tagd
from navrl.ops.icp_options import IcpOptions
from navrl.ops.kernels import grouping, noise, operators, path, pooling, rays
from navrl.ops.kernels import icp as icp_kernels
from navrl.ops.kernels import se2 as se2_kernels
from navrl.ops.noise import noise_table
from navrl.ops.path import point_at, project_onto_path
from navrl.ops.pooling import min_pool
from navrl.ops.raycast import beam_directions, beam_grid
from navrl.transforms import TAGD, ICPAlign, MinPool

NAMES = {"pool", "align_scans", "describe_groups", "project_rows", "points_at"}
NAMES |= {"transform_rows", "add_noise", "cast_rows"}


def random(*shape, low=0.0, high=1.0, seed=0):
    drawn = torch.rand(shape, generator=torch.Generator().manual_seed(seed))
    return drawn * (high - low) + low


def pooled(count, shift=0.0):
    return min_pool(random(count, 96, high=4.0) + shift, 8)


def arguments(name):
    """Return small arguments of an operator."""
    now, before = pooled(2), pooled(2, shift=0.02)
    scans = (before.points, before.returns, now.points, now.returns)
    ways = random(2, 5, 2, high=9.0)
    limits = [1.05, math.inf, 1e-4, 3.5e-3, 0.7]
    return {
        "pool": (random(2, 24, high=4.0), 3, random(3, 2), 3.5, "bin"),
        "align_scans": (*scans, None, "identity", "point_to_point", limits, 20, 3),
        "describe_groups": (*scans, 6, 0.25, 3.5, "center", "current", "groups"),
        "project_rows": (ways, random(2, 2), random(2), 2.0, 0.5),
        "points_at": (ways, random(2, 3, high=5.0)),
        "transform_rows": (now.points, random(2, 3)),
        "add_noise": (
            random(2, 8, high=3.0),
            torch.tensor([7, 8]),
            torch.tensor([0, 3]),
            noise_table("gaussian", 0.01),
            3.5,
        ),
        "cast_rows": (
            random(2, 3).double(),
            random(2, 4, 5, low=1.0, high=2.0).double(),
            torch.tensor([4, 2]),
            beam_directions(8, 0.0, None),
            list(beam_grid(8, 0.0, None)),
            3.5,
        ),
    }[name]


def function(name):
    modules = (pooling, icp_kernels, grouping, path, se2_kernels, noise, rays)
    return next(getattr(module, name) for module in modules if hasattr(module, name))


@pytest.mark.parametrize("name", sorted(NAMES))
def test_operator_has_correct_schema_and_shapes(name):
    torch.library.opcheck(getattr(torch.ops.navrl, name).default, arguments(name))


@pytest.mark.parametrize("name", sorted(NAMES))
def test_operator_equals_its_function(name):
    given = arguments(name)
    eager, operator = function(name)(*given), getattr(torch.ops.navrl, name)(*given)
    tensors = (eager,) if isinstance(eager, torch.Tensor) else eager
    others = (operator,) if isinstance(operator, torch.Tensor) else operator
    assert len(tensors) == len(others)
    for one, other in zip(tensors, others, strict=True):
        assert torch.equal(one, other)


def test_eager_calls_do_not_dispatch_an_operator():
    called = []

    class Record(TorchDispatchMode):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            called.append(str(func))
            return func(*args, **(kwargs or {}))

    assert not operators.is_traced()
    with Record():
        min_pool(random(2, 24), 8)
    assert called and not [name for name in called if name.startswith("navrl.")]


class Perception(torch.nn.Module):
    """Pooling, alignment and grouping of scans and the previous points."""

    def __init__(self):
        super().__init__()
        self.pool, self.icp, self.tagd = MinPool(8), ICPAlign(), TAGD()

    def forward(self, ranges, points_previous, returns_previous):
        pooled, points, returns = self.pool.map_values(ranges)
        aligned = self.icp.map_values(points_previous, returns_previous, points, returns)
        groups = self.tagd.map_values(points, returns, aligned[0], returns_previous)
        return pooled, points, returns, *aligned, *groups


def compiled(module, *inputs, backend=None):
    """Return the results of the one compiled graph, and the names of navrl's operators in it."""
    found = []

    def graph_only(graph, _):
        found.extend(str(node.target) for node in graph.graph.nodes)
        return graph.forward

    torch.compiler.reset()
    results = torch.compile(module, backend=backend or graph_only, fullgraph=True)(*inputs)
    return results, [name for name in found if name.startswith("navrl.")]


def test_compiled_pipeline_is_one_graph_of_kernels():
    inputs = (random(4, 1440, high=4.0), *min_pool(random(4, 1440, high=4.0) + 0.02, 8)[1:])
    eager = Perception()(*inputs)
    results, kernels = compiled(Perception(), *inputs)
    wanted = ["pool", "align_scans", "transform_rows", "describe_groups"]
    assert [name.split(".")[1] for name in kernels] == wanted
    for one, other in zip(eager, results, strict=True):
        assert torch.equal(one, other)


@pytest.mark.slow
def test_pipeline_compiled_by_inductor_is_bit_equal():
    inputs = (random(4, 1440, high=4.0), *min_pool(random(4, 1440, high=4.0) + 0.02, 8)[1:])
    results, _ = compiled(Perception(), *inputs, backend="inductor")
    for one, other in zip(Perception()(*inputs), results, strict=True):
        assert torch.equal(one, other)


def test_compiled_inputs_with_gradients_use_torch():
    ranges = random(2, 24, low=0.5, high=3.0).requires_grad_()
    results, kernels = compiled(lambda scan: min_pool(scan, 8).points, ranges)
    assert kernels == []
    results.sum().backward()
    assert ranges.grad.abs().sum() > 0


def functions():
    now, before = pooled(6), pooled(6, shift=0.02)
    search = IcpOptions(initialization="rotation_search", metric="point_to_line")
    scans = (before.points, before.returns, now.points, now.returns)
    ways = random(6, 5, 2, high=9.0)
    return {
        "min_pool": (lambda scan: min_pool(scan, 8), (random(6, 96, high=4.0),)),
        "align": (icp.align, scans),
        "align_search": (lambda *scan: icp.align(*scan, search), scans),
        "tagd": (tagd, scans),
        "transform": (se2.transform_points, (random(6, 3), now.points)),
        "project": (project_onto_path, (ways, random(6, 2))),
        "point_at": (point_at, (ways, random(6, 3, high=5.0))),
    }


@pytest.mark.parametrize("name", sorted(functions()))
def test_vmap_equals_the_batch(name):
    mapped, inputs = functions()[name]
    whole, parts = mapped(*inputs), torch.vmap(mapped)(*inputs)
    whole = (whole,) if isinstance(whole, torch.Tensor) else whole
    parts = (parts,) if isinstance(parts, torch.Tensor) else parts
    for one, other in zip(whole, parts, strict=True):
        assert torch.equal(one, other)


def test_vmap_accepts_shared_and_moved_inputs():
    now, before = pooled(6), pooled(6, shift=0.02)
    scans = (before.points.movedim(0, 2), before.returns, now.points[0], now.returns[0])
    parts = torch.vmap(icp.align, in_dims=(2, 0, None, None))(*scans)
    target = (now.points[:1].expand(6, -1, -1), now.returns[:1].expand(6, -1))
    whole = icp.align(before.points, before.returns, *target)
    for one, other in zip(whole, parts, strict=True):
        assert torch.equal(one, other)


def test_vmap_over_two_dimensions_equals_the_batch():
    scans = random(2, 3, 96, high=4.0)
    parts = torch.vmap(torch.vmap(lambda scan: min_pool(scan, 8)))(scans)
    for one, other in zip(min_pool(scans, 8), parts, strict=True):
        assert torch.equal(one, other)


def test_vmap_over_a_shared_tensor_names_it():
    ranges, _, directions, *rest = arguments("pool")
    with pytest.raises(ValueError, match="directions: must be the same for all members"):
        torch.vmap(lambda table: pooling.pool(ranges, 3, table, *rest))(directions.expand(2, 3, 2))
