"""The guide where actions are subgoals: it names a waypoint, and drives to goals without people."""

import math

import pytest
import torch
from tensordict import TensorDict

from navrl import factory, jobs, keys
from navrl.config import compose, instantiate
from navrl.evaluation import evaluate
from navrl.policies import load_bundle
from navrl.policies.classical import WaypointSubgoal
from navrl.transforms import SubgoalAction
from navrl.worlds import ScenarioBatch


def asked(policy, points):
    return policy(TensorDict({keys.WAYPOINTS: torch.tensor(points)}, []))[keys.ACTION].tolist()


def test_waypoint_is_returned_as_a_normalized_subgoal():
    policy = WaypointSubgoal(max_distance=1.0, max_bearing=math.pi / 2, waypoint=1)
    assert asked(policy, [[0.0, 0.0], [0.3, 0.3]]) == pytest.approx([0.6 * 2**0.5 - 1, 0.5])
    assert asked(policy, [[0.0, 0.0], [-4.0, -1.0]]) == [1.0, -1.0]


@pytest.mark.parametrize("bad", [{"max_distance": 0.0}, {"max_bearing": -1.0}, {"waypoint": -1}])
def test_bad_arguments_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        WaypointSubgoal(**bad)
    with pytest.raises(ValueError, match="waypoint=2: must be < 2"):
        asked(WaypointSubgoal(waypoint=2), [[0.0, 0.0], [0.3, 0.3]])


@pytest.fixture(scope="module")
def cfg():
    people = [
        "suite.version=null",
        "suite.distribution.num_dynamic=[0,0]",
        "suite.distribution.num_static=[0,0]",
    ]
    return compose("train", ["experiment=subgoal", "num_threads=1", *people])


def test_guide_reaches_goals_without_pedestrians(cfg):
    env = factory.make_env(
        factory.make_navigation_env(cfg, 6, privileged=True), instantiate(cfg.transforms)
    )
    guide = instantiate(cfg.behavior.guide)
    scenarios = instantiate(cfg.suite).scenarios(range(6))
    records = evaluate(env, guide, ScenarioBatch.pack(scenarios))
    assert [record.outcome for record in records] == ["success"] * 6


def test_bundle_contains_its_subgoal_action(cfg, tmp_path):
    env = factory.make_env(factory.make_navigation_env(cfg, 2), instantiate(cfg.transforms))
    shapes = factory.observation_shapes(env)
    actor, _ = factory.make_agent(cfg, shapes)
    factory.save_policy(cfg, actor, shapes, tmp_path / "policy", {"success_rate": 0.0})
    pipeline = load_bundle(tmp_path / "policy").build("transforms")
    assert [type(step) for step in pipeline][-1] is SubgoalAction
    recording = jobs.record(compose("play", [f"policy={tmp_path}", "suite=smoke"]))
    speed, turn_rate = recording.action.T  # physical: an arc to the subgoal, never backwards
    assert (speed >= 0).all() and (speed <= 1).all() and (abs(turn_rate) <= math.pi).all()
    assert recording.tagd is None and recording.spatial_attention.shape[-1] == 30
