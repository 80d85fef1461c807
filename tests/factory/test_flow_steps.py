"""The steps of the scan flow and its tracks in pipelines of bundles, controllers and trainings."""

import numpy as np
import pytest

from navrl import keys
from navrl.config import compose, instantiate
from navrl.deploy import PolicyRunner
from navrl.envs.transformed import base_env
from navrl.evaluation.recorder import record_episode
from navrl.factory import make_evaluated_policy
from navrl.factory.policy import make_runner
from navrl.factory.training import deployed
from navrl.jobs.changed_bundle import export_bundle
from navrl.policies import load_bundle
from navrl.transforms import ActionShield, EstimateFlow, ICPAlign, RangeHistory, Recovery, TrackFlow
from navrl.worlds import ScenarioBatch

STEPS = "+transforms/steps@change.transforms"
TRACK_KEYS = ["points", "returns", "tracks", "tracks_valid"]
FLOW_KEYS = ["points", "returns", "flow", "flow_valid"]
CASES = [
    ("navrl-best-places", "track_shield"),
    ("paper", "track_shield"),
    ("navrl-best-places", "[recovery,odometry_prior,track_shield]"),
    ("paper", "[base_shield,track_shield]"),
    ("navrl-best-predictive", "track_shield"),
    ("dwa", "track_shield"),
]


def config(policy, steps, *words):
    return compose("evaluate", [f"policy={policy}", "num_worlds=2", f"{STEPS}={steps}", *words])


def index(steps, kind, **values):
    """Return the place of the last step of a class with these attributes."""
    (*_, place) = (
        place
        for place, step in enumerate(steps)
        if isinstance(step, kind) and all(getattr(step, k) == v for k, v in values.items())
    )
    return place


@pytest.mark.parametrize("policy, steps", CASES)
def test_shield_reads_the_tracks_in_any_pipeline(policy, steps):
    env = make_evaluated_policy(config(policy, steps, "suite=smoke")).env
    chain = list(env.transform)
    history = index(chain, RangeHistory, out_keys=[keys.FLOW_POINTS, keys.FLOW_RANGES])
    flow, tracks = index(chain, EstimateFlow), index(chain, TrackFlow)
    shield = index(chain, ActionShield)
    assert index(chain, ICPAlign) < history < flow < tracks < shield
    assert chain[shield].scan_keys[:4] == TRACK_KEYS
    assert chain[history].num_scans == chain[tracks].num_scans == 5
    assert chain[shield].times[-1] == pytest.approx(1.2)
    if "base_shield" in steps or policy == "navrl-best-predictive":
        assert chain[shield].base == "environment"
    if "recovery" in steps:
        recovery = chain[index(chain, Recovery)]
        assert recovery.scan_keys[2:4] == [keys.TAGD, keys.TAGD_VALID]
        assert chain[index(chain, ICPAlign)].prior == "pose"


def test_flow_shield_reads_the_flow_without_tracks():
    env = make_evaluated_policy(config("paper", "flow_shield", "suite=smoke")).env
    chain = list(env.transform)
    shield = chain[index(chain, ActionShield)]
    assert shield.scan_keys == FLOW_KEYS and shield.group_radius == 0.05
    assert not any(isinstance(step, TrackFlow) for step in chain)
    assert shield.times[-1] == pytest.approx(1.2)


def test_history_reads_the_covered_bins_as_the_network_does():
    pooled = "++change.transforms.min_pool.out_keys=[ranges_pooled,points,returns,seen]"
    seen = "++change.transforms.range_history.in_keys=[points,icp_transform,seen]"
    fov = "+change.lidar.field_of_view=4.712"
    cfg = config("navrl-best-places", "track_shield", "suite=smoke", pooled, seen, fov)
    env = make_evaluated_policy(cfg).env
    (history,) = (s for s in env.transform if keys.FLOW_RANGES in s.out_keys)
    assert history.in_keys == ["points", "icp_transform", "seen"]
    base_env(env).set_scenarios(ScenarioBatch.pack(instantiate(cfg.suite).scenarios([1, 2])))
    assert env.reset()[keys.FLOW].isfinite().all()


def test_flow_is_deployed_with_a_trained_policy():
    step = "+transforms/steps@deployment.transforms=track_shield"
    cfg = compose("train", ["experiment=paper", step])
    assert "flow" not in cfg.transforms
    *_, flow, tracks, shield = instantiate(deployed(cfg).transforms)
    assert isinstance(flow, EstimateFlow) and isinstance(tracks, TrackFlow)
    assert isinstance(shield, ActionShield)
    replaced = ["experiment=navrl-best-places", step.removeprefix("+")]
    assert deployed(compose("train", replaced)).transforms.action_shield.scan_keys == TRACK_KEYS


def test_bundle_with_the_flow_is_saved_without_weights(tmp_path):
    words = ["policy=paper", "format=bundle", f"{STEPS}=track_shield"]
    export_bundle(compose("export", words), tmp_path / "flow")
    saved = load_bundle(tmp_path / "flow").config["transforms"]
    assert saved["flow"]["weights"] is None and saved["action_shield"]["scan_keys"] == TRACK_KEYS
    assert len([*(tmp_path / "flow").glob("*.safetensors")]) == 1  # of the actor
    runner = PolicyRunner.from_bundle(tmp_path / "flow")
    command = runner.act([3.0] * 1440, pose=(0.0, 0.0, 0.0), path=[(0.0, 0.0), (4.0, 0.0)])
    assert np.isfinite(command).all()


def test_missing_weights_are_named(tmp_path):
    words = f"change.transforms.flow.weights={tmp_path / 'none'}"
    with pytest.raises(Exception, match="none: must be a file of save_scan_flow"):
        make_evaluated_policy(config("paper", "track_shield", "suite=smoke", words))


def test_tracks_are_a_step_without_a_shield():
    chain = list(make_evaluated_policy(config("paper", "tracks", "suite=smoke")).env.transform)
    assert index(chain, EstimateFlow) < index(chain, TrackFlow)
    assert not any(isinstance(step, ActionShield) for step in chain)


@pytest.mark.parametrize("steps", ["track_shield", "flow_shield"])
def test_runner_with_the_flow_drives_as_in_simulation(steps, lively):
    words = ["suite=smoke", f"change.transforms.flow.weights={lively}"]
    cfg = config("navrl-best-places", steps, *words, "num_worlds=1")
    played = make_evaluated_policy(cfg)
    scenario = instantiate(cfg.suite).scenarios([1])[0]
    episode = record_episode(played.env, played.policy, scenario)
    runner = make_runner(cfg)
    for _ in range(2):  # and again after a reset
        commands = [
            runner.act(episode.ranges[step], episode.pose[step], episode.path)
            for step in range(episode.num_steps)
        ]
        np.testing.assert_allclose(commands, episode.action, atol=1e-5)
        runner.reset()
    words[1] = "change.transforms.flow.threshold=0.999"  # nothing moves
    static = make_evaluated_policy(config("navrl-best-places", steps, *words))
    other = record_episode(static.env, static.policy, scenario)
    assert not np.array_equal(other.action, episode.action)
