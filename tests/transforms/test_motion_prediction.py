"""Pose and scan in the frame in which the robot will be when its command takes effect."""

import math

import torch
from tensordict import TensorDict

from navrl.ops import se2
from navrl.transforms import MotionCompensation, MotionPrediction, Waypoints, compose


def test_scan_and_pose_have_the_predicted_frame():
    ahead = torch.tensor([[0.2, 0.1, 0.5]])
    pose = torch.tensor([[3.0, -1.0, 2.0]], dtype=torch.float64)
    scan = torch.tensor([[[-0.3, 0.0, 0.1], [-0.1, 0.05, 0.0]]])
    predicted, frames = MotionPrediction()(motion_ahead=ahead, pose=pose, scan_motion=scan)
    assert predicted.dtype == torch.float64
    torch.testing.assert_close(predicted, se2.compose(pose, ahead.double()))
    # A point seen at the first beam is at the same place of the world by either frame.
    point = torch.tensor([[[2.0, 1.0]]])
    now = se2.transform_points(scan[:, 0], point)
    torch.testing.assert_close(
        se2.transform_points(ahead, se2.transform_points(frames[:, 0], point)), now
    )


def test_waypoints_and_points_refer_to_the_predicted_frame():
    steps = compose(
        prediction=MotionPrediction(),
        motion_compensation=MotionCompensation(
            in_keys=["points_measured", "returns_measured", "scan_motion_ahead"],
            group_size=1,
            out_keys=["points", "returns"],
        ),
        waypoints=Waypoints(num_waypoints=1, spacing=1.0, in_keys=["pose_ahead", "path"]),
    )
    data = TensorDict(
        {
            "motion_ahead": torch.tensor([[0.5, 0.0, 0.0]]),
            "scan_motion": torch.zeros(1, 2, 3),
            "pose": torch.tensor([[1.0, 0.0, 0.0]]),
            "path": torch.stack([torch.linspace(0, 5, 51), torch.zeros(51)], -1)[None],
            "points_measured": torch.tensor([[[2.0, 0.0], [0.0, 1.0], [-2.0, 0.0], [0.0, -1.0]]]),
            "returns_measured": torch.ones(1, 4, dtype=torch.bool),
        },
        [1],
    )
    for step in steps:
        data = step._call(data)
    torch.testing.assert_close(data["points"][0, 0], torch.tensor([1.5, 0.0]))
    torch.testing.assert_close(data["waypoints"][0, 0], torch.tensor([1.0, 0.0]), atol=0.02, rtol=0)
    assert math.isclose(float(data["path_progress"]), 1.5, abs_tol=0.02)
