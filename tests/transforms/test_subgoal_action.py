"""An action that is a subgoal: in any environment, safe, and the same wherever it travels."""

import math
import pickle
from functools import partial

import pytest
import torch
from contract import DEVICES
from lidar_envs import RoomEnv, StrangersEnv
from tensordict import TensorDict
from torchrl.envs import (
    ActionScaling,
    Compose,
    GymWrapper,
    ParallelEnv,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs

from navrl import keys
from navrl.transforms import MinPool, SubgoalAction

LIMITS = {"max_speed": 0.8, "max_turn_rate": 1.0}


def make_env(num_worlds: int = 4, **kwargs) -> TransformedEnv:
    env = RoomEnv(num_worlds, done_rate=0.0)
    return TransformedEnv(env, Compose(MinPool(group_size=1), SubgoalAction(**LIMITS, **kwargs)))


def make_scaled_env(num_worlds: int = 4) -> TransformedEnv:
    env = make_env(num_worlds)
    env.append_transform(ActionScaling())
    return env


def actions(*batch: int, seed: int = 0) -> torch.Tensor:
    return 2.0 * torch.rand(*batch, 2, generator=torch.Generator().manual_seed(seed)) - 1.0


def test_specs_describe_a_subgoal():
    env = make_env(max_distance=1.5, max_bearing=2.0)
    check_env_specs(env)
    assert env.action_spec.space.low[0].tolist() == [0.0, -2.0]
    assert env.action_spec.space.high[0].tolist() == [1.5, 2.0]
    scaled = make_scaled_env()
    check_env_specs(scaled)
    assert scaled.action_spec.space.low.min() == -1.0 and scaled.action_spec.space.high.max() == 1.0


def test_caller_keeps_its_subgoal_action():
    env = make_scaled_env()
    seen, step = [], env.base_env._step
    env.base_env._step = lambda td: seen.append(td["action"].clone()) or step(td)
    root = env.reset().set("action", actions(4))
    stepped = env.step(root)
    assert torch.equal(stepped["action"], actions(4))
    distance, bearing = (actions(4)[:, 0] + 1) / 2, actions(4)[:, 1] * math.pi / 2
    transform = SubgoalAction(**LIMITS)
    asked = torch.stack([distance, bearing], dim=-1)
    subgoal = transform.subgoal(asked, root[keys.POINTS], root[keys.RETURNS])
    v, w = seen[0].unbind(-1)
    moving = v > 1e-3
    # turn over speed is the curvature of the arc to the subgoal
    torch.testing.assert_close(
        (w / v)[moving], (2 * subgoal[:, 1].sin() / subgoal[:, 0])[moving], rtol=1e-4, atol=1e-4
    )
    assert v.min() >= 0.0 and v.max() <= 0.8 + 1e-6 and w.abs().max() <= 1.0 + 1e-6


def test_subgoals_never_end_beyond_a_return():
    env = make_env(200)
    env.set_seed(0)
    root = env.reset()
    points, returns = root[keys.POINTS], root[keys.RETURNS]
    transform = SubgoalAction(max_distance=9.0, max_bearing=math.pi)
    asked = torch.stack([torch.full((200,), 9.0), math.pi * actions(200)[:, 0]], dim=-1)
    distance, bearing = transform.subgoal(asked, points, returns).unbind(-1)
    assert torch.equal(bearing, asked[:, 1])
    end = torch.stack([distance * bearing.cos(), distance * bearing.sin()], dim=-1)
    gap = torch.where(returns, (points - end.unsqueeze(-2)).norm(dim=-1), math.inf)
    is_limited = distance < 9.0
    assert is_limited.any()
    assert gap.amin() >= transform.radius - 1e-4
    assert gap[is_limited].amin(-1).max() <= transform.radius + 1e-4  # and no shorter than it must


def test_robot_stops_before_visible_obstacles():
    data = TensorDict({"action": torch.tensor([1.0, 0.0]), "returns": torch.tensor([True])})
    for gap, speed in ((0.4, 0.4), (0.05, 0.05), (0.0, 0.0), (-0.1, 0.0), (3.0, 1.0)):
        data["points"] = torch.tensor([[0.178 + gap, 0.0]])
        assert SubgoalAction().inv(data)["action"].tolist() == pytest.approx([speed, 0.0])


def test_requested_subgoal_is_clipped_to_its_bounds():
    points, returns = torch.zeros(1, 1, 2), torch.zeros(1, 1, dtype=torch.bool)
    asked = torch.tensor([[5.0, -3.0], [-1.0, 3.0]])
    subgoal = SubgoalAction(max_distance=1.0, max_bearing=1.5).subgoal(
        asked, points.expand(2, 1, 2), returns.expand(2, 1)
    )
    torch.testing.assert_close(subgoal, torch.tensor([[1.0, -1.5], [0.0, 1.5]]))


@pytest.mark.parametrize("kind", [SerialEnv, ParallelEnv])
def test_workers_give_equal_outputs(kind):
    fast = {"mp_start_method": "fork"} if kind is ParallelEnv else {}
    env, single = kind(2, partial(make_scaled_env, 3), **fast), make_scaled_env(3)
    env.set_seed(1)
    root = env.reset().set("action", actions(2, 3))
    root[keys.POINTS] = 0.2 * root[keys.POINTS]  # the caller's scan counts, not the worker's last
    following = env.step(root.clone())["next"]
    for worker in range(2):
        single.reset()
        single.base_env.pose = root["pose"][worker].clone()
        alone = single.step(root[worker].clone())["next"]
        torch.testing.assert_close(alone["pose"], following["pose"][worker])
    env.close(raise_if_closed=False)


def test_stored_data_contains_the_policys_action():
    data = TensorDict({"action": actions(3), "next": {"reward": torch.zeros(3, 1)}}, [3])
    assert torch.equal(SubgoalAction()(data.clone())["action"], data["action"])


def test_clone_and_pickle():
    root = make_env().reset().set("action", actions(4))
    transform = SubgoalAction(**LIMITS)
    expected = transform.inv(root)["action"]
    for copy in (transform.clone(), pickle.loads(pickle.dumps(transform))):
        assert torch.equal(copy.inv(root)["action"], expected)
    assert not list(transform.parameters()) and not list(transform.buffers())


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_any_batch_shape_and_device(batch, device):
    scan = MinPool()(TensorDict({"ranges": 3.5 * torch.rand(*batch, 1440)}, batch))
    data = scan.set("action", actions(*batch)).to(device)
    command = SubgoalAction(**LIMITS).to(device).inv(data)["action"]
    assert command.shape == (*batch, 2) and command.device.type == device
    one = SubgoalAction(**LIMITS).inv(data.reshape(-1)[-1])["action"]
    torch.testing.assert_close(command.reshape(-1, 2)[-1], one)


def test_foreign_env():
    scan = [["scan", "r"], ["scan", "xy"], ["scan", "hit"]]
    pool = MinPool(3, 2.5, in_keys=["laser"], out_keys=scan)
    subgoal = SubgoalAction(scan_keys=scan[1:])
    env = TransformedEnv(GymWrapper(StrangersEnv()), Compose(pool, subgoal, ActionScaling()))
    check_env_specs(env)
    assert env.rollout(5)["action"].abs().max() <= 1.0


@pytest.mark.parametrize("key", ["action", keys.POINTS, keys.RETURNS])
def test_missing_key_is_named(key):
    root = make_env().reset().set("action", actions(4))
    with pytest.raises(ValueError, match=f"SubgoalAction needs key '{key}'"):
        SubgoalAction().inv(root.exclude(key))
    with pytest.raises(ValueError, match="SubgoalAction needs key 'sonar'"):
        _ = make_env(scan_keys=["sonar", "echo"]).action_spec


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"max_distance": 0.0}, "max_distance=0.0: must be positive"),
        ({"max_bearing": -1.0}, "max_bearing=-1.0: must be positive"),
        ({"max_bearing": 4.0}, "max_bearing=4.0: must be at most pi"),
        ({"horizon": math.nan}, "horizon=nan: must be positive"),
        ({"radius": -0.1}, "radius=-0.1: must be positive"),
        ({"max_speed": math.inf}, "max_speed=inf: must be positive"),
        ({"max_turn_rate": 0.0}, "max_turn_rate=0.0: must be positive"),
        ({"scan_keys": ["points"]}, "scan_keys=.*: must be 2 keys"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        SubgoalAction(**arguments)
