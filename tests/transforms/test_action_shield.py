"""A command that leads into something is not driven: what is driven instead, and when."""

import math
import pickle

import pytest
import torch
from contract import DEVICES
from lidar_envs import RoomEnv, StrangersEnv
from tensordict import TensorDict
from torchrl.envs import ActionScaling, Compose, GymWrapper, TransformedEnv
from torchrl.envs.utils import check_env_specs

from navrl import keys
from navrl.ops.motion import point_motion, room_along
from navrl.transforms import TAGD, ActionShield, ICPAlign, MinPool, ScanHistory

RADIUS, MARGIN = 0.178, 0.03


def pipeline(**kwargs) -> list:
    return [MinPool(group_size=1), ScanHistory(), ICPAlign(), TAGD(), ActionShield(**kwargs)]


def seen(*points, motion=(0.0, 0.0), valid=True) -> TensorDict:
    """Return what a robot sees of points of which the first group is at the first of them."""
    points = torch.tensor(points or [(3.5, 0.0)])
    now = points[:1]
    tagd = torch.cat([now - torch.tensor([motion]), now], dim=-1)
    return TensorDict(
        {
            keys.POINTS: points,
            keys.RETURNS: torch.full((len(points),), bool(len(points)) and points[0, 0] < 3.5),
            keys.TAGD: tagd,
            keys.TAGD_VALID: torch.full((1, 2), valid),
        }
    )


def driven(scan: TensorDict, v: float, w: float = 0.0, **kwargs) -> tuple[float, float]:
    return tuple(
        ActionShield(**kwargs).inv(scan.set(keys.ACTION, torch.tensor([v, w])))["action"].tolist()
    )


def hull_gap(command: tuple[float, float], point, motion=(0.0, 0.0), horizon: float = 0.4) -> float:
    """Return m between hull and point at the closest, by small steps of an integration."""
    x = y = yaw = 0.0
    smallest, step = math.inf, 1e-3
    for k in range(round(horizon / step)):
        yaw += 0.5 * command[1] * step
        x, y = x + command[0] * math.cos(yaw) * step, y + command[0] * math.sin(yaw) * step
        yaw += 0.5 * command[1] * step
        t = (k + 1) * step / 0.2
        gap = math.hypot(point[0] + motion[0] * t - x, point[1] + motion[1] * t - y)
        smallest = min(smallest, gap)
    return smallest - RADIUS


@pytest.mark.parametrize("command", [(1.0, 0.0), (0.0, 3.14), (0.371, -1.234)])
def test_safe_command_is_unchanged_bit_for_bit(command):
    scan = seen((1.5, 0.4), (0.3, 1.4))
    assert driven(scan, *command) == tuple(torch.tensor(command).tolist())


def test_points_without_return_are_no_obstacle():
    scan = seen((0.25, 0.0))
    assert driven(scan.clone(), 1.0) != (1.0, 0.0)
    scan[keys.RETURNS][:] = False
    assert driven(scan, 1.0) == (1.0, 0.0)


def test_unsafe_command_becomes_the_most_similar_safe_one():
    """A point 0.45 m ahead: of all commands of the grid none that stays clear is nearer."""
    command = driven(seen((0.45, 0.0)), 1.0)
    assert hull_gap((1.0, 0.0), (0.45, 0.0)) < MARGIN <= hull_gap(command, (0.45, 0.0)) + 1e-3

    def change(v, w):
        return (v - 1.0) ** 2 + (w / (2 * math.pi)) ** 2

    for v in torch.linspace(0, 1, 11).tolist():
        for w in torch.linspace(-math.pi, math.pi, 25).tolist():
            if change(v, w) < change(*command) - 1e-6:  # checked at four places, as the shield does
                places = [(k + 1) * 0.1 for k in range(4)]
                gaps = [end_gap(v, w, t, (0.45, 0.0)) for t in places]
                assert min(gaps) <= MARGIN + 1e-5


def end_gap(v: float, w: float, t: float, point) -> float:
    half = 0.5 * w * t
    chord = v * t * (math.sin(half) / half if half else 1.0)
    return math.hypot(point[0] - chord * math.cos(half), point[1] - chord * math.sin(half)) - RADIUS


def values_of(scan: TensorDict) -> list[torch.Tensor]:
    return [scan[key] for key in (keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID)]


def test_replaced_command_keeps_the_precision_of_the_request():
    values, request = values_of(seen((0.45, 0.0))), torch.tensor([[1.0, 0.0], [1.0, 0.2]])
    values = [value.expand(2, *value.shape) for value in values]
    expected = ActionShield().command(request, *values)
    shielded = ActionShield().command(request.double(), *values)
    assert shielded.dtype == torch.float64
    assert torch.equal(shielded.float(), expected) and not torch.equal(expected, request)


def test_scan_without_points_changes_no_command():
    points, returns, *groups = values_of(seen((0.45, 0.0)))
    command = ActionShield().command(torch.tensor([1.0, 0.0]), points[:0], returns[:0], *groups)
    assert command.tolist() == [1.0, 0.0]


def test_largest_clearance_is_chosen_without_a_safe_command():
    ring = [(0.19 * math.cos(a), 0.19 * math.sin(a)) for a in torch.linspace(0, 6.2, 60).tolist()]
    v, _ = driven(seen(*ring), 1.0)
    assert v == 0.0


@pytest.mark.parametrize("w", [0.0, 0.371, -math.pi])
def test_shield_keeps_a_stop_command_beside_a_noisy_wall(w):
    """A wall 0.04 m off the hull, pooled from 1,440 beams with the shipped lidar's noise."""
    beams = torch.arange(1440) * (2 * math.pi / 1440)
    true = torch.where(beams.sin() > 0.07, (RADIUS + 0.04) / beams.sin(), 9.0).clamp_max(3.5)
    noise = 0.025 * torch.randn(2000, 1440, generator=torch.Generator().manual_seed(0))
    ranges = torch.where(true < 3.5, true + noise, 3.5)
    scan = MinPool()(TensorDict({keys.RANGES: ranges}, [2000]))
    still = scan[keys.POINTS][:, :1].repeat(1, 1, 2)
    scan.update({keys.TAGD: still, keys.TAGD_VALID: torch.ones(2000, 1, 2, dtype=torch.bool)})
    near = scan[keys.POINTS].norm(dim=-1).amin(-1) - RADIUS <= MARGIN
    assert near.float().mean() > 0.9  # the noise puts the wall within the margin
    asked = torch.tensor([0.0, w]).expand(2000, 2)
    assert torch.equal(ActionShield().inv(scan.set(keys.ACTION, asked))["action"], asked)


def test_shield_leaves_a_stop_when_a_pedestrian_moves_in():
    person, motion = (0.0, 0.55), (0.0, -0.2)
    assert driven(seen(person), 0.0) == (0.0, 0.0)
    command = driven(seen(person, motion=motion), 0.0)
    assert hull_gap((0.0, 0.0), person, motion) < MARGIN
    assert hull_gap(command, person, motion) > MARGIN - 0.01


def test_a_command_along_a_wall_within_the_margin_passes():
    """It comes no nearer to what is near already, so nothing is more similar than itself."""
    wall = [(0.02 * k, RADIUS + 0.02) for k in range(-50, 51)]
    assert driven(seen(*wall), 0.731) == (torch.tensor(0.731).item(), 0.0)
    turned = driven(seen(*wall), 0.731, 1.0)  # towards the wall
    assert turned[1] <= 0.0 and turned[0] > 0.4


def test_present_clearance_is_considered():
    """Driving away at any speed has the clearance of now: the most similar command is driven."""
    behind = (-(RADIUS + 0.01), 0.0)
    assert driven(seen(behind), 0.25) == (0.25, 0.0)


@pytest.mark.parametrize("point", [(-0.02, 0.0), (0.0, 0.05), (-0.1, 0.0)])
def test_point_deep_in_the_hull_does_not_disable_the_shield(point):
    """A wall 0.25 m ahead; a return of the robot's own body, say, is at the center."""
    command = driven(seen((0.25, 0.0), point), 1.0)
    assert hull_gap(command, (0.25, 0.0)) > -MARGIN - 1e-3


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_points_that_are_not_finite_are_not_returns(value):
    expected = driven(seen((0.3, 0.0)), 1.0)
    assert driven(seen((0.3, 0.0), (value, 0.0)), 1.0) == expected != (1.0, 0.0)


@pytest.mark.parametrize(("gap", "passes"), [(MARGIN - 0.005, False), (MARGIN + 0.005, True)])
def test_margin_decides_which_commands_pass(gap, passes):
    """Driven for 0.4 s, the command ends ``gap`` m before a point."""
    point = (RADIUS + 0.5 * 0.4 + gap, 0.0)
    assert (driven(seen(point), 0.5) == (0.5, 0.0)) is passes


def test_each_half_step_is_checked():
    assert ActionShield().times == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert ActionShield(checks_per_step=1).times == pytest.approx([0.2, 0.4])


def test_a_pedestrian_within_the_margin_is_evaded():
    """One walks behind the robot at 0.35 m/s; at 0.4 m/s the margin is regained too late."""
    person, motion = (-(RADIUS + MARGIN - 0.008), 0.0), (0.07, 0.0)
    assert driven(seen(person, motion=motion), 0.5) == (0.5, 0.0)
    v, w = driven(seen(person, motion=motion), 0.4)
    assert v == pytest.approx(0.5) and w == pytest.approx(0.0, abs=1e-6)
    assert driven(seen(person), 0.4) == (torch.tensor(0.4).item(), 0.0)  # it stands there


@pytest.mark.parametrize("speed, gap", [(0.8, 0.172), (1.2, 0.272), (0.4, 0.032), (1.4, 0.172)])
def test_stop_is_kept_if_a_frontal_contact_cannot_be_avoided(speed, gap):
    """The front of a pedestrian straight ahead: driving on would meet it sooner."""
    center, angles = RADIUS + gap + 0.15, torch.linspace(-1.2, 1.2, 13)
    front = [(center - 0.15 * math.cos(a), 0.15 * math.sin(a)) for a in angles.tolist()]
    front.insert(0, (center - 0.1, 0.0))
    v, _ = driven(seen(*front, motion=(-0.2 * speed, 0.0)), 0.0)
    assert v == 0.0
    v, _ = driven(seen(*front, motion=(-0.2 * speed, 0.0)), 1.0)
    assert v < 1.0


@pytest.mark.parametrize("w", [0.0, 0.5])
def test_stop_is_kept_among_equally_late_contacts(w):
    """Driving on with a turn would leave more room in the end, but meets the point no later."""
    assert driven(seen((0.3, 0.1), motion=(-0.2, 0.0)), 0.0, w) == (0.0, w)


def test_approaching_points_do_not_lower_the_distance_to_others():
    """A pedestrian within the margin on one side, a wall outside of it on the other."""
    person, motion, wall = (0.0, RADIUS + 0.01), (0.0, -0.07), (0.45, 0.0)
    alone = driven(seen(wall), 1.0)
    both = driven(seen(person, wall, motion=motion), 1.0)
    for command in (alone, both):
        assert hull_gap(command, wall) > MARGIN - 1e-3


def test_distances_exceed_those_required_by_each_point():
    places = torch.zeros(1, 1, 1, 2)
    points = torch.tensor([[[1.0, 0.0], [2.0, 0.0]]])
    room = room_along(places, points, torch.zeros(1, 2, 2), [1], torch.tensor([[0.25, 1.5]]))
    torch.testing.assert_close(room, torch.tensor([[[0.5]]]))


def test_ties_choose_the_most_similar_command():
    """A point within the margin ahead: all that drive no nearer tie at the present clearance."""
    point = (RADIUS + 0.01, 0.0)
    v, w = driven(seen(point), 0.5, 1.0)
    grid = torch.linspace(-math.pi, math.pi, 25)
    assert v == 0.0
    assert abs(w - 1.0) == pytest.approx((grid - 1.0).abs().min().item(), abs=1e-5)


def test_a_robot_that_drives_backwards_can_stop():
    """Its speeds from -0.25 to 0.75 m/s in steps of 0.1 miss zero; the grid does not."""
    ring = [(0.19 * math.cos(a), 0.19 * math.sin(a)) for a in torch.linspace(0, 6.2, 60).tolist()]
    v, _ = driven(seen(*ring), 0.75, min_speed=-0.25, max_speed=0.75)
    assert v == 0.0


def test_descriptors_predict_pedestrian_motion():
    """Somebody comes from the left, 0.2 m a step: in 0.4 s he is in front of the robot."""
    person, motion = (0.5, 0.45), (0.0, -0.2)
    assert driven(seen(person), 1.0) == (1.0, 0.0)
    command = driven(seen(person, motion=motion), 1.0)
    assert hull_gap((1.0, 0.0), person, motion) < MARGIN
    assert hull_gap(command, person, motion) > MARGIN - 0.01  # between two checked places


@pytest.mark.parametrize(
    ("motion", "valid"),
    [((0.0, -0.03), True), ((0.0, -0.5), True), ((0.0, -0.2), False)],
    ids=["noise", "mismatch", "seen once"],
)
def test_noise_is_not_predicted_as_motion(motion, valid):
    assert driven(seen((0.5, 0.45), motion=motion, valid=valid), 1.0) == (1.0, 0.0)


def test_only_points_around_a_moved_group_move():
    points = torch.tensor([[[1.0, 0.0], [1.2, 0.0], [1.4, 0.0]]])
    tagd = torch.tensor([[[0.9, 0.0, 1.0, 0.0], [2.0, 0.0, 2.0, 0.0]]])
    valid = torch.ones(1, 2, 2, dtype=torch.bool)
    kind = {"min_displacement": 0.05, "max_displacement": 0.3, "group_radius": 0.3}
    motion = point_motion(points, tagd, valid, **kind)
    torch.testing.assert_close(motion[0, :, 0], torch.tensor([0.1, 0.1, 0.0]))
    assert motion[..., 1].abs().max() == 0.0


@pytest.mark.parametrize(
    ("step", "moves"), [(0.04, False), (0.06, True), (0.29, True), (0.31, False)]
)
def test_displacement_limits_select_moving_groups(step, moves):
    points = torch.tensor([[[1.0, 0.0]]])
    tagd = torch.tensor([[[1.0, step, 1.0, 0.0]]])
    valid = torch.ones(1, 1, 2, dtype=torch.bool)
    motion = point_motion(
        points, tagd, valid, min_displacement=0.05, max_displacement=0.3, group_radius=0.3
    )
    torch.testing.assert_close(motion[0, 0], torch.tensor([0.0, -step if moves else 0.0]))


def test_clearance_is_measured_at_the_time_of_each_position():
    places = torch.tensor([[[[0.0, 0.0], [1.0, 0.0]]]])
    points, motion = torch.tensor([[[2.0, 0.0]]]), torch.tensor([[[0.5, 0.0]]])
    room = room_along(places, points, motion, [1, 4])
    torch.testing.assert_close(room, torch.tensor([[[2.5, 3.0]]]))


def test_caller_keeps_the_unshielded_action():
    env = TransformedEnv(RoomEnv(64, done_rate=0.0), Compose(*pipeline(), ActionScaling()))
    check_env_specs(env)
    got, step = [], env.base_env._step
    env.base_env._step = lambda td: got.append(td["action"].clone()) or step(td)
    env.set_seed(0)
    root = env.reset()
    root[keys.POINTS] = 0.2 * root[keys.POINTS]  # nearer walls: the caller's scan is what counts
    asked = 2 * torch.rand(64, 2, generator=torch.Generator().manual_seed(0)) - 1
    stepped = env.step(root.clone().set("action", asked))
    assert torch.equal(stepped["action"], asked)
    plain = TransformedEnv(RoomEnv(64, done_rate=0.0), ActionScaling())
    plain.reset()
    wished = plain.transform.inv(TensorDict({"action": asked}, [64]))["action"]
    assert 0 < (got[0] != wished).any(-1).sum() < 64
    seen_then = (root[key] for key in ActionShield().scan_keys)
    torch.testing.assert_close(got[0], ActionShield().command(wished, *seen_then))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_any_batch_shape_and_device(batch, device):
    generator = torch.Generator().manual_seed(1)
    env = TransformedEnv(RoomEnv(6, done_rate=0.0), Compose(*pipeline()))
    env.set_seed(0)
    root = env.reset().set("action", torch.rand(6, 2, generator=generator))
    count = max(1, math.prod(batch))
    data = root[:count].reshape(*batch) if batch else root[0]
    command = ActionShield().to(device).inv(data.clone().to(device))["action"]
    assert command.shape == (*batch, 2) and command.device.type == device
    alone = torch.stack([ActionShield().inv(root[i].clone())["action"] for i in range(count)])
    torch.testing.assert_close(command.reshape(-1, 2).cpu(), alone)


def test_stored_data_contains_the_policys_action():
    scan = seen((0.25, 0.0)).set("action", torch.tensor([1.0, 0.0]))
    assert ActionShield()(scan.clone())["action"].tolist() == [1.0, 0.0]


def test_clone_and_pickle():
    scan = seen((0.25, 0.0)).set("action", torch.tensor([1.0, 0.0]))
    transform = ActionShield()
    expected = transform.inv(scan.clone())["action"]
    for copy in (transform.clone(), pickle.loads(pickle.dumps(transform))):
        assert torch.equal(copy.inv(scan.clone())["action"], expected)
    assert not list(transform.parameters()) and not transform.state_dict()


def test_foreign_env():
    scan = [["scan", "r"], ["scan", "xy"], ["scan", "hit"]]
    past = [["past", "xy"], ["past", "hit"]]
    aligned, groups = ["aligned"], [["tagd", "c"], ["tagd", "ok"]]
    steps = [
        MinPool(3, 2.5, in_keys=["laser"], out_keys=scan),
        ScanHistory(in_keys=scan[1:], out_keys=past),
        ICPAlign(in_keys=[*past, *scan[1:]], out_keys=[*aligned, "motion", "converged", "inliers"]),
        TAGD(in_keys=[*scan[1:], *aligned, past[1]], out_keys=groups),
        ActionShield(scan_keys=[*scan[1:], *groups]),
    ]
    env = TransformedEnv(GymWrapper(StrangersEnv()), Compose(*steps, ActionScaling()))
    check_env_specs(env)
    assert env.rollout(5)["action"].abs().max() <= 1.0


@pytest.mark.parametrize("key", ["action", keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID])
def test_missing_key_is_named(key):
    scan = seen((1.0, 0.0)).set("action", torch.zeros(2))
    with pytest.raises(ValueError, match=f"ActionShield needs key '{key}'"):
        ActionShield().inv(scan.exclude(key))
    env = TransformedEnv(RoomEnv(1, num_beams=1440), Compose(MinPool(), ActionShield()))
    with pytest.raises(ValueError, match="ActionShield needs key 'tagd'"):
        _ = env.action_spec


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"radius": 0.0}, "radius=0.0: must be positive"),
        ({"horizon": math.nan}, "horizon=nan: must be positive"),
        ({"time_step": -0.2}, "time_step=-0.2: must be positive"),
        ({"checks_per_step": 0}, "checks_per_step=0: must be positive"),
        ({"max_turn_rate": math.inf}, "max_turn_rate=inf: must be positive"),
        ({"margin": -0.1}, "margin=-0.1: must be >= 0"),
        ({"min_speed": 1.0}, "min_speed=1.0, max_speed=1.0: must satisfy min_speed < max_speed"),
        ({"min_descriptor_speed": 2.0}, "min_descriptor_speed=2.0, max_descriptor_speed=1.5"),
        ({"num_speeds": 1}, "num_speeds=1: must be at least 2"),
        ({"num_turn_rates": 24}, "num_turn_rates=24: must be odd"),
        ({"scan_keys": ["points"]}, "scan_keys=.*: must be 4 keys"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        ActionShield(**arguments)
