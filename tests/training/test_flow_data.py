"""Samples of the scan flow: true motion in scenes made by hand, and augmentation."""

import math

import numpy as np
import pytest
import torch
from scenes import pack, scene, walker

from navrl.config import compose, instantiate
from navrl.envs.transformed import base_env
from navrl.factory import make_evaluated_policy
from navrl.networks import ScanFlow
from navrl.training.flow_data import FlowSamples
from navrl.training.flow_recorder import FlowRecorder
from navrl.untrusted import DamagedFileError

WALL_X = 1.9  # m, so near that its returns are within reach of the pedestrian


def recorder(num_worlds=1, policy="stand_still", overrides=(), **options):
    overrides = [f"policy={policy}", f"num_worlds={num_worlds}", "lidar=noiseless", *overrides]
    overrides += ["pedestrians=scripted"]
    cfg = compose("train_flow", overrides)
    driver = make_evaluated_policy(cfg)
    return instantiate(cfg.recorder)(driver.env, driver.policy, **{"num_steps": 10, **options})


def crossing(yaw, speed=0.8):
    """A pedestrian that walks to the left in front of a wall, before a robot of any yaw."""
    return scene(
        [(WALL_X + 0.1, 0.0, 0.1, 3.0, 0.0)],
        start=(0.0, 0.0, yaw),
        pedestrians=[walker((1.5, -1.0), (1.5, 5.0), speed=speed)],
    )


@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_labels_of_a_crossing_pedestrian(yaw):
    samples = recorder().record(pack(crossing(yaw)), seed=0)
    assert len(samples) == 5
    bearing = 2.0 * math.pi * (torch.arange(180) + 0.4375) / 180  # the middle of 8 beams
    world = bearing + yaw
    for index, sample in enumerate(range(len(samples))):
        y = -1.0 + 0.8 * 0.4 * index
        near = [math.atan2(y - 0.15, 1.35 if y < 0.15 else 1.65)]
        near += [math.atan2(y + 0.15, 1.65 if y < -0.15 else 1.35)]
        wrapped = torch.remainder(world + math.pi, 2.0 * math.pi) - math.pi
        shown = samples.shown[sample]
        inside = (wrapped > near[0] + 0.04) & (wrapped < near[1] - 0.04)
        around = (wrapped > near[0] - 0.04) & (wrapped < near[1] + 0.04)
        assert bool((shown >= inside).all()) and bool((shown <= around).all())
        assert int(inside.sum()) >= 2
        velocity = samples.velocity[sample].float()
        truth = 0.8 * torch.stack((world.sin(), world.cos()), dim=-1)
        torch.testing.assert_close(velocity[shown], truth[shown], atol=2e-3, rtol=0)
        behind = samples.returns[sample] & ~shown
        assert int(behind.sum()) > 20 and not bool(velocity[~shown].any())
        seen = samples.ranges[sample, 0].float()[behind] * wrapped[behind].cos()
        torch.testing.assert_close(seen, torch.full_like(seen, WALL_X), atol=0.06, rtol=0)


def test_first_sample_repeats_the_present_scan():
    samples = recorder().record(pack(crossing(0.0)), seed=0)
    assert samples.ranges.shape == (5, 6, 180) and samples.ranges.dtype == torch.float16
    assert bool((samples.ranges[0] == samples.ranges[0, :1]).all())
    assert bool((samples.ranges[1] != samples.ranges[1, :1]).any())


def test_samples_at_the_end_of_an_episode_are_dropped():
    into = scene(pedestrians=[walker((1.2, 0.0), (-3.0, 0.0))])  # contact in the fifth step
    aside = scene(pedestrians=[walker((-2.0, 2.0), (2.0, 2.0), speed=0.4)])
    samples = recorder(2).record(pack(into, aside), seed=0)
    assert len(samples) == 2 + 5
    facing = samples[samples.shown[:, 0]]
    assert len(facing) == 2
    speed = facing.velocity.float().norm(dim=-1)[facing.shown]
    torch.testing.assert_close(speed, torch.ones_like(speed), atol=2e-3, rtol=0)


def test_samples_of_moved_pedestrians_are_dropped():
    walks, jumps = crossing(0.0), crossing(0.0, speed=3.5)
    samples = recorder(2).record(pack(walks, jumps), seed=0)
    assert len(samples) < 10 and float(samples.velocity.float().norm(dim=-1).max()) < 1.0


def test_robots_move_in_four_ways(monkeypatch):
    drives = recorder(8, "pure_pursuit", noise=0.3, bias=0.5)
    simulator, given = base_env(drives.env).simulator, []
    step = simulator.step
    monkeypatch.setattr(simulator, "step", lambda command: given.append(command) or step(command))
    first = drives.record(pack(*[scene()] * 8), seed=3)
    commands, given[:] = torch.stack(given[:3]), []
    assert torch.equal(commands[:, 0], commands[:, 4])  # worlds 0 and 4 follow the policy
    assert bool((commands[:, 1] != commands[:, 5]).any())
    assert bool((commands[:, [2, 6], 0] < commands[:, :1, 0] - 0.05).all())  # slower
    offset = commands[:, 3, 1] - commands[:, 0, 1]
    assert float(offset[0]) != 0.0 and float(offset.std()) < 0.5
    again = drives.record(pack(*[scene()] * 8), seed=3)
    assert torch.equal(torch.stack(given[:3]), commands)
    assert torch.equal(first.ranges, again.ranges)
    given[:] = []
    drives.record(pack(*[scene()] * 8), seed=4)
    assert not torch.equal(torch.stack(given[:3]), commands)


@pytest.mark.parametrize(
    "overrides, message",
    [
        (["simulator=bullet"], "simulator=BulletSimulator: must be batched"),
        (["timing=ordinary"], "timing: must have scans without age"),
        (["change.transforms.flow_history=null"], "transforms: must have a RangeHistory"),
        (["recorder.noise=-1.0"], "noise=-1.0: must be >= 0"),
        (["recorder.steps_per_sample=20"], "num_steps=10: must be >= steps_per_sample"),
    ],
)
def test_recorder_names_unsuitable_parts(overrides, message):
    with pytest.raises(Exception, match=message):
        recorder(overrides=overrides)


def test_recorder_needs_the_pooling_of_raw_scans():
    steps = "transforms/steps@change.transforms=[flow,odometry_prior,motion_compensation]"
    with pytest.raises(ValueError, match=r"transforms\.min_pool: must pool 'ranges' to 'points'"):
        recorder(overrides=[steps])


def random_samples(count=6, num_scans=2, bins=24, seed=0):
    generator = torch.Generator().manual_seed(seed)
    ranges = 0.3 + 3.0 * torch.rand(count, num_scans + 1, bins, generator=generator)
    shown = torch.rand(count, bins, generator=generator) < 0.4
    velocity = torch.randn(count, bins, 2, generator=generator) * shown[..., None]
    returns = shown | (torch.rand(count, bins, generator=generator) < 0.5)
    return FlowSamples(ranges.half(), returns, shown, velocity.half())


def test_rotated_samples_rotate_the_output_of_the_network():
    torch.manual_seed(0)
    net, samples = ScanFlow(num_scans=2), random_samples()
    shift = torch.tensor([0, 1, 5, 23, 7, 12])
    turned = samples.augmented(torch.zeros(6, dtype=torch.bool), shift)
    outputs, others = (net(s.ranges.float(), s.returns) for s in (samples, turned))
    for output, other in zip(outputs, others, strict=True):
        rolled = [row.roll(int(count), 0) for row, count in zip(output, shift, strict=True)]
        torch.testing.assert_close(other, torch.stack(rolled), atol=1e-5, rtol=0)
    assert torch.equal(turned.velocity[3], samples.velocity[3].roll(23, 0))


def gradient(samples):
    """A velocity that a mirror changes like a real one: even radial part, odd tangential part."""
    now, past = samples.ranges[:, 0].float(), samples.ranges[:, 1].float()
    return torch.stack((now - past, now.roll(-1, -1) - now.roll(1, -1)), dim=-1).half()


def test_mirrored_samples_have_the_mirrored_velocity():
    samples = random_samples()
    truth = FlowSamples(samples.ranges, samples.returns, samples.shown, gradient(samples))
    flags, shift = torch.tensor([True, False] * 3), torch.tensor([0, 0, 3, 3, 11, 23])
    other = truth.augmented(flags, shift)
    assert torch.equal(other.velocity, gradient(other))
    assert torch.equal(other.shown[0], samples.shown[0].flip(0))
    assert torch.equal(other.returns[2], samples.returns[2].flip(0).roll(3, 0))


def test_saved_samples_are_equal(tmp_path):
    samples = random_samples()
    samples.save(tmp_path / "a.npz")
    loaded = FlowSamples.load(tmp_path / "a.npz")
    assert all(torch.equal(v, samples.tensors()[k]) for k, v in loaded.tensors().items())


def test_damaged_samples_are_named(tmp_path):
    file, samples = tmp_path / "a.npz", random_samples()
    samples.save(file)
    file.write_bytes(file.read_bytes()[:-40])
    with pytest.raises(DamagedFileError, match=r"a\.npz: damaged.*records it again"):
        FlowSamples.load(file)
    arrays = {name: value.numpy() for name, value in samples.tensors().items()}
    np.savez(file, **{**arrays, "shown": arrays["shown"][:, 1:]})
    with pytest.raises(DamagedFileError, match=r"a\.npz: shapes=.*'shown': \(6, 23\)"):
        FlowSamples.load(file)
    np.savez(file, **{**arrays, "shown": arrays["velocity"]})
    with pytest.raises(DamagedFileError, match=r"a\.npz: arrays="):
        FlowSamples.load(file)


def test_configuration_builds_a_recorder():
    assert isinstance(recorder(), FlowRecorder)
