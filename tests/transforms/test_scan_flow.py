"""The velocity of every return as a transform, and the shield that reads it."""

import math

import pytest
import torch
from contract import TransformContract
from lidar_envs import RoomEnv
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from navrl import keys
from navrl.networks import ScanFlow
from navrl.networks.scan_flow import load_scan_flow, save_scan_flow
from navrl.transforms import (
    ActionShield,
    EstimateFlow,
    ICPAlign,
    MinPool,
    RangeHistory,
    ScanHistory,
)

FLOW_KEYS = (keys.FLOW_POINTS, keys.FLOW_RANGES)


@pytest.fixture
def constant(tmp_path):
    """Return a function from outputs to a file of a network that has them at every bearing."""

    def write(moving, radial, tangential):
        net = ScanFlow(num_scans=2, channels=4)
        for weight in net.parameters():
            weight.data.zero_()
        net.last.bias.data = torch.tensor([moving, radial, tangential])
        save_scan_flow(net, tmp_path / "constant.safetensors")
        return tmp_path / "constant.safetensors"

    return write


@pytest.fixture(scope="module")
def any_bins(tmp_path_factory):
    """A file of the packaged network that accepts scans of any number of bins."""
    trained = load_scan_flow()
    net = ScanFlow(**{**trained.arguments, "num_bins": None})
    net.load_state_dict(trained.state_dict())
    file = tmp_path_factory.mktemp("flow") / "any.safetensors"
    save_scan_flow(net, file)
    return file


class TestEstimateFlow(TransformContract):
    tolerance = 1e-5
    has_constants = True

    @pytest.fixture(autouse=True)
    def _weights(self, any_bins):
        self.weights = any_bins

    def before(self):
        history = RangeHistory(5, group_size=1, out_keys=FLOW_KEYS)
        return [MinPool(group_size=1), ScanHistory(), ICPAlign(metric="point_to_line"), history]

    def make(self, **kwargs):
        return EstimateFlow(self.weights, **kwargs)

    def in_foreign_env(self):
        scan = [["scan", "r"], ["scan", "xy"], ["scan", "hit"]]
        past = [["past", "xy"], ["past", "hit"]]
        aligned = ["aligned", "motion", "converged", "inliers"]
        return [
            MinPool(3, 2.5, in_keys=["laser"], out_keys=scan),
            ScanHistory(in_keys=scan[1:], out_keys=past),
            ICPAlign(in_keys=[*past, *scan[1:]], out_keys=aligned),
            RangeHistory(5, 3, 2.5, in_keys=[scan[1], "motion"], out_keys=["old", "ranges"]),
            EstimateFlow(
                self.weights,
                in_keys=[*scan[1:], "ranges"],
                out_keys=[["flow", "places"], ["flow", "ok"]],
            ),
        ]


def circle(*batch):
    """Return 12 returns at 1 m, one every 30 degrees, and the ranges of 2 past scans."""
    bearing = torch.arange(12) * (math.pi / 6.0)
    points = torch.stack([bearing.cos(), bearing.sin()], dim=-1).expand(*batch, 12, 2)
    return points, torch.ones(*batch, 12, dtype=torch.bool), torch.ones(*batch, 3, 12)


def test_previous_position_follows_from_the_velocity(constant):
    points, returns, ranges = circle(3)
    flow, valid = EstimateFlow(constant(3.0, 1.0, 0.5)).map_values(points, returns, ranges)
    assert torch.equal(flow[..., 2:], points) and valid.all() and valid.shape == (3, 12, 2)
    motion = (flow[..., 2:] - flow[..., :2])[0]
    torch.testing.assert_close(motion[0], torch.tensor([0.2, 0.1]))  # ahead
    torch.testing.assert_close(motion[3], torch.tensor([-0.1, 0.2]))  # to the left


@pytest.mark.parametrize("threshold, moves", [(0.94, True), (0.96, False)])
def test_improbable_motion_is_none(threshold, moves, constant):
    """The logit 3 is a probability of 0.953."""
    step = EstimateFlow(constant(3.0, 1.0, 0.5), threshold=threshold)
    flow, valid = step.map_values(*circle())
    assert valid.all() and bool((flow[:, 2:] != flow[:, :2]).any()) is moves


def test_points_without_return_are_finite_and_not_valid(constant):
    points, returns, ranges = circle()
    points, returns = points.clone(), returns.clone()
    returns[0], points[1, 0], points[2, 1] = False, torch.nan, torch.inf
    flow, valid = EstimateFlow(constant(3.0, 1.0, 0.5)).map_values(points, returns, ranges)
    assert flow.isfinite().all() and torch.equal(flow[:3, :2], flow[:3, 2:])
    assert not valid[:3].any() and valid[3:].all()


def test_outputs_are_single_precision_without_gradient(constant):
    points, returns, ranges = circle()
    step = EstimateFlow(constant(3.0, 1.0, 0.5))
    expected = step.map_values(points, returns, ranges)[0]
    with torch.autocast("cpu", torch.bfloat16):
        flow = step.map_values(points.double(), returns, ranges.double().requires_grad_())[0]
    assert flow.dtype == torch.float32 and not flow.requires_grad
    torch.testing.assert_close(flow, expected)


def test_weights_are_neither_trained_nor_saved():
    step = EstimateFlow()
    assert not list(step.parameters()) and not step.state_dict()
    assert all(not value.requires_grad for value in step.buffers()) and list(step.buffers())
    assert step.to("meta").network.first.weight.device.type == "meta"


def test_history_of_another_length_is_an_error(any_bins):
    def chain(num_scans, num_beams):
        history = RangeHistory(num_scans, group_size=1, out_keys=FLOW_KEYS)
        steps = [MinPool(group_size=1), ScanHistory(), ICPAlign(), history, EstimateFlow(any_bins)]
        return TransformedEnv(RoomEnv(2, num_beams=num_beams), Compose(*steps))

    with pytest.raises(ValueError, match=r"num_scans=5, got \(2, 4, 48\) and \(2, 48\)"):
        _ = chain(3, 48).observation_spec
    with pytest.raises(ValueError, match="ranges: must have at least 12 bins"):
        _ = chain(5, 8).observation_spec
    assert chain(5, 48).observation_spec[keys.FLOW].shape == (2, 48, 4)


@pytest.mark.parametrize("threshold", [0.0, 1.0, math.nan, "high"])
def test_bad_threshold_is_named(threshold):
    with pytest.raises(ValueError, match=r"threshold=.*: must be between 0 and 1"):
        EstimateFlow(threshold=threshold)


def test_displacement_is_that_of_the_training(constant, tmp_path):
    """The network sees displacements from scan to scan, at any time between two scans."""
    torch.manual_seed(0)
    net = ScanFlow(num_scans=2, kernel_size=3, dilations=(1,))
    slow = ScanFlow(num_scans=2, kernel_size=3, dilations=(1,), time_step=0.4)
    slow.load_state_dict(net.state_dict())
    flows = []
    for part in (net, slow):
        part.last.bias.data[0] = 100.0
        save_scan_flow(part, tmp_path / "net.safetensors")
        flow = EstimateFlow(tmp_path / "net.safetensors").map_values(*circle(1))[0]
        flows.append(flow[..., 2:] - flow[..., :2])
    torch.testing.assert_close(2.0 * flows[0], flows[1])
    assert flows[0].abs().max() > 0.0


def test_other_numbers_of_bins_are_errors():
    with pytest.raises(ValueError, match=r"must have 180 bins, as in the training.* got 90"):
        load_scan_flow().check_shapes([1, 6, 90], [1, 90])


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(ValueError, match="no_such_file: must be a file of save_scan_flow"):
        EstimateFlow(weights=str(tmp_path / "no_such_file"))


def test_shield_evades_the_predicted_returns(constant):
    """Returns at 1 m that approach at 1.5 m/s: at full speed the front is met within 0.4 s."""
    points, returns, ranges = circle(1)
    returns = returns & (points[..., 0] > 0.9)  # straight ahead only
    step, shield = EstimateFlow(constant(3.0, -1.5, 0.0)), ActionShield(max_descriptor_speed=2.5)
    ahead = torch.tensor([[1.0, 0.0]])
    scan = TensorDict({keys.POINTS: points, keys.RETURNS: returns, keys.FLOW_RANGES: ranges}, [1])
    seen = step(scan)
    flow = shield.command(ahead, points, returns, seen[keys.FLOW], seen[keys.FLOW_VALID])
    static = torch.cat([points, points], dim=-1)
    assert torch.equal(shield.command(ahead, points, returns, static, seen["flow_valid"]), ahead)
    assert not torch.equal(flow, ahead)
