"""Scans of any field of view, direction and mount: their points lie where the walls are."""

import math

import pytest
import torch

from navrl.ops import se2
from navrl.ops.pooling import min_pool
from navrl.ops.raycast import cast_rays
from navrl.ops.scan_layout import ScanLayout

MAX = 6.0
BACKENDS = ["torch", "numba"]
HOKUYO = {"angle_min": math.radians(-135.0), "angle_increment": math.radians(0.25)}
WALLS = torch.tensor(  # a room of 6 x 4 m around the robot, and a post
    [
        [3.1, 0.0, 0.1, 2.2, 0.0],
        [-3.1, 0.0, 0.1, 2.2, 0.0],
        [0.0, 2.1, 3.2, 0.1, 0.0],
        [0.0, -2.1, 3.2, 0.1, 0.0],
        [1.0, 0.8, 0.1, 0.15, 0.4],
    ]
).double()
ROBOTS = torch.tensor([[0.0, 0.0, 0.0], [0.7, -0.9, 2.0], [-1.5, 0.4, -0.7]]).double()


def scan(layout):
    """Cast one ray a beam, from the mount, whatever the layout."""
    mount = torch.tensor(layout.mount).double()
    turns = torch.zeros(layout.num_beams, 3).double()
    turns[:, 2] = layout.beam_bearings() - layout.mount[2]
    scanner = se2.compose(ROBOTS, mount.expand(len(ROBOTS), 3))
    rays = se2.compose(scanner.unsqueeze(1), turns)
    boxes = WALLS.expand(*rays.shape[:-1], -1, -1)
    return cast_rays(rays, boxes, num_beams=1, max_range=MAX, backend="numba").squeeze(-1)


def pool(layout, ranges, bearing="beam", backend="torch"):
    options = {name: getattr(layout, name) for name in ("num_points", "angle_min", "mount")}
    options["angle_increment"] = layout.angle_increment
    return min_pool(ranges, layout.group_size, MAX, bearing, backend, **options)


def off_the_walls(points):
    """Return the distance of robot-frame points [R, N, 2] from the nearest wall's surface, m."""
    world = se2.transform_points(ROBOTS, points.double())
    offset = se2.rotate(world.unsqueeze(-2) - WALLS[:, :2], -WALLS[:, 4])
    beyond = offset.abs() - WALLS[:, 2:4]
    outside = beyond.clamp_min(0.0).norm(dim=-1)
    return (outside + beyond.amax(-1).clamp_max(0.0).abs()).amin(-1)


LAYOUTS = {
    "270 degrees": ScanLayout(1081, 8, **HOKUYO),
    "270 degrees to 180 points": ScanLayout(1081, None, 180, **HOKUYO),
    "clockwise": ScanLayout(720, 4, angle_increment=-2.0 * math.pi / 720),
    "from behind": ScanLayout(720, 4, angle_min=-math.pi, angle_increment=2.0 * math.pi / 720),
    "bins that divide nothing": ScanLayout(1081, None, 47, **HOKUYO),
    "1,947 beams": ScanLayout(1947, None, 180),
    "turned": ScanLayout(1440, 8, mount=(0.0, 0.0, 2.0)),
    "backwards": ScanLayout(1440, 8, mount=(0.0, 0.0, math.pi)),
    "beside the center": ScanLayout(1440, 8, mount=(0.2, -0.1, 0.5)),
    "240 degrees, clockwise, in front": ScanLayout(
        683, None, 120, 2.0, -math.radians(0.3515625), (0.15, 0.0, 0.1)
    ),
}
layouts = pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)


@layouts
@pytest.mark.parametrize("backend", BACKENDS)
def test_points_lie_on_the_walls(layout, backend):
    pooled = pool(layout, scan(layout), backend=backend)
    assert pooled.returns.sum() > 0.5 * pooled.returns.numel()
    assert off_the_walls(pooled.points)[pooled.returns].max() < 1e-5


@layouts
@pytest.mark.parametrize("backend", BACKENDS)
def test_bins_hold_the_nearest_reading_of_their_bearings(layout, backend):
    """Each bin against a plain loop over all readings, seen from the robot's center."""
    ranges = scan(layout)
    bearings, width = layout.beam_bearings(), 2.0 * math.pi / layout.num_bins
    first = 0.5 * abs(layout.increment)
    mount = torch.tensor(layout.mount).double()
    for bearing in ("bin", "beam"):
        pooled = pool(layout, ranges, bearing, backend)
        for row, readings in enumerate(ranges.double().tolist()):
            nearest = [MAX] * layout.num_bins
            for reading, angle in zip(readings, bearings.tolist(), strict=True):
                x = mount[0].item() + reading * math.cos(angle)
                y = mount[1].item() + reading * math.sin(angle)
                index = math.floor((math.atan2(y, x) + first) / width) % layout.num_bins
                if reading < MAX - 1e-3:
                    nearest[index] = min(nearest[index], math.hypot(x, y))
            differs = (pooled.ranges[row].double() - torch.tensor(nearest).double()).abs() > 1e-5
            assert differs.sum() <= 2  # readings on the border of two bins
            assert torch.equal(pooled.returns[row], pooled.ranges[row] < MAX)


@layouts
@pytest.mark.parametrize("bearing", ["bin", "beam"])
def test_backends_agree_bit_for_bit(layout, bearing):
    ranges = scan(layout)
    for ours, other in zip(*(pool(layout, ranges, bearing, b) for b in BACKENDS), strict=True):
        assert torch.equal(ours, other)


@layouts
def test_bins_without_beams_are_not_seen_and_have_no_return(layout):
    pooled = pool(layout, scan(layout))
    bearing = layout.bin_centers(torch.float64)
    seen = layout.seen()
    assert not pooled.returns[:, ~seen & (layout.mount[0] == 0.0)].any()
    if layout.angle_increment == HOKUYO["angle_increment"]:
        behind = torch.cos(bearing) < math.cos(math.radians(135.0 + 360 / layout.num_bins))
        assert not seen[behind].any() and not pooled.returns[:, behind].any()
        ahead = torch.cos(bearing) > math.cos(math.radians(135.0 - 360 / layout.num_bins))
        assert seen[ahead].all()
        assert (pooled.ranges[:, behind] == MAX).all()
    elif abs(layout.increment) * layout.num_beams > 6.28:
        assert seen.all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bin_centers_are_the_mean_bearings_of_their_beams(sign):
    """Bins of a number that divides the beams equal groups; others contain their centers."""
    groups = ScanLayout(num_beams=1440, group_size=8).bin_centers(torch.float64)
    layout = ScanLayout(1440, None, 180, angle_increment=sign * 2.0 * math.pi / 1440)
    torch.testing.assert_close(layout.bin_centers(torch.float64), groups)
    uneven = ScanLayout(1081, None, 100, -2.356, sign * 0.004363)
    centers = uneven.bin_centers(torch.float64)
    width = 2.0 * math.pi / 100
    edges = torch.cat([centers - 0.49 * width, centers + 0.49 * width])
    assert uneven.bin_of(edges).tolist() == 2 * list(range(100))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turned_by", [360, 720, 1080, 8, -16, 3])
def test_rotated_mount_keeps_points_in_the_robot_frame(backend, turned_by):
    """A mount turned by whole beams gives the bins of one that is not, to the last bit."""
    ranges = 0.2 + 7.0 * torch.rand(4, 1440, generator=torch.Generator().manual_seed(1))
    yaw = turned_by * 2.0 * math.pi / 1440
    plain = min_pool(ranges, 8, MAX, backend=backend)
    turned = min_pool(
        ranges.roll(-turned_by, -1), 8, MAX, backend=backend, mount=(0.0, 0.0, yaw + 4e-9)
    )
    for ours, other in zip(turned, plain, strict=True):
        assert torch.equal(ours, other)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mirrored_scan_is_read_clockwise(backend):
    ranges = 0.2 + 7.0 * torch.rand(4, 360, generator=torch.Generator().manual_seed(2))
    mirrored = torch.cat([ranges[:, :1], ranges[:, 1:].flip(-1)], dim=-1)
    plain = min_pool(ranges, 4, MAX, backend=backend)
    same = min_pool(mirrored, 4, MAX, backend=backend, angle_increment=-2.0 * math.pi / 360)
    for ours, other in zip(same, plain, strict=True):
        assert torch.equal(ours, other)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_wall_ahead_of_a_backward_mount_is_ahead(backend):
    ranges = torch.full((1440,), MAX)
    ranges[720] = 0.8  # straight ahead of the robot
    pooled = min_pool(ranges, 8, MAX, "beam", backend, mount=(0.0, 0.0, math.pi))
    torch.testing.assert_close(pooled.points[pooled.returns], torch.tensor([[0.8, 0.0]]))
    pooled = min_pool(ranges, 8, MAX, "beam", backend, mount=(0.1, 0.3, math.pi))
    torch.testing.assert_close(pooled.points[pooled.returns], torch.tensor([[0.9, 0.3]]))


@pytest.mark.parametrize("dtype", [torch.int16, torch.int32, torch.int64, torch.uint8])
@pytest.mark.parametrize("backend", BACKENDS)
def test_integer_ranges_have_fractional_points(backend, dtype):
    """In millimeters: points of 23 mm are not cut off to whole ones."""
    ranges = torch.full((16,), 23, dtype=dtype)
    pooled = min_pool(ranges, 4, 250.0, backend=backend)
    expected = min_pool(ranges.float(), 4, 250.0, backend="torch")
    for ours, other in zip(pooled, expected, strict=True):
        assert torch.equal(ours, other)
    assert pooled.points.dtype == torch.float32
    assert (pooled.points % 1.0 != 0.0).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_beams": 1081, "group_size": 23, **HOKUYO}, r"group_size=23: must divide.* 1440 "),
        ({"num_beams": 1081, "group_size": 23}, None),
        ({"num_beams": 10, "group_size": 3}, r"10 beams, group_size 3; .*num_points"),
        ({"num_beams": 8, "group_size": None}, "group_size=None: must be"),
        ({"num_beams": 8, "group_size": 4, "num_points": 3}, "num_points=3: must be 2 for"),
        ({"num_beams": 8, "group_size": None, "num_points": 0}, "num_points=0: must be an int"),
        ({"num_beams": 8, "angle_increment": 0.0}, r"angle_increment=0.0: must be"),
        ({"num_beams": 720, "angle_increment": -0.02}, "angle_increment=-0.02: must be within"),
        ({"num_beams": 8, "angle_min": math.nan}, "angle_min=nan: must be finite"),
        ({"num_beams": 8, "mount": (0.0, math.inf, 0.0)}, "mount=.*inf.*: must be three finite"),
        ({"num_beams": 8, "mount": (0.0, 0.0)}, "mount=.*: must be three finite"),
    ],
)
def test_bad_layouts_are_named(options, message):
    if message is None:
        assert ScanLayout(**options).num_bins == 47
        return
    with pytest.raises(ValueError, match=message):
        ScanLayout(**options)
