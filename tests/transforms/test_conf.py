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
from navrl.ops.icp_options import PAPER, ROBUST, IcpOptions

CONF = Path(__file__).parents[2] / "conf"
NAMES = sorted(path.stem for path in (CONF / "transforms").glob("*.yaml"))
OURS = {"spatial": (180, 2), "temporal": (30, 4), "waypoints_scaled": (5, 2)}
MOTION = ("velocity_scaled", "command_scaled")
INPUTS = {  # of the networks; those of the pipelines not named here are the paper's
    "distances": {"ranges_pooled_scaled": (180,), "waypoints_scaled": (5, 2)},
    "liang": {
        **dict.fromkeys(
            ("ranges_pooled_scaled", "ranges_previous_scaled", "ranges_earlier_scaled"), (180,)
        ),
        "waypoints_scaled": (5, 2),
    },
    "liang_original": {
        **dict.fromkeys(
            ("ranges_pooled_scaled", "ranges_previous_scaled", "ranges_earlier_scaled"), (512,)
        ),
        "goal_position_scaled": (2,),
    },
    "navrl_best": {"ranges_history_scaled": (4, 180), "waypoints_scaled": (5, 2)},
    "navrl_best_compensated": {"ranges_history_scaled": (4, 180), "waypoints_scaled": (5, 2)},
    "navrl_best_robot": {
        "ranges_history_scaled": (4, 180),
        **dict.fromkeys(MOTION, (2,)),
    },
    "paper_robot": {**OURS, **dict.fromkeys(MOTION, (2,))},
    "perez_darpino": {
        "ranges_pooled_scaled": (128,),
        "goal_position_scaled": (2,),
        "waypoints_scaled": (6, 2),
    },
    "subgoal": {"spatial": (180, 2), "waypoints_scaled": (5, 2)},
}
BEAMS = {"liang_original": 1536, "perez_darpino": 1536}


def read(name, *overrides):
    with initialize_config_dir(str(CONF), version_base=None):
        return compose(overrides=["+robot=kobuki", f"+transforms={name}", *overrides]).transforms


@pytest.mark.parametrize("name", NAMES)
def test_pipeline_builds_and_runs(name):
    room = RoomEnv(num_beams=BEAMS.get(name, 1440))
    env = TransformedEnv(room, instantiate(read(name), _convert_="all"))
    check_env_specs(env)
    rollout = env.rollout(2)
    for key, shape in INPUTS.get(name, OURS).items():
        assert tuple(rollout[key].shape[2:]) == shape
        assert rollout[key].abs().max() <= 2.0  # scaled
    assert rollout["waypoints"].shape[2:] == (5, 2)  # for guides, controllers and pictures


def test_waypoints_far_ahead_lie_on_the_same_projection():
    steps = instantiate(read("perez_darpino"), _convert_="all")
    env = TransformedEnv(RoomEnv(num_beams=1536), steps)
    rollout = env.rollout(3)
    near, far = 3.5 * rollout["waypoints_scaled"][..., 0, :], rollout["waypoints"][..., 2:4, :]
    assert (near - far.mean(-2)).norm(dim=-1).max() < 0.2  # 1.0 m: between 0.9 m and 1.2 m


def test_paper_config_equals_the_defaults():
    for name, node in read("paper").items():
        if name == "_target_" or node is None:
            continue
        signature = inspect.signature(getattr(transforms, node._target_.rpartition(".")[2]))
        for argument, value in node.items():
            if argument != "_target_":
                default = signature.parameters[argument].default
                assert (list(default) if isinstance(default, tuple) else default) == value


def test_icp_options_equal_the_named_options():
    for name, expected in (("paper", PAPER), ("robust", ROBUST)):
        step = instantiate(read(name).icp_align, _convert_="all")
        assert asdict(step.options) == asdict(expected)
    assert IcpOptions() == transforms.ICPAlign().options == PAPER


def test_null_removes_a_step_and_a_range_is_set_once():
    config = read("paper", "transforms.waypoints=null", "transforms.min_pool.max_range=5.0")
    assert config.tagd.max_range == config.normalize.scale == 5.0
    assert len(instantiate(config, _convert_="all")) == 5
