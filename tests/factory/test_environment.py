"""What is built from a caller's objects leaves them as they were."""

import torch

from navrl import factory, keys
from navrl.config import compose, instantiate


def env_of(robot, transforms):
    cfg = compose("evaluate", [f"robot.max_speed={robot}"])
    return factory.make_env(factory.make_navigation_env(cfg, 1), transforms)


def test_one_pipeline_serves_two_environments():
    transforms = instantiate(compose("evaluate").transforms)
    count = len(transforms)
    fast, slow = env_of(1.0, transforms), env_of(0.3, transforms)
    assert len(transforms) == count and transforms.parent is None
    full = {keys.ACTION: torch.tensor([[1.0, 0.0]])}
    for env, speed in ((fast, 1.0), (slow, 0.3)):
        driven = env.transform.inv(env.fake_tensordict().update(full))[keys.ACTION]
        torch.testing.assert_close(driven, torch.tensor([[speed, 0.0]]))


def test_gymnasium_does_not_modify_overrides():
    overrides = ["scenario=corridor", "pool_size=2", "num_threads=1"]
    given = list(overrides)
    factory.make_gymnasium_env(overrides=given).close()
    assert given == overrides
