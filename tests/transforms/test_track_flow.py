"""Moving returns that are followed through past scans as a transform."""

import math

import pytest
import torch
from contract import TransformContract, make_env
from lidar_envs import RoomEnv
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from navrl import keys
from navrl.networks import ScanFlow
from navrl.networks.scan_flow import save_scan_flow
from navrl.ops import se2
from navrl.ops.motion import FAR
from navrl.transforms import EstimateFlow, ICPAlign, MinPool, RangeHistory, ScanHistory, TrackFlow

FLOW_KEYS = (keys.FLOW_POINTS, keys.FLOW_RANGES)


class TestTrackFlow(TransformContract):
    is_memoryless = False
    state_keys = (keys.FLOW, keys.FLOW_VALID, keys.TRACKS_POINTS)
    tolerance = 1e-4

    @pytest.fixture(autouse=True)
    def lively(self, tmp_path):
        """A file of a network without training, by which about half of the returns move."""
        torch.manual_seed(0)
        net = ScanFlow()
        net.last.bias.data[0] -= 1.0
        self.file = tmp_path / "lively.safetensors"
        save_scan_flow(net, self.file)

    def before(self):
        history = RangeHistory(5, group_size=1, out_keys=FLOW_KEYS)
        align = ICPAlign(metric="point_to_line")
        flow = EstimateFlow(self.file)
        return [MinPool(group_size=1), ScanHistory(), align, history, flow]

    def make(self, **kwargs):
        return TrackFlow(**{"num_scans": 2, **kwargs})

    def in_foreign_env(self):
        scan = [["scan", "r"], ["scan", "xy"], ["scan", "hit"]]
        past = [["past", "xy"], ["past", "hit"]]
        aligned = ["aligned", "motion", "converged", "inliers"]
        flow = [["flow", "places"], ["flow", "ok"]]
        return [
            MinPool(3, 2.5, in_keys=["laser"], out_keys=scan),
            ScanHistory(in_keys=scan[1:], out_keys=past),
            ICPAlign(in_keys=[*past, *scan[1:]], out_keys=aligned),
            RangeHistory(5, 3, 2.5, in_keys=[scan[1], "motion"], out_keys=["old", "ranges"]),
            EstimateFlow(self.file, in_keys=[*scan[1:], "ranges"], out_keys=flow),
            TrackFlow(in_keys=[*flow, "motion"], out_keys=[["tracks", "xy"], "ok", "moving"]),
        ]

    def check_rollout(self, rollout):
        flow, past = rollout[keys.FLOW], rollout["next", keys.TRACKS_POINTS]
        moves = (flow[..., :2] != flow[..., 2:]).any(-1) & rollout[keys.FLOW_VALID].all(-1)
        assert moves.any() and not moves.all()
        moved = rollout["next", keys.ICP_TRANSFORM]
        latest = se2.transform_points(moved, flow[..., 2:])
        latest = torch.where(moves.unsqueeze(-1), latest, FAR)
        torch.testing.assert_close(past[..., 0, :, :], latest)
        before = rollout[keys.TRACKS_POINTS][..., 0, :, :]
        older = se2.transform_points(moved, before)
        older = torch.where((before == FAR).all(-1, keepdim=True), FAR, older)
        torch.testing.assert_close(past[..., 1, :, :], older)
        ended = rollout["next", "done"][..., :-1, 0]
        fresh = rollout[..., 1:][ended]  # there is no past
        assert (fresh[keys.TRACKS_POINTS] == FAR).all()
        assert not fresh[keys.TRACKS_VALID][..., 0].any()
        assert rollout["next", keys.TRACKS_VALID].all(-1).any()

    def test_shapes_follow_from_the_options(self):
        observed = TrackFlow(4, num_groups=12, **self.options()).transform_observation_spec(
            self.specs()
        )
        assert observed["tracks"].shape == (4, 12, 4)
        assert observed["tracks_valid"].shape == (4, 12, 2)
        assert observed["tracks_points"].shape == (4, 4, 48, 2)

    def test_state_is_declared(self):
        """After a reset nothing moves here, so a rollout alone does not need it."""
        state = make_env(self.steps()).full_state_spec
        assert all(key in state.keys(True, True) for key in self.state_keys)

    def options(self):
        return {"radius": 0.5, "gate": 0.5}

    def specs(self):
        return TransformedEnv(RoomEnv(4, num_beams=48), Compose(*self.before())).observation_spec


def flow_of(x, moves=True, yaw=0.0):
    """A step with a return at (x, 0) in the world, seen by a robot at the origin, and a wall."""
    points = torch.tensor([[x, 0.0], [1.0, 1.0]])
    before = points.clone()
    before[0, 0] -= 0.01 if moves else 0.0
    flow = torch.cat([before, points], dim=-1)[None]
    flow = torch.cat([se2.rotate(part, torch.tensor(-yaw)) for part in flow.split(2, -1)], dim=-1)
    valid = torch.ones(1, 2, 2, dtype=torch.bool)
    return TensorDict({keys.FLOW: flow, keys.FLOW_VALID: valid}, [1])


def followed(scans, step, turn=0.0):
    """Return the outputs at the last of several scans, the robot turning in each step."""
    still = torch.zeros(1, 3)
    root = step(scans[0].set(keys.ICP_TRANSFORM, still))
    for scan in scans[1:]:
        scan.set(keys.ICP_TRANSFORM, torch.tensor([[0.0, 0.0, -turn]]))
        root = step._step(root, scan)
    return root


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_velocity_is_that_of_the_positions_not_of_the_flow(turn):
    """The flow is 0.01 m, the return moves 0.2 m per step; the robot turns at the same time."""
    scans = [flow_of(1.0 + 0.2 * k, yaw=turn * k) for k in range(6)]
    last = followed(scans, TrackFlow(), turn)
    moved = last[keys.TRACKS_VALID].all(-1)
    assert moved.any()
    before, now = last[keys.TRACKS][moved].split(2, dim=-1)
    ahead = torch.tensor([math.cos(5 * turn), -math.sin(5 * turn)])
    torch.testing.assert_close(now, (2.0 * ahead).expand_as(now), atol=1e-4, rtol=0.0)
    torch.testing.assert_close(now - before, (0.2 * ahead).expand_as(now), atol=1e-4, rtol=0.0)


def test_first_step_has_positions_without_past_or_motion():
    first = followed([flow_of(1.0)], TrackFlow())
    assert (first[keys.TRACKS_POINTS] == FAR).all()
    valid = first[keys.TRACKS_VALID]
    assert valid[..., 1].any() and not valid[..., 0].any()
    assert torch.equal(first[keys.TRACKS][..., :2], first[keys.TRACKS][..., 2:])


def test_reset_of_one_row_retains_the_past_of_the_other():
    step = TrackFlow()
    one = followed([flow_of(1.0 + 0.2 * k) for k in range(3)], step)
    two = torch.cat([one, one.clone()])
    mask = torch.tensor([[True], [False]])
    fresh = two.select(*step.in_keys)
    after = step._reset(two.clone().set("_reset", mask), fresh)
    assert (after[keys.TRACKS_POINTS][0] == FAR).all()
    assert not after[keys.TRACKS_VALID][0, :, 0].any()
    for key in step.out_keys:
        assert torch.equal(after[key][1], two[key][1])
    assert after[keys.TRACKS_VALID][1].all(-1).any()


def test_returns_without_flow_are_not_followed():
    last = followed([flow_of(1.0 + 0.2 * k, moves=False) for k in range(6)], TrackFlow())
    assert not last[keys.TRACKS_VALID].any() and (last[keys.TRACKS_POINTS] == FAR).all()


def test_points_that_are_not_valid_are_not_followed():
    scans = [flow_of(1.0 + 0.2 * k) for k in range(6)]
    for scan in scans:
        scan[keys.FLOW_VALID][:, 0] = False
    assert not followed(scans, TrackFlow())[keys.TRACKS_VALID].any()


def test_outputs_are_single_precision():
    scans = [flow_of(1.0 + 0.2 * k) for k in range(3)]
    expected = followed([scan.clone() for scan in scans], TrackFlow())
    doubled = [scan.set(keys.FLOW, scan[keys.FLOW].double()) for scan in scans]
    with torch.autocast("cpu", torch.bfloat16):
        last = followed(doubled, TrackFlow())
    assert last[keys.TRACKS].dtype == last[keys.TRACKS_POINTS].dtype == torch.float32
    torch.testing.assert_close(last[keys.TRACKS], expected[keys.TRACKS])


@pytest.mark.parametrize(
    "kwargs, message",
    [
        ({"num_scans": 0}, "num_scans=0"),
        ({"num_groups": 0}, "num_groups=0"),
        ({"radius": -1.0}, r"radius=-1\.0: must be positive"),
        ({"gate": 0.1}, r"gate=0\.1: must be at least radius=0\.6"),
        ({"in_keys": ["flow"]}, "TrackFlow: in_keys=.*: must be three each"),
        ({"out_keys": ["tracks"]}, "TrackFlow: .*out_keys=.*: must be three each"),
    ],
)
def test_bad_arguments_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        TrackFlow(**kwargs)
