"""Odometry and scans of the full range are of the time and place of the network's scans."""

import pytest
import torch

from navrl.config import compose as composed
from navrl.config import instantiate
from navrl.envs.transformed import base_env
from navrl.factory import make_evaluated_policy
from navrl.ops import se2
from navrl.transforms import (
    ICPAlign,
    MinPool,
    MotionCompensation,
    MotionPrediction,
    compose,
)
from navrl.worlds import ScenarioBatch

AHEAD = "motion_compensation,motion_prediction"


def errors_of_alignment(steps, max_range=12.0):
    """Return the errors (m, rad) of 40 alignments of moving robots with late scans."""
    words = ["policy=navrl-best", "perturbation=scan_02", "suite=table1_200", "num_worlds=4"]
    words += [f"+transforms/steps@change.transforms=[{steps}]"]
    words += [f"+change.lidar.max_range={max_range}"]
    cfg = composed("evaluate", words)
    evaluated = make_evaluated_policy(cfg)
    base_env(evaluated.env).set_scenarios(
        ScenarioBatch.pack(instantiate(cfg.suite).scenarios(range(4)))
    )
    with torch.no_grad():
        states = evaluated.env.rollout(11, evaluated.policy, break_when_any_done=False)
    evaluated.close()
    states = states["next"]
    poses = states["pose_ahead"].double()
    moved = se2.relative(poses[:, 1:], poses[:, :-1])
    off = states["icp_transform"][:, 1:].double() - moved
    off = off[~states["done"][:, :-1, 0]]
    assert moved[..., :2].norm(dim=-1).median() > 0.1
    return off[:, :2].norm(dim=-1), off[:, 2].abs()


@pytest.mark.parametrize(
    "steps", ["odometry_prior_ahead", "odometry_prior_ahead,full_range_ahead", "full_range_ahead"]
)
def test_late_scans_are_aligned_at_the_predicted_place(steps):
    distance, angle = errors_of_alignment(f"{AHEAD},{steps}")
    assert distance.max() < 0.02 and angle.max() < 0.03


COMPENSATION = {"out_keys": ["points", "returns"], "group_size": None}
PREDICTED = ["points_measured", "returns_measured", "scan_motion_ahead"]


@pytest.mark.parametrize("prior", ["pose", "velocity"])
def test_prior_of_another_place_is_named(prior):
    with pytest.raises(ValueError, match=rf"icp_align.prior={prior}: must be pose_ahead or none"):
        compose(motion_prediction=MotionPrediction(), icp_align=ICPAlign(prior=prior))


@pytest.mark.parametrize("predicts", [False, True])
def test_full_range_of_another_time_is_named(predicts):
    moves = {"in_keys": PREDICTED} if predicts else {}
    steps = {
        "motion_prediction": MotionPrediction() if predicts else None,
        "motion_compensation": MotionCompensation(**COMPENSATION, **moves),
        "icp_align": ICPAlign(full_range=True),
    }
    needed = "full_range_ahead" if predicts else "full_range_compensated"
    with pytest.raises(ValueError, match=rf"transforms.full_range: .*steps/{needed}.yaml"):
        compose(full_range=compose(min_pool=MinPool()), **steps)
    compose(full_range=compose(moved=MotionCompensation(**COMPENSATION, **moves)), **steps)
