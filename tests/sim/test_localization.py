"""Reported pose: age, noise and drift; rewards and metrics use the true pose."""

import math

import pytest
import torch
from tensordict import TensorDict

from navrl import factory
from navrl.config import compose, instantiate
from navrl.evaluation.series import true_pose
from navrl.sim import Localization, Uniform
from navrl.sim.draws import draw

NUM = 4000
SEED = torch.arange(NUM)


def report(localization, poses, step=0, seed=SEED, time_step_s=0.2):
    rows = torch.tensor(poses).expand(len(seed), -1, -1)
    steps = torch.full((len(seed),), step)
    return localization.report(rows, seed, steps, time_step_s)


PAST = [[2.0, 1.0, -3.1], [1.5, 0.5, 3.1], [1.0, 0.5, 2.9]]


@pytest.mark.parametrize(
    "age, expected",
    [
        (0.2, (1.5, 0.5, 3.1)),
        (0.4, (1.0, 0.5, 2.9)),
        (0.3, (1.25, 0.5, 3.0)),
        (0.1, (1.75, 0.75, math.pi)),  # the shorter arc, across pi: 3.1 and 3.183
        (0.15, (1.625, 0.625, 3.1 + (2 * math.pi - 6.2) / 4)),
    ],
)
def test_old_pose_is_interpolated(age, expected):
    pose = report(Localization(age_s=age), PAST)[0]
    torch.testing.assert_close(pose[:2], torch.tensor(expected[:2]))
    assert abs(math.remainder(float(pose[2]) - expected[2], 2 * math.pi)) < 1e-6
    assert abs(pose[2]) <= math.pi + 1e-6


@pytest.mark.parametrize("age, number", [(0.2, 2), (0.5, 4), (0.6, 4), (Uniform(0.0, 0.3), 3)])
def test_number_of_past_poses(age, number):
    assert Localization(age_s=age).num_poses(0.2) == number
    assert Localization().num_poses(0.2) == 0 and Localization().is_exact


def test_noise_has_its_standard_deviation():
    localization = Localization(noise_m=0.03, noise_rad=Uniform(0.0, 0.02))
    error = report(localization, [[1.0, 2.0, 0.5]], step=3) - torch.tensor([1.0, 2.0, 0.5])
    sizes = draw("localization.noise_rad", localization.noise_rad, SEED)
    deviation = torch.tensor([0.03, 0.03, float(sizes.square().mean().sqrt())])
    torch.testing.assert_close(error.std(0), deviation, rtol=0.04, atol=0)
    assert (error.mean(0).abs() < 4 * deviation / math.sqrt(NUM)).all()
    assert (torch.corrcoef(error.T) - torch.eye(3)).abs().max() < 0.06
    later = report(localization, [[1.0, 2.0, 0.5]], step=4)
    assert not torch.equal(later, report(localization, [[1.0, 2.0, 0.5]], step=3))


def test_drift_grows_in_one_direction_per_episode():
    localization = Localization(drift_m_per_s=0.01, drift_rad_per_s=0.02)
    first, later = (report(localization, [[0.0, 0.0, 0.0]], step=step) for step in (50, 100))
    torch.testing.assert_close(later, 2 * first)
    torch.testing.assert_close(first[:, :2].norm(dim=-1), torch.full((NUM,), 0.1))  # 10 s
    torch.testing.assert_close(first[:, 2].abs(), torch.full((NUM,), 0.2))
    assert first.mean(0).abs().max() < 0.015  # all directions, both sides


def test_report_does_not_depend_on_the_batch():
    localization = instantiate(compose("train", ["localization=varied"]).localization)
    poses = torch.randn(NUM, 3, 3)
    steps = torch.arange(NUM) % 150
    order = torch.randperm(NUM)[:100]
    whole = localization.report(poses, SEED, steps, 0.2)
    part = localization.report(poses[order], SEED[order], steps[order], 0.2)
    assert torch.equal(whole[order], part)


@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan, Uniform(-0.1, 0.1)])
@pytest.mark.parametrize("name", ["age_s", "noise_m", "noise_rad", "drift_m_per_s"])
def test_invalid_errors_are_rejected(name, value):
    with pytest.raises(ValueError, match=f"{name}=.*: must be finite and not negative"):
        Localization(**{name: value})


def make_env(localization, simulator="batched", privileged=True):
    words = ["scenario=corridor", "pool_size=8", "num_worlds=3", "num_threads=1"]
    words += [f"localization={localization}", f"simulator={simulator}"]
    cfg = compose("train", words)
    return factory.make_navigation_env(cfg, 3, factory.make_pool(cfg), 0, privileged)


def drive(env, num_steps, now=None):
    """Return the observations of a drive with the same commands each time."""
    rows = [env.reset() if now is None else now]
    for step in range(num_steps):
        command = torch.tensor([[0.5, 0.3], [0.8, -0.2], [0.2, 1.0]]) * (1 + step % 3) / 3
        rows.append(env.step(rows[-1].clone().set("action", command))["next"])
    return rows


@pytest.mark.parametrize("simulator", ["batched", "bullet"])
@pytest.mark.parametrize("steps, name", [(1, "pose_02"), (2.5, "pose_05")])
def test_environment_reports_the_pose_of_steps_before(simulator, steps, name):
    env = make_env(name, simulator)
    rows = drive(env, 5)
    for now, row in enumerate(rows):
        newer, older = max(now - math.floor(steps), 0), max(now - math.ceil(steps), 0)
        expected = (rows[newer]["true_pose"] + rows[older]["true_pose"]) / 2
        torch.testing.assert_close(row["pose"], expected, rtol=0, atol=1e-5)
    env.close()


def test_exact_pose_is_the_true_one_bit_for_bit():
    rows = drive(make_env("exact"), 3)
    others = drive(make_env("varied"), 3)
    for row, other in zip(rows, others, strict=True):
        assert "true_pose" not in row and torch.equal(true_pose(row), true_pose(other))
        assert not torch.equal(row["pose"], other["pose"])
        for key in ("ranges", "outcome", "contact", "reward_terms", "done"):
            equal = row[key] == other[key]
            assert equal.all()
    assert true_pose(TensorDict({"pose": torch.ones(1, 3)}, [1])).tolist() == [[1.0, 1.0, 1.0]]


def test_true_pose_is_observed_only_if_privileged():
    env = make_env("varied", privileged=False)
    assert "true_pose" not in env.reset()


def test_partial_reset_keeps_the_poses_of_other_worlds():
    env, other = make_env("pose_05"), make_env("pose_05")
    rows, expected = drive(env, 4), drive(other, 6)
    mask = torch.tensor([[False], [True], [False]])
    again = env.reset(rows[-1].clone().set("_reset", mask))
    assert torch.equal(again["pose"][[0, 2]], rows[-1]["pose"][[0, 2]])
    assert torch.equal(again["pose"][1], again["true_pose"][1])  # stationary before the start
    step = 4
    command = torch.tensor([[0.5, 0.3], [0.8, -0.2], [0.2, 1.0]]) * (1 + step % 3) / 3
    following = env.step(again.set("action", command))["next"]
    assert torch.equal(following["pose"][[0, 2]], expected[5]["pose"][[0, 2]])


def test_state_of_an_episode_has_the_past_poses():
    env, other = make_env("varied"), make_env("varied")
    now = drive(env, 4)[-1]
    other.reset()
    other.load_episode_state(env.episode_state())
    for row, copy in zip(drive(env, 3, now), drive(other, 3, now.clone()), strict=True):
        assert torch.equal(row["pose"], copy["pose"])


def test_state_of_another_localization_is_rejected():
    env, other = make_env("pose_02"), make_env("pose_05")
    env.reset()
    with pytest.raises(
        ValueError, match="localization: must need 2 past poses as the loaded state, got 4"
    ):
        other.load_episode_state(env.episode_state())
