"""What the saved policy has beyond what it was trained with."""

import pytest
from omegaconf import OmegaConf
from runs import TINY

from navrl import factory, jobs
from navrl.config import compose, instantiate
from navrl.factory.environment import make_training_env
from navrl.factory.training import Validation
from navrl.policies import load_bundle
from navrl.policies.classical import StandStill
from navrl.sim import DifferentialDrive, LimitedDrive
from navrl.transforms import ActionShield, MinPool


@pytest.fixture(scope="module")
def cfg():
    tiny = [word for word in TINY if word != "network=small"]
    return compose("train", [*tiny, "experiment=navrl-best", "robot.max_speed=0.6"])


def test_shield_is_in_the_bundle_and_not_in_training(cfg, tmp_path):
    env = make_training_env(cfg, seed=0, num_worlds=1)
    assert not any(isinstance(step, ActionShield) for step in env.transform)
    shapes = factory.observation_shapes(env)
    actor, _ = factory.make_agent(cfg, shapes)
    factory.save_policy(cfg, actor, shapes, tmp_path / "policy", {})
    steps = [*load_bundle(tmp_path / "policy").build("transforms")]
    assert isinstance(steps[0], MinPool) and isinstance(steps[-1], ActionShield)
    recording = jobs.record(
        compose("play", [f"policy={tmp_path}", "suite=smoke", "environment.time_limit_steps=3"])
    )
    assert recording.action[:, 0].max() <= 0.6


def test_run_without_deployment_key_saves_its_transforms(cfg, tmp_path):
    older = OmegaConf.masked_copy(cfg, [key for key in cfg if key != "deployment"])
    shapes = factory.observation_shapes(make_training_env(older, seed=0, num_worlds=1))
    actor, _ = factory.make_agent(older, shapes)
    factory.save_policy(older, actor, shapes, tmp_path / "policy", {})
    config = load_bundle(tmp_path / "policy").config
    assert "action_shield" not in config["transforms"]


def test_invalid_deployment_fails_before_training(cfg, tmp_path):
    wrong = cfg.copy()
    wrong.deployment.transforms.action_shield.horizon = -1.0
    with pytest.raises(Exception, match="horizon"):
        factory.make_trainer(wrong, tmp_path)


def test_validation_plays_the_deployed_transforms_if_set(cfg):
    changed = cfg.copy()
    actor = StandStill(instantiate(cfg.robot))
    for is_deployed in (False, True):
        changed.validation.deployed = is_deployed
        env = Validation(changed, actor)._env
        assert any(isinstance(step, ActionShield) for step in env.transform) == is_deployed
        env.close()


def test_saved_policy_has_the_robot_and_lidar_of_the_deployment(tmp_path):
    tiny = [word for word in TINY if word != "network=small"]
    cfg = compose("train", [*tiny, "experiment=robot"])
    shapes = factory.observation_shapes(make_training_env(cfg, seed=0, num_worlds=1))
    actor, _ = factory.make_agent(cfg, shapes)
    factory.save_policy(cfg, actor, shapes, tmp_path / "policy", {})
    bundle = load_bundle(tmp_path / "policy")
    assert type(bundle.build("robot")) is DifferentialDrive  # LimitedDrive is a subclass
    expected = compose("train", tiny).lidar
    assert bundle.config["lidar"] == OmegaConf.to_container(expected, resolve=True)
    assert isinstance(instantiate(cfg.robot), LimitedDrive)  # that of training
