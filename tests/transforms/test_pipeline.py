"""The shield is the last to change a command, wherever a configuration lists it."""

import torch
from lidar_envs import RoomEnv
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from navrl.ops.scanner import Scanner
from navrl.transforms import (
    TAGD,
    ActionShield,
    ICPAlign,
    MinPool,
    ScanAdapter,
    ScanHistory,
    SubgoalAction,
    compose,
)
from navrl.transforms.action_map import ActionMap


class FullSpeed(ActionMap):
    """Replace every command by full speed ahead."""

    def __init__(self):
        super().__init__((), (), "action")

    def command(self, action):
        return torch.tensor([1.0, 0.0]).expand_as(action)


def before_a_wall():
    return TensorDict(
        {
            "action": torch.tensor([[0.0, 0.0]]),
            "points": torch.tensor([[[0.3, 0.0]]]),
            "returns": torch.tensor([[True]]),
            "tagd": torch.zeros(1, 1, 4),
            "tagd_valid": torch.zeros(1, 1, 2, dtype=torch.bool),
        },
        1,
    )


def test_shield_checks_the_command_of_any_other_step():
    shielded = ActionShield().command(torch.tensor([[1.0, 0.0]]), *_scan())
    for steps in (
        {"first": FullSpeed(), "shield": ActionShield()},
        {"shield": ActionShield(), "last": FullSpeed()},
    ):
        found = compose(**steps).inv(before_a_wall())["action"]
        assert torch.equal(found, shielded) and found[0, 0] < 1.0


def _scan():
    scene = before_a_wall()
    return (scene[key] for key in ("points", "returns", "tagd", "tagd_valid"))


def test_shield_reads_keys_of_steps_listed_after_it():
    chain = compose(
        shield=ActionShield(), pool=MinPool(), history=ScanHistory(), icp=ICPAlign(), tagd=TAGD()
    )
    env = TransformedEnv(RoomEnv(), chain)
    assert isinstance(chain[-1], ActionShield)
    env.rollout(2)


def test_order_without_a_shield_is_the_given_one():
    chain = compose(subgoal=SubgoalAction(), pool=MinPool())
    assert [type(step) for step in chain] == [SubgoalAction, MinPool]


def test_scan_adapter_comes_first():
    chain = compose(pool=MinPool(), scan_adapter=ScanAdapter(Scanner(num_beams=360)))
    assert [type(step) for step in chain] == [ScanAdapter, MinPool]
