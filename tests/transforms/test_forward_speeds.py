"""A policy trained to drive forwards keeps its speeds on a base that can reverse."""

import pytest
import torch

from navrl.config import compose, instantiate
from navrl.factory.environment import make_env, make_navigation_env, make_pool
from navrl.transforms import ActionShield, ForwardSpeeds

PLAY = [
    "scenario=corridor",
    "pool_size=4",
    "num_worlds=4",
    "simulator.num_worlds=4",
    "progress_bar=false",
]
STEP = "+transforms/steps@transforms=reversing"


def drive(*overrides):
    """Return the commands that the base is given for the same actions in [-1, 1]."""
    cfg = compose("train", [*PLAY, *overrides])
    env = make_env(make_navigation_env(cfg, 4, make_pool(cfg)), instantiate(cfg.transforms))
    data = env.reset()
    data["action"] = torch.tensor([[-1.0, 0.5], [0.0, -0.5], [0.5, 0.0], [1.0, 1.0]])
    return env.step(data)["next", "command"]


def test_actions_are_the_speeds_of_the_training():
    expected = drive()
    assert expected[:, 0].tolist() == [0.0, 0.5, 0.75, 1.0]
    backwards = drive("robot.min_speed=-0.5")
    assert backwards[0, 0] == -0.5  # a stop of the policy has become a speed
    no_shield = [STEP, "transforms.action_shield=null"]
    torch.testing.assert_close(drive("robot.min_speed=-0.5", *no_shield), expected)


def test_step_without_reversing_changes_nothing():
    command = torch.rand(100, 2, generator=torch.Generator().manual_seed(0))
    forward = ForwardSpeeds(min_speed=0.0, max_speed=0.7)
    torch.testing.assert_close(forward.command(command), command)


def test_shield_reverses_before_a_pedestrian():
    """One that cannot reverse has no command that avoids the contact."""
    points = torch.tensor([[[0.45, 0.0]]])
    descriptors = torch.tensor([[[0.65, 0.0, 0.45, 0.0]]])  # 1 m/s towards the robot
    seen = points, torch.ones(1, 1).bool(), descriptors, torch.ones(1, 1, 2).bool()
    stop = torch.zeros(1, 2)
    shielded = {
        low: ActionShield(min_speed=low, max_turn_rate=0.1).command(stop, *seen)[0, 0].item()
        for low in (0.0, -1.0)
    }
    assert shielded[0.0] == 0.0
    assert shielded[-1.0] < -0.3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_speed": 0.1}, "min_speed=0.1: must be at most 0"),
        ({"max_speed": 0.0}, "max_speed=0.0: must be"),
        ({"min_speed": float("-inf")}, "min_speed=-inf"),
    ],
)
def test_speeds_out_of_range_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        ForwardSpeeds(**options)
