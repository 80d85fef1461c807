"""The pipelines in conf/transforms: they build, run, and say the same as the constructors."""

import inspect
from dataclasses import asdict
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from lidar_envs import RoomEnv
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from navrl import transforms
from navrl.ops.icp import PAPER, ROBUST, IcpOptions

CONF = Path(__file__).parents[2] / "conf"
NAMES = sorted(path.stem for path in (CONF / "transforms").glob("*.yaml"))


def read(name, *overrides):
    with initialize_config_dir(str(CONF), version_base=None):
        return compose(overrides=[f"+transforms={name}", *overrides]).transforms


@pytest.mark.parametrize("name", NAMES)
def test_builds_and_runs(name):
    env = TransformedEnv(RoomEnv(num_beams=1440), instantiate(read(name), _convert_="all"))
    check_env_specs(env)
    assert env.rollout(2)["temporal"].shape[-2:] == (30, 4)


def test_paper_is_the_constructors_defaults():
    for name, node in read("paper").items():
        if name == "_target_":
            continue
        signature = inspect.signature(getattr(transforms, node._target_.rpartition(".")[2]))
        for argument, value in node.items():
            if argument != "_target_":
                default = signature.parameters[argument].default
                assert (list(default) if isinstance(default, tuple) else default) == value


def test_icp_options_are_the_named_ones():
    for name, expected in (("paper", PAPER), ("robust", ROBUST)):
        step = instantiate(read(name).icp_align, _convert_="all")
        assert asdict(step.options) == asdict(expected)
    assert IcpOptions() == transforms.ICPAlign().options == PAPER


def test_null_removes_a_step_and_a_range_is_set_once():
    config = read("paper", "transforms.waypoints=null", "transforms.min_pool.max_range=5.0")
    assert config.tagd.max_range == config.normalize.scale == 5.0
    assert len(instantiate(config, _convert_="all")) == 5
