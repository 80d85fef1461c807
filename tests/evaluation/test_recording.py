"""A recording holds the whole episode, changes nothing, and survives the disk."""

import dataclasses

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictSequential

from navrl import keys
from navrl.config import compose, instantiate
from navrl.evaluation import Trajectory, evaluate, measure
from navrl.evaluation.archive import EpisodeArchive
from navrl.evaluation.recorder import EpisodeRecorder, record_episode
from navrl.evaluation.recording import Recording
from navrl.factory import make_env, make_navigation_env, observation_shapes
from navrl.factory.training import deployed
from navrl.networks import make_actor
from navrl.policies.classical import PurePursuit, StandStill, UniformRandom
from navrl.sim import Contact
from navrl.worlds import Pedestrian, Scenario, ScenarioBatch


@pytest.fixture(scope="module")
def cfg():
    return compose("train", ["scenario=intersection", "network=small"])


@pytest.fixture(scope="module")
def env(cfg):
    env = make_env(make_navigation_env(cfg, 2, privileged=True), instantiate(cfg.transforms))
    yield env
    env.close()


@pytest.fixture(scope="module")
def policy(cfg, env):
    """Pure pursuit that drives, after an untrained actor that attends."""
    torch.manual_seed(0)
    make_encoder = instantiate(cfg.network.encoder)
    actor = make_actor(make_encoder, observation_shapes(env), with_attention=True)
    return TensorDictSequential(actor, PurePursuit(env.base_env.simulator.robot))


@pytest.fixture(scope="module")
def scenario(cfg):
    return instantiate(cfg.scenario).sample("recorded", 0, 1)


@pytest.fixture(scope="module")
def recording(env, policy, scenario):
    return record_episode(env, policy, scenario)


def test_recording_does_not_change_results(env, policy, scenario):
    batch = ScenarioBatch.pack([scenario])
    recorder = EpisodeRecorder(env)
    assert evaluate(env, policy, batch, on_step=recorder) == evaluate(env, policy, batch)


def test_recording_agrees_with_the_record(env, policy, scenario, recording):
    (record,) = evaluate(env, policy, ScenarioBatch.pack([scenario]))
    driven = np.linalg.norm(np.diff(recording.pose[:, :2], axis=0), axis=1).sum()
    assert (recording.outcome, recording.num_steps) == (record.outcome, record.steps)
    assert driven == pytest.approx(record.path_length_m, abs=1e-4)


def test_metrics_of_a_recording_are_those_of_the_evaluation(tmp_path, env, policy, cfg):
    """To the last bit, from the disk, alone or beside longer episodes, without a simulator."""
    distribution, robot = instantiate(cfg.scenario), env.base_env.simulator.robot
    scenarios = [distribution.sample("recorded", 0, index) for index in range(4)]
    scenarios[1:3] = [dataclasses.replace(scene, pedestrians=()) for scene in scenarios[1:3]]
    records = evaluate(env, policy, ScenarioBatch.pack(scenarios))
    files = [tmp_path / f"{index}.npz" for index in range(4)]
    for scene, file in zip(scenarios, files, strict=True):
        record_episode(env, policy, scene).save(file)
    loaded = [Recording.load(file) for file in files]
    together = measure(Trajectory.from_recordings(loaded, robot.max_speed))
    for row, (record, recording) in enumerate(zip(records, loaded, strict=True)):
        alone = measure(Trajectory.from_recordings([recording], robot.max_speed))
        for name, value in record.metrics.items():
            expected = np.nan if value is None else value
            assert np.array_equal(alone[name], [expected], equal_nan=True), name
            assert np.array_equal(together[name][row], expected, equal_nan=True), name
    assert len({record.steps for record in records}) > 1
    assert len({record.outcome for record in records}) > 1


def test_recording_stores_the_at_fault_party(env, scenario):
    robot = env.base_env.simulator.robot
    walker = Pedestrian(scenario.path[[30, 0]], 1.0, 0.0)  # straight over the robot, which stands
    scene = dataclasses.replace(scenario, pedestrians=(walker,))
    found = record_episode(env, StandStill(robot), scene)
    assert found.contact == Contact.HIT_BY_PEDESTRIAN
    assert measure(Trajectory.from_recordings([found], robot.max_speed))["hit_by_pedestrian"] == [
        1.0
    ]


def test_recordings_of_different_robots_are_not_stacked(recording):
    other = dataclasses.replace(recording, robot_radius=0.3)
    with pytest.raises(ValueError, match="one robot"):
        Trajectory.from_recordings([recording, other], 1.0)


def test_recording_holds_driven_and_requested_commands(tmp_path, cfg, scenario):
    """With a shield both differ, and metrics of the recording are those of the evaluation."""
    with_shield = deployed(compose("train", ["+transforms/steps@deployment.transforms=shield"]))
    env = make_env(
        make_navigation_env(cfg, 1, privileged=True), instantiate(with_shield.transforms)
    )
    robot, seen = env.base_env.simulator.robot, []

    def ahead(tensordict):
        return tensordict.set(keys.ACTION, torch.tensor([[1.0, 0.0]]))

    batch = ScenarioBatch.pack([scenario])
    (record,) = evaluate(env, ahead, batch, on_step=lambda step: seen.append(step.clone()))
    found = record_episode(env, ahead, scenario)
    found.save(tmp_path / "episode.npz")
    found = Recording.load(tmp_path / "episode.npz")
    driven = [step["next", keys.COMMAND][0].numpy() for step in seen]
    assert np.array_equal(found.action, driven)
    assert np.allclose(found.requested, [[robot.max_speed, 0.0]], atol=1e-6)
    share = record.metrics["shielded_share"]
    assert 0.0 < share < 1.0
    assert measure(Trajectory.from_recordings([found], 1.0))["shielded_share"] == [share]
    older = dataclasses.replace(found, requested=None)
    assert np.isnan(measure(Trajectory.from_recordings([older], 1.0))["shielded_share"])
    env.close()


def test_rows_correspond_to_time_steps(env, scenario):
    """Pose and command fit: the speed commanded in step t is driven from row t to row t + 1."""
    recording = record_episode(env, UniformRandom(seed=0), scenario)
    free = recording.action[:-1]  # the last step may end in a contact
    chord = np.linalg.norm(np.diff(recording.pose[:-1, :2], axis=0), axis=1)
    arc = free[:, 0] * recording.time_step_s
    half_turn = free[:, 1] * recording.time_step_s / 2
    assert np.allclose(recording.pose[0], scenario.start, atol=1e-6)
    assert np.allclose(chord, arc * np.sinc(half_turn / np.pi), atol=1e-5)
    turn = np.diff(recording.pose[:-1, 2])
    assert np.allclose(np.sin((turn - 2 * half_turn) / 2), 0.0, atol=1e-5)
    assert np.abs(free[:, 1]).max() > 1.5  # rad/s, not normalized


def test_recording_contains_observations_and_actions(env, policy, scenario, recording):
    steps, seen = recording.num_steps, []
    batch = ScenarioBatch.pack([scenario])
    evaluate(env, policy, batch, on_step=lambda stepped: seen.append(stepped.clone()))
    for t in (0, steps - 1):
        before, after = seen[t][0], seen[t]["next"][0]
        for name in (keys.RANGES, keys.POINTS, keys.ALIGNED_POINTS, keys.TAGD, keys.TAGD_VALID):
            assert np.array_equal(getattr(recording, name)[t], before[name].numpy())
            assert np.array_equal(getattr(recording, name)[t + 1], after[name].numpy())
        weights = recording.spatial_attention[t], recording.temporal_attention[t]
        assert np.array_equal(weights[0], before[keys.SPATIAL_ATTENTION].numpy())
        assert np.array_equal(weights[1], before[keys.TEMPORAL_ATTENTION].numpy())
        total = sum(term[t] for term in recording.reward_terms.values())
        assert total == pytest.approx(float(after["reward"]), abs=1e-5)


def test_recording_round_trips_through_a_file(tmp_path, recording, scenario):
    file = tmp_path / "episode.npz"
    recording.save(file)
    loaded = Recording.load(file)
    for name, value in vars(recording).items():
        other = getattr(loaded, name)
        if isinstance(value, np.ndarray):
            assert value.dtype == other.dtype
            assert np.array_equal(value, other, equal_nan=value.dtype.kind == "f")
        elif name != keys.REWARD_TERMS:
            assert other == value
            assert type(other) is type(value)
    assert recording.reward_terms.keys() == loaded.reward_terms.keys()
    for name, term in recording.reward_terms.items():
        assert np.array_equal(term, loaded.reward_terms[name])
    again = Scenario.from_json(loaded.scenario)
    assert again.to_json() == scenario.to_json()


def test_missing_policy_outputs_are_none(tmp_path, env, scenario):
    plain = record_episode(env, PurePursuit(env.base_env.simulator.robot), scenario)
    plain.save(tmp_path / "plain.npz")
    loaded = Recording.load(tmp_path / "plain.npz")
    assert loaded.spatial_attention is None
    assert loaded.temporal_attention is None
    assert loaded.tagd is not None


def test_other_running_worlds_add_no_rows(env, scenario):
    noisier = dataclasses.replace(scenario, noise_seed=scenario.noise_seed + 1)  # other draws too
    twice = ScenarioBatch.pack([scenario, noisier])
    recorder = EpisodeRecorder(env)
    records = evaluate(env, UniformRandom(seed=1), twice, on_step=recorder)
    assert records[0].steps != records[1].steps
    for row, (scene, record) in enumerate(zip((scenario, noisier), records, strict=True)):
        found = recorder.recording(row, scene, record)
        assert (found.num_steps, found.outcome) == (record.steps, record.outcome)


def test_archive_writes_the_bytes_of_single_recordings(tmp_path, env, policy, cfg):
    distribution = instantiate(cfg.scenario)
    scenarios = [distribution.sample("recorded", 0, index) for index in range(3)]
    archive = EpisodeArchive(env, scenarios, tmp_path / "archive")
    evaluate(env, policy, ScenarioBatch.pack(scenarios), recorder=archive)
    for index, scene in enumerate(scenarios):
        alone = tmp_path / f"{index:06d}.npz"
        record_episode(env, policy, scene).save(alone, compact=True)
        assert (tmp_path / "archive" / alone.name).read_bytes() == alone.read_bytes()


def test_failed_episode_is_reported(env, scenario):
    def broken(_):
        raise ZeroDivisionError("of the policy")

    with pytest.raises(RuntimeError, match="of the policy"):
        record_episode(env, broken, scenario)


def test_missing_steps_of_a_record_are_an_error(env, policy, scenario):
    (record,) = evaluate(env, policy, ScenarioBatch.pack([scenario]))
    with pytest.raises(ValueError, match=rf"record.steps={record.steps}: must be within 1\.\.0"):
        EpisodeRecorder(env).recording(0, scenario, record)


def test_bad_shapes_and_files_are_named(tmp_path, recording):
    with pytest.raises(ValueError, match="pose"):
        dataclasses.replace(recording, pose=recording.pose[:-1])
    with pytest.raises(ValueError, match="reward_terms/extra"):
        dataclasses.replace(recording, reward_terms={"extra": np.zeros(1)})
    with pytest.raises(ValueError, match=r"\.npz"):
        recording.save(tmp_path / "episode.zip")
    np.savez(tmp_path / "other.npz", a=np.zeros(1))
    with pytest.raises(ValueError, match=r"other\.npz"):
        Recording.load(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ValueError, match=r"text\.npz"):
        Recording.load(tmp_path / "text.npz")
    np.savez(tmp_path / "pickled.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match=r"pickled\.npz"):
        Recording.load(tmp_path / "pickled.npz")
