"""A robot whose path is blocked makes room and waits until the path is free."""

from pathlib import Path

import pytest
import torch
from contract import TransformContract
from hydra import compose as compose_config
from hydra import initialize_config_dir
from hydra.utils import instantiate
from lidar_envs import RoomEnv
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from navrl import config, keys
from navrl.factory import make_evaluated_policy
from navrl.transforms import MinPool, Recovery, Retreat, StallTimer, Waypoints, compose

CONF = Path(__file__).parents[2] / "conf"
PATH = torch.tensor([[[-3.0, 0.0], [3.0, 0.0]]])  # m, the robot is in its middle
PERSON = (0.5, 0.0)  # m, on the path
NO_MOTION = torch.zeros(1, 1, 4), torch.zeros(1, 1, 2, dtype=torch.bool)
ASKED = torch.tensor([[0.7, -0.4]])
BESIDE = [(x / 10, side) for x in range(-30, 31) for side in (-0.3, 0.3)]  # m, a narrow passage


def driving(**values):
    """Return a recovery that drives a retreat."""
    scan = (keys.POINTS, keys.RETURNS, keys.TAGD, keys.TAGD_VALID)
    return Recovery(scan_keys=(*scan, keys.RECOVERY_WAYPOINTS, keys.RECOVERY_STALL), **values)


class TestRetreat(TransformContract):
    is_memoryless = False
    state_keys = (keys.RETREAT, keys.POSE)

    def make(self, **kwargs):  # a robot so large that the walls of the room block its path
        return Retreat(radius=1.72, patience=0.4, duration=0.6, pause=0.4, **kwargs)

    def before(self):
        return [MinPool(group_size=4), Waypoints(), StallTimer(patience=0.2, min_progress=0.2)]

    def in_foreign_env(self):
        pool = MinPool(3, 2.5, in_keys=["laser"], out_keys=["r", "xy", "hit"])
        waypoints = Waypoints(in_keys=["odometry", "route"], out_keys=["way", ["ahead", "arc"]])
        timer = StallTimer(in_keys=[["ahead", "arc"]], out_keys=["stall"])
        inputs = ["way", "stall", "xy", "hit", "odometry", "route", ["ahead", "arc"]]
        outputs = [["ahead", "way"], ["ahead", "stall"], ["ahead", "state"]]
        return [pool, waypoints, timer, Retreat(in_keys=inputs, out_keys=outputs)]

    def check_rollout(self, rollout):
        after = rollout["next"]
        phase = after[keys.RETREAT][..., 2]
        assert set(phase.unique().tolist()) == {0.0, 1.0, 2.0}
        usual = phase != 1.0
        torch.testing.assert_close(
            after[keys.RECOVERY_WAYPOINTS][usual], after[keys.WAYPOINTS][usual]
        )
        assert torch.equal(after[keys.RECOVERY_STALL][..., 1] == 0.0, quiet(after))


def quiet(observed):
    return (observed[keys.RETREAT][..., 2] == 2.0) | (observed[keys.STALL][..., 1] == 0.0)


def seen(since, points=(PERSON,), position=(0.0, 0.0), yaw=0.0, corner=(0.0, 0.0)):
    """Return an observation ``[1]``; the points are given in the world."""
    shift = torch.tensor(corner, dtype=torch.float64)
    pose = torch.tensor([[*position, yaw]], dtype=torch.float64)
    turn = torch.tensor([[yaw]]).cos(), torch.tensor([[yaw]]).sin()

    def local(places):
        x, y = (torch.tensor(places) - torch.tensor(position)).unsqueeze(0).unbind(-1)
        return torch.stack([turn[0] * x + turn[1] * y, turn[0] * y - turn[1] * x], dim=-1)

    return TensorDict(
        {
            keys.WAYPOINTS: local([(0.3, 0.0), (0.6, 0.0), (0.9, 0.0)]),
            keys.STALL: torch.tensor([[3.0, since]]),
            keys.POINTS: local(points),
            keys.RETURNS: torch.ones(1, len(points), dtype=torch.bool),
            keys.POSE: pose + torch.cat([shift, torch.zeros(1)]),
            keys.PATH: PATH.double() + shift,
            keys.PATH_PROGRESS: torch.tensor([[3.0]]),
        },
        [1],
    )


def phases(steps, retreat=None):
    """Return the observations of consecutive steps with the outputs."""
    retreat = retreat or Retreat()
    retreat._call(steps[0])
    for before, after in zip(steps[:-1], steps[1:], strict=True):
        retreat._step(before, after)
    return steps


def stalled(points=(PERSON,), last=12.0, **options):
    return phases([seen(0.2 * k, points, **options) for k in range(round(5 * last) + 1)])


def target(observed):
    return observed[keys.RECOVERY_WAYPOINTS][0, -1]


def test_nothing_changes_before_the_patience_ends():
    for step in stalled(last=3.8):
        assert torch.equal(step[keys.RECOVERY_WAYPOINTS], step[keys.WAYPOINTS])
        assert torch.equal(step[keys.RECOVERY_STALL], step[keys.STALL])
        assert not step[keys.RETREAT].any()


def test_robot_retreats_pauses_and_retreats_again():
    phase = [step[keys.RETREAT][0, 2].item() for step in stalled()]
    assert phase == [0.0] * 20 + [1.0] * 20 + [2.0] * 15 + [1.0] * 6  # 4 s, 4 s, 3 s


def test_policy_drives_between_retreats():
    steps = stalled(last=9.0)
    assert steps[30][keys.RECOVERY_STALL][0].tolist() == pytest.approx([3.0, 6.0])
    assert steps[42][keys.RECOVERY_STALL].tolist() == [[0.0, 0.0]]
    assert torch.equal(steps[42][keys.RECOVERY_WAYPOINTS], steps[42][keys.WAYPOINTS])


def test_target_is_aside_of_the_path_and_free():
    wall = [(x / 10, 0.5) for x in range(-30, 31)]
    aside = target(stalled([PERSON, *wall], last=4.0)[-1])
    assert aside[1] <= -0.65  # the wall is on the other side
    assert aside.norm() < 1.0


def test_robot_goes_back_in_a_narrow_passage():
    back = target(stalled([PERSON, *BESIDE], last=4.0)[-1])
    assert back[0] < -1.2
    assert abs(back[1]) < 0.1


def test_robot_that_cannot_leave_stays():
    around = [(0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25)]
    assert target(stalled(around, last=4.0)[-1]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("corner", [(0.0, 0.0), (5e5, 5.6e6)])
def test_target_stays_in_place_while_the_robot_turns(corner):
    first = seen(4.0, corner=corner)
    then = seen(4.2, position=(0.1, -0.2), yaw=1.0, corner=corner)
    Retreat()._step(seen(3.8).set(keys.RETREAT, torch.zeros(1, 3)), first)
    Retreat()._step(first, then)
    x, y = target(then)
    yaw = torch.tensor(1.0)
    world = [0.1 + x * yaw.cos() - y * yaw.sin(), -0.2 + x * yaw.sin() + y * yaw.cos()]
    assert world == pytest.approx(target(first).tolist(), abs=1e-4)


def test_robot_at_its_target_waits_and_faces_the_path():
    first = stalled(last=4.0)[-1]
    there = seen(4.2, position=tuple(target(first).tolist()))
    Retreat()._step(first, there)
    way = there[keys.RECOVERY_WAYPOINTS][0]
    assert way.norm(dim=-1).max() <= 0.011
    toward = there[keys.WAYPOINTS][0, 0]
    torch.testing.assert_close(way[0] / way[0].norm(), toward / toward.norm())


def test_robot_in_a_passage_has_a_next_target():
    first = stalled([PERSON, *BESIDE], last=4.0)[-1]
    there = seen(4.2, [PERSON, *BESIDE], position=(-1.45, 0.0))
    Retreat()._step(first, there)
    assert target(there)[0] < -1.0


def test_retreat_ends_when_the_path_is_free():
    gone = [(0.0, 2.0)]
    steps = [seen(0.2 * k, [PERSON] if k < 25 else gone) for k in range(40)]
    phase = [step[keys.RETREAT][0, 2].item() for step in phases(steps)]
    assert phase == [0.0] * 20 + [1.0] * 5 + [2.0] * 15


def test_policy_drives_on_while_the_path_is_free():
    gone = [(0.0, 2.0)]
    steps = phases([seen(0.2 * k, [PERSON] if k < 25 else gone) for k in range(70)])
    assert all(step[keys.RETREAT][0, 2] == 2.0 for step in steps[25:])  # at 11 s too


def test_free_path_is_no_reason_to_retreat():
    assert not any(retreats(step) for step in stalled([(0.5, 0.4)]))


def retreats(step):
    return bool((step[keys.RETREAT][..., 2] == 1.0).any())


def test_points_that_are_no_returns_block_nothing():
    steps = [seen(0.2 * k) for k in range(25)]
    for step in steps:
        step[keys.RETURNS].fill_(False)
    assert not any(retreats(step) for step in phases(steps))


def test_progress_ends_a_retreat():
    steps = [*stalled(last=5.0), seen(0.0)]
    Retreat()._step(*steps[-2:])
    assert not steps[-1][keys.RETREAT].any()
    assert torch.equal(steps[-1][keys.RECOVERY_STALL], steps[-1][keys.STALL])


def test_rows_are_independent():
    left, right = ([PERSON, *((x / 10, y) for x in range(-30, 31))] for y in (0.5, -0.5))
    cases = [(right, 1.0), (left, 4.0), ([PERSON] * 62, 4.2), (right, 4.0)]
    rows = [seen(since, points) for points, since in cases]
    before = torch.zeros(4, 3)
    before[2] = torch.tensor([2.5, 0.9, 1.0])
    together = torch.cat([row.clone() for row in rows]).reshape(2, 2)
    root = TensorDict({keys.RETREAT: before, keys.POSE: torch.zeros(4, 3)}, [4])
    Retreat()._step(root.reshape(2, 2), together)
    for index, row in enumerate(rows):
        Retreat()._step(root[index : index + 1], row)
        for key in Retreat().out_keys:
            torch.testing.assert_close(together.reshape(4)[key][index], row[key][0])


def test_recovery_drives_the_retreat():
    recovery = Recovery()
    first = stalled(last=4.0)[-1]
    speed, turn_rate = command(recovery, first)
    assert speed == 0.0  # turns in place
    assert turn_rate * target(first)[1] > 0.0
    yaw = torch.atan2(*target(first).flip(0)).item()
    turned = seen(4.2, yaw=yaw)
    Retreat()._step(first, turned)
    assert command(recovery, turned)[0] > 0.2


def command(recovery, observed):
    names = (keys.POINTS, keys.RETURNS, keys.RECOVERY_WAYPOINTS, keys.RECOVERY_STALL)
    points, returns, waypoints, stall = (observed[name] for name in names)
    return recovery.command(ASKED, points, returns, *NO_MOTION, waypoints, stall)[0].tolist()


def test_robot_that_waits_does_not_spin():
    first = stalled(last=4.0)[-1]
    there = seen(4.2, position=tuple(target(first).tolist()), yaw=0.0)
    there[keys.WAYPOINTS] = torch.tensor([[[0.3, 0.0]] * 3])  # the path is ahead
    Retreat()._step(first, there)
    assert command(Recovery(), there) == [0.0, 0.0]
    assert abs(command(Recovery(turn_weight=0.0), there)[1]) > 1.0


def test_recovery_follows_the_retreat_in_any_order():
    recovery, retreat = driving(), Retreat()
    for names in (("recovery", "retreat"), ("retreat", "recovery")):
        steps = {"recovery": recovery, "retreat": retreat}
        assert list(compose(**{name: steps[name] for name in names})) == [retreat, recovery]


@pytest.mark.parametrize("steps", ["retreat", "[recovery,retreat]"])
@pytest.mark.parametrize("pipeline", ["paper", "navrl_best"])
def test_step_composes_with_a_pipeline(pipeline, steps):
    with initialize_config_dir(str(CONF), version_base=None):
        chosen = ["+robot=kobuki", f"+transforms={pipeline}"]
        config = compose_config(overrides=[*chosen, f"+transforms/steps@transforms={steps}"])
    chain = instantiate(config.transforms, _convert_="all")
    env = TransformedEnv(RoomEnv(num_beams=1440), chain)
    check_env_specs(env)
    order = [type(step).__name__ for step in chain]
    assert order.index("StallTimer") < order.index("Retreat") < order.index("Recovery")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Retreat(pause=0.0), "pause=0"),
        (lambda: Retreat(aside=-1.0), "aside=-1"),
        (lambda: Retreat(margin=-0.1), "margin=-0.1: must be >= 0"),
        (lambda: Retreat(look_ahead=5.0), r"look_ahead=5.0: must be in \[0.1, 4.0\]"),
        (lambda: Retreat(num_bearings=0), "num_bearings=0"),
        (lambda: Retreat(in_keys=["points"]), "must be 7 keys"),
        (lambda: Recovery(turn_weight=-0.1), "turn_weight=-0.1: must be >= 0"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"retreat": Retreat()}, r"transforms.retreat: must have a recovery that reads \['recov"),
        (
            {"retreat": Retreat(), "recovery": driving(patience=4.0)},
            r"transforms.retreat.patience=4.0: must be > transforms.recovery.patience=4.0 s",
        ),
        (
            {
                "waypoints": Waypoints(in_keys=[keys.POSE_AHEAD, keys.PATH]),
                "retreat": Retreat(),
                "recovery": driving(),
            },
            r"must read the pose of the waypoints, 'pose_ahead'",
        ),
    ],
)
def test_retreat_that_cannot_be_driven_is_rejected(steps, message):
    with pytest.raises(ValueError, match=message):
        compose(**steps)


@pytest.mark.parametrize("policy", ["navrl-best", "navrl-best-robot"])
def test_retreat_is_in_the_frame_of_the_waypoints(policy):
    words = [f"policy={policy}", "suite=smoke", "num_worlds=1"]
    cfg = config.compose("evaluate", [*words, "+transforms/steps@change.transforms=retreat"])
    steps = list(make_evaluated_policy(cfg).env.transform)
    (retreat,) = (step for step in steps if isinstance(step, Retreat))
    (waypoints,) = (step for step in steps if isinstance(step, Waypoints))
    assert retreat.in_keys[4] == waypoints.in_keys[0]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("duration", 0.1, r"duration=0.1, pause=3.0: must be >= time_step=0.2 s"),
        ("aside", 9.0, r"aside=9.0: must be > reach=0.15 m and <= max_distance=1.5 m"),
        ("reach", 0.7, r"aside=0.65: must be > reach=0.7 m"),
        ("margin", "abc", r"margin='abc': must be >= 0 m and finite"),
    ],
)
def test_values_that_contradict_each_other_are_named(name, value, message):
    with pytest.raises(ValueError, match=message):
        Retreat(**{name: value})
