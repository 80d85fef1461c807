"""The environment keeps TorchRL's contract, and its own."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from navrl import factory
from navrl.config import compose
from navrl.envs import Outcome

SMALL = ["scenario=corridor", "pool_size=4", "num_threads=1", "empty_share=0"]


def make(num_worlds=3, *, seed=0, privileged=True, overrides=()):
    cfg = compose("train", [*SMALL, *overrides])
    pool = factory.make_pool(cfg)
    return factory.make_navigation_env(cfg, num_worlds, pool, seed, privileged)


@pytest.mark.parametrize("simulator", ["batched", "bullet"])
def test_specs_match_outputs(simulator):
    check_env_specs(make(2, overrides=[f"simulator={simulator}"]), seed=0)


def test_seed_fixes_the_episodes():
    def play(seed):
        env = make(seed=seed, privileged=False)
        torch.manual_seed(0)
        return env.rollout(30, break_when_any_done=False)

    first, again, other = play(1), play(1), play(2)
    assert (first == again).all()
    assert not torch.equal(first["pose"], other["pose"])


def test_partial_reset_leaves_other_worlds_unchanged():
    env = make(3)
    start = env.reset()
    kept = start.clone()
    start["action"] = env.action_spec.rand()
    stepped = env.step(start)["next"].clone()
    mask = torch.tensor([[False], [True], [False]])
    stepped["_reset"] = mask
    after = env.reset(stepped.clone())
    for key in ("ranges", "pose", "path"):
        assert torch.equal(after[key][[0, 2]], stepped[key][[0, 2]]), key
        assert not torch.equal(after[key][1], stepped[key][1]), key
        assert torch.equal(start[key], kept[key]), f"{key} of an earlier step changed"


def test_reward_is_the_sum_of_its_terms():
    batch = make(4).rollout(20, break_when_any_done=False)["next"]
    total = sum(batch["reward_terms"].values())
    torch.testing.assert_close(batch["reward"], total)
    assert set(batch["reward_terms"].keys()) == {"collision", "guidance", "proximity", "progress"}


def test_time_limit_truncates_and_does_not_terminate():
    env = make(2, overrides=["environment.time_limit_steps=3"])
    td = env.reset()
    for step in range(3):
        td["action"] = torch.zeros(2, 2)
        td = env.step(td)["next"]
        assert bool(td["truncated"].all()) == (step == 2)
    assert not td["terminated"].any()
    assert (td["outcome"] == Outcome.TIMEOUT).all()


def test_driving_ahead_terminates_in_a_collision():
    env = make(4)
    td = env.reset()
    seen = torch.zeros(4, 1, dtype=torch.bool)
    for _ in range(60):
        td["action"] = torch.tensor([[1.0, 1.0]]).expand(4, 2)
        td = env.step(td)["next"]
        hit = (td["outcome"] == Outcome.COLLISION_STATIC) | (
            td["outcome"] == Outcome.COLLISION_PEDESTRIAN
        )
        assert (td["terminated"] >= hit).all()
        assert (td["reward_terms", "collision"][hit] == -10).all()
        seen |= hit
    assert seen.all()


def test_clearance_is_measured_from_hull_to_surface():
    env = make(2)
    td = env.reset()
    boxes, pose = td["pedestrian_boxes"], td["pose"]
    for world in range(2):
        gaps = []
        for cx, cy, hx, hy, yaw in boxes[world].tolist():
            if cx != cx:
                continue
            dx, dy = pose[world, 0].item() - cx, pose[world, 1].item() - cy
            c, s = torch.cos(torch.tensor(yaw)).item(), torch.sin(torch.tensor(yaw)).item()
            ex = max(abs(c * dx + s * dy) - hx, 0.0)
            ey = max(abs(c * dy - s * dx) - hy, 0.0)
            gaps.append((ex**2 + ey**2) ** 0.5 - 0.178)
        assert td["pedestrian_clearance"][world].item() == pytest.approx(min(gaps), abs=1e-4)


def test_set_scenarios_requires_one_per_world():
    env = make(3)
    with pytest.raises(ValueError, match="one for each of 3 worlds, got 2"):
        env.set_scenarios(env.scenarios.batch[torch.arange(2)])


def test_curriculum_limits_the_drawn_pedestrians():
    env = make(64)
    env.max_dynamic = 2
    boxes = env.reset()["pedestrian_boxes"]
    present = (~boxes[..., 0].isnan()).sum(-1)
    assert present.max() <= 2 + 2
    env.max_dynamic = 8
    more = (~env.reset()["pedestrian_boxes"][..., 0].isnan()).sum(-1)
    assert more.max() > 5
