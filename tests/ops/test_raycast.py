"""Ray casting: closed forms, kernel against slab tests, and what odd input gives."""

import math

import pytest
import torch

from navrl.ops.raycast import cast_rays

BACKENDS = ["numba", "torch"]
EDGE_RAD = 1e-6  # a beam this close to an edge may go to either side of it


def random_worlds(seed, num_worlds=16, num_boxes=24, clearance=0.0):
    """Robots anywhere in a 6 m square among boxes of 2 cm to 2 m, some of them beyond range."""
    generator = torch.Generator().manual_seed(seed)
    draw = torch.rand(num_worlds, num_boxes + 1, 5, generator=generator, dtype=torch.float64)
    pose = torch.stack((6 * draw[:, 0, 0] - 3, 6 * draw[:, 0, 1] - 3, 20 * draw[:, 0, 2] - 10), -1)
    boxes = draw[:, 1:]
    boxes = torch.cat(
        (12 * boxes[..., :2] - 6, 0.01 + boxes[..., 2:4] ** 3, 20 * boxes[..., 4:] - 10), -1
    )
    return pose, boxes


def room(size_x, size_y, thickness=0.1):
    """Four walls around the origin, inner faces at +-size, that meet in the corners."""
    half = 0.5 * thickness
    return torch.tensor(
        [
            [size_x + half, 0.0, half, size_y, 0.0],
            [-size_x - half, 0.0, half, size_y, 0.0],
            [0.0, size_y + half, size_x, half, 0.0],
            [0.0, -size_y - half, size_x, half, 0.0],
        ],
        dtype=torch.float64,
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_ranges_in_a_room_equal_the_closed_form(backend):
    pose = torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    ranges = cast_rays(pose, room(1.5, 1.0), num_beams=360, backend=backend)
    angle = torch.arange(360, dtype=torch.float64) * (2 * math.pi / 360) + 0.7
    to_x = torch.where(angle.cos() > 0, 1.5 - 0.3, 1.5 + 0.3) / angle.cos().abs()
    to_y = torch.where(angle.sin() > 0, 1.0 + 0.2, 1.0 - 0.2) / angle.sin().abs()
    torch.testing.assert_close(ranges, torch.minimum(to_x, to_y).float(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_beams_run_counter_clockwise_from_straight_ahead(backend):
    """One small box ahead, left, behind and right in turn, for a robot that faces up."""
    pose = torch.tensor([1.0, 2.0, math.pi / 2], dtype=torch.float64)
    for beam, (dx, dy) in enumerate([(0, 1), (-1, 0), (0, -1), (1, 0)]):
        box = torch.tensor([[1.0 + dx, 2.0 + dy, 0.2, 0.2, 0.0]], dtype=torch.float64)
        expected = torch.full((4,), 3.5)
        expected[beam] = 0.8
        ranges = cast_rays(pose, box, num_beams=4, backend=backend)
        torch.testing.assert_close(ranges, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("seed", range(6))
def test_kernel_equals_slab_tests_on_random_worlds(seed):
    """Within 0.1 mm, but for beams that pass an edge within a microradian."""
    pose, boxes = random_worlds(seed)
    ranges = cast_rays(pose, boxes, num_beams=1440, backend="numba")
    turn = torch.tensor([0.0, 0.0, EDGE_RAD], dtype=torch.float64)
    near = [cast_rays(pose + side * turn, boxes, backend="torch") for side in (-1, 0, 1)]
    near = torch.stack(near)
    assert ((ranges >= near.amin(0) - 1e-4) & (ranges <= near.amax(0) + 1e-4)).all()
    assert (ranges - near[1]).abs().gt(1e-4).float().mean() < 1e-4
    assert 0.2 < (ranges < 3.5).float().mean() < 1.0  # the worlds test something


@pytest.mark.parametrize("num_beams", [1, 2, 7, 180, 4096])
def test_kernel_equals_slab_tests_for_any_number_of_beams(num_beams):
    pose, boxes = random_worlds(99, num_worlds=8)
    numba, slab = (
        cast_rays(pose, boxes, num_beams=num_beams, max_range=2.0, backend=backend)
        for backend in BACKENDS
    )
    assert numba.shape == (8, num_beams)
    assert (numba - slab).abs().gt(1e-4).sum() <= num_beams * 8 // 10_000


def test_every_beam_in_a_closed_room_hits():
    """Also where beams run exactly into corners, and for rooms turned by any angle."""
    generator = torch.Generator().manual_seed(3)
    inside = torch.rand(200, 3, generator=generator, dtype=torch.float64) - 0.5
    inside[:50, 2] = 0.0
    inside[:25, :2] = 0.0  # diagonals of a square room: beams through its corners
    turn = torch.rand(200, generator=generator, dtype=torch.float64) * 7
    turn[:25] = 0.0
    cos, sin = turn.cos()[:, None], turn.sin()[:, None]
    walls = room(1.0, 1.0).expand(200, 4, 5).clone()
    x, y = walls[..., 0].clone(), walls[..., 1].clone()
    walls[..., 0], walls[..., 1] = cos * x - sin * y, sin * x + cos * y
    walls[..., 4] += turn[:, None]
    x, y = inside[:, :1].clone(), inside[:, 1:2].clone()
    inside[:, :1], inside[:, 1:2] = cos * x - sin * y, sin * x + cos * y
    ranges = cast_rays(inside, walls, num_beams=1440, backend="numba")
    assert ranges.amax() < 2.3  # the diagonal from one corner region to the other


@pytest.mark.parametrize("backend", BACKENDS)
def test_nearest_box_is_hit_in_any_order(backend):
    pose = torch.zeros(3, dtype=torch.float64)
    boxes = torch.tensor(
        [[2.0, 0.0, 0.1, 0.5, 0.0], [1.0, 0.0, 0.1, 0.1, 0.0]], dtype=torch.float64
    )
    ranges = cast_rays(pose, boxes, num_beams=360, backend=backend)
    assert ranges[0] == pytest.approx(0.9)
    assert ranges[10] == pytest.approx(1.9 / math.cos(0.174533))
    torch.testing.assert_close(ranges, cast_rays(pose, boxes.flip(0), num_beams=360))


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_return_is_exactly_the_maximum_range(backend):
    pose = torch.zeros(3, dtype=torch.float64)
    boxes = torch.tensor([[5.0, 0.0, 0.5, 9.0, 0.0], [0, 3.3001, 0.1, 0.1, 0.3]]).double()
    for max_range in (3.5, 3.2, 3.3):  # 3.3 has no exact float32
        ranges = cast_rays(pose, boxes[:1], num_beams=64, max_range=max_range, backend=backend)
        assert (ranges == torch.tensor(max_range)).all()
    assert cast_rays(pose, boxes, num_beams=64, backend=backend)[16] < 3.5


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.29, -0.19), (0.3, 0.0), (0.0, -0.2)])
def test_scanner_inside_of_a_box_reads_zero(backend, x, y):
    """Also on its edge; what else is in the world does not matter."""
    boxes = torch.tensor([[1.0, 0.0, 0.1, 0.1, 0.0], [0.0, 0.0, 0.3, 0.2, 0.0]]).double()
    boxes[1, 2:4] = torch.tensor([0.3, 0.2], dtype=torch.float64)
    pose = torch.tensor([x, y, 0.4], dtype=torch.float64)
    assert (cast_rays(pose, boxes, backend=backend) == 0.0).all()
    assert (cast_rays(pose, boxes[:1], backend=backend) > 0.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_absent_boxes_are_not_seen(backend):
    pose = torch.zeros(2, 3, dtype=torch.float64)
    boxes = torch.tensor([[1.0, 0.0, 0.1, 0.1, 0.0], [0.0, 1.0, 0.1, 0.1, 0.0]]).double()
    boxes = boxes.repeat(2, 1, 1)
    num_boxes = torch.tensor([1, 0])
    ranges = cast_rays(pose, boxes, num_boxes, num_beams=4, backend=backend)
    assert ranges[0].tolist() == pytest.approx([0.9, 3.5, 3.5, 3.5])
    assert (ranges[1] == 3.5).all()
    boxes[:, 0] = torch.nan
    ranges = cast_rays(pose, boxes, num_beams=4, backend=backend)
    assert ranges[0].tolist() == pytest.approx([3.5, 0.9, 3.5, 3.5])
    assert (cast_rays(pose, boxes[:, :0], num_beams=4, backend=backend) == 3.5).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_any_batch_shape_and_precision(backend):
    pose, boxes = random_worlds(5, num_worlds=6)
    flat = cast_rays(pose, boxes, num_beams=90, backend=backend)
    batched = cast_rays(
        pose.reshape(2, 3, 3), boxes.reshape(2, 3, -1, 5), num_beams=90, backend=backend
    )
    assert torch.equal(batched, flat.reshape(2, 3, 90))
    single = cast_rays(pose.float(), boxes.float(), num_beams=90, backend=backend)
    assert (single - flat).abs().gt(1e-3).sum() <= 3  # single precision moves edges
    assert cast_rays(pose[:0], boxes[:0], num_beams=90, backend=backend).shape == (0, 90)


def test_ranges_do_not_depend_on_the_number_of_threads():
    pose, boxes = random_worlds(7)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = cast_rays(pose, boxes)
        torch.set_num_threads(2)
        assert torch.equal(one, cast_rays(pose, boxes))
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pose": torch.full((2, 3), torch.nan).double()}, "pose: must be finite"),
        ({"pose": torch.zeros(2, 2).double()}, "pose: must be"),
        ({"boxes": torch.full((2, 3, 5), -1.0).double()}, "half sizes"),
        ({"boxes": torch.zeros(3, 3, 5).double()}, "boxes: must be"),
        ({"boxes": torch.zeros(2, 3, 4).double()}, "boxes: must be"),
        ({"num_boxes": torch.tensor([1, 4])}, "num_boxes"),
        ({"num_boxes": torch.tensor([1, -1])}, "num_boxes"),
        ({"num_boxes": torch.tensor([1.0, 1.0])}, "num_boxes"),
        ({"num_beams": 0}, "num_beams"),
        ({"max_range": math.nan}, "max_range"),
        ({"backend": "fast"}, "backend"),
    ],
)
def test_bad_input_is_named(change, message):
    arguments = {"pose": torch.zeros(2, 3).double(), "boxes": torch.ones(2, 3, 5).double()}
    with pytest.raises(ValueError, match=message):
        cast_rays(**(arguments | change))


@pytest.mark.parametrize(
    "angle_min, increment", [(-2.35, 0.01), (3.0, -0.01), (-9.0, 0.004), (0.5, -2 * math.pi / 64)]
)
@pytest.mark.parametrize("backend", ["torch", "numba"])
def test_partial_scan_is_part_of_a_full_one(angle_min, increment, backend):
    """Each beam reads what a single beam in its direction reads."""
    generator = torch.Generator().manual_seed(0)
    boxes = torch.rand(12, 5, generator=generator, dtype=torch.float64) * 6.0 - 3.0
    boxes[:, 2:4] = boxes[:, 2:4].abs() * 0.15
    pose = torch.tensor([0.1, -0.2, 0.7], dtype=torch.float64)
    ranges = cast_rays(pose, boxes, None, 64, 5.0, backend, angle_min, increment)
    angles = angle_min + torch.arange(64, dtype=torch.float64) * increment
    poses = torch.cat((pose[:2].expand(64, 2), (pose[2] + angles)[:, None]), dim=-1)
    alone = cast_rays(poses, boxes.expand(64, 12, 5), None, 1, 5.0, backend)[:, 0]
    torch.testing.assert_close(ranges, alone, atol=1e-4, rtol=0)
