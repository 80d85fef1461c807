"""Dropouts, speckle and noise that grows with the range."""

import math

import pytest
import torch
from nightly import mostly

from navrl import factory
from navrl.config import compose, instantiate
from navrl.ops.noise import beam_uniform, mix
from navrl.sim import Lidar, Uniform
from navrl.sim.draws import draw

NUM, BEAMS = 200, 1440
SEED = torch.arange(NUM) + 10
STEP = torch.arange(NUM) % 7


def report(ranges=2.0, **values):
    lidar = Lidar(BEAMS, **({"noise": "none"} | values))
    clean = torch.full((NUM, BEAMS), ranges)
    reported = lidar.add_noise(clean, SEED, STEP)
    assert (clean == ranges).all()
    return reported


def test_numbers_of_beams_are_parts_of_one_hash():
    """Against a plain loop in Python's integers."""
    drawn = beam_uniform(torch.tensor([5]), 3, torch.tensor([9]), 6)[0].tolist()
    golden, wrap = 0x9E3779B97F4A7C15, 1 << 64

    def signed(value):
        return torch.tensor((value + (1 << 63)) % wrap - (1 << 63))

    key = mix(mix(mix(signed(5 + golden)) + 3) + 9).item()
    for beam, value in enumerate(drawn):
        word = mix(signed(key + golden * (beam // 4 + 1))).item() % wrap
        assert value == ((word >> (16 * (beam % 4))) % 65536) / 65536


def test_share_of_dropouts_equals_its_value():
    reported = report(dropout=0.05)
    dropped = reported == 3.5
    assert (reported[~dropped] == 2.0).all()
    deviation = math.sqrt(0.05 * 0.95 / dropped.numel())
    assert abs(dropped.double().mean() - 0.05) < 4 * deviation
    per_scan = dropped.double().mean(-1)
    assert abs(per_scan.std() - math.sqrt(0.05 * 0.95 / BEAMS)) < 1e-3  # beams are independent


def test_speckle_is_uniform_up_to_the_true_range():
    reported = report(speckle=0.02, speckle_min_range=0.5, dropout=0.01)
    false = reported[(reported != 2.0) & (reported != 3.5)]
    assert abs(len(false) / reported.numel() - 0.02) < 4 * math.sqrt(0.02 / reported.numel())
    assert abs((reported == 3.5).double().mean() - 0.01) < 4 * math.sqrt(0.01 / reported.numel())
    assert 0.5 <= false.min() < 0.502 and 1.998 < false.max() < 2.0
    assert abs(false.mean() - 1.25) < 4 * 1.5 / math.sqrt(12 * len(false))
    assert (report(0.3, speckle=0.5, speckle_min_range=0.5) == 0.3).all()  # nothing is shorter
    free = report(3.5, speckle=0.02)
    assert 0.015 < (free < 3.5).double().mean() < 0.025  # also where nothing is


def test_noise_grows_with_the_range():
    for ranges in (0.5, 2.0):
        noise = report(ranges, noise="gaussian", noise_amplitude=0.01, noise_per_m=0.02) - ranges
        expected = 0.01 + 0.02 * ranges
        assert abs(noise.std() / expected - 1.0) < 0.01 and abs(noise.mean()) < 4e-4


def test_noise_is_drawn_per_episode():
    noise = report(noise="gaussian", noise_amplitude=Uniform(0.01, 0.03)) - 2.0
    asked = draw("lidar.noise_amplitude", Uniform(0.01, 0.03), SEED)
    torch.testing.assert_close(noise.std(-1), asked.float(), rtol=0.12, atol=0)
    same = report(noise="gaussian", noise_amplitude=Uniform(0.025, 0.025))
    assert torch.equal(same, report(noise="gaussian", noise_amplitude=0.025))


def test_errors_depend_on_seed_step_and_beam_only():
    lidar = instantiate(compose("train", ["lidar=varied"]).lidar)
    clean = torch.rand(NUM, BEAMS) * 3.5
    reported = lidar.add_noise(clean, SEED, STEP)
    order = torch.randperm(NUM)[:50]
    again = lidar.add_noise(clean[order], SEED[order], STEP[order])
    assert torch.equal(again, reported[order])
    assert not torch.equal(lidar.add_noise(clean, SEED, STEP + 1), reported)


def test_errors_of_zero_equal_those_of_no_errors():
    clean = torch.rand(NUM, BEAMS) * 3.5
    zero = Lidar(dropout=Uniform(0.0, 0.0), speckle=0.0, noise_per_m=0.0)
    assert zero.errors.is_none
    assert torch.equal(zero.add_noise(clean, SEED, STEP), Lidar().add_noise(clean, SEED, STEP))


@pytest.mark.parametrize(
    "name", mostly(["dropout", "speckle", "noise_by_range", "posts", "varied"], ["varied"])
)
def test_simulators_report_the_same_errors(name):
    """The noise-free ranges differ by rounding; which beams have errors does not."""
    reported = []
    for simulator in ("batched", "bullet"):
        words = ["scenario=corridor", "pool_size=4", "num_threads=1", f"lidar={name}"]
        cfg = compose("train", [*words, f"simulator={simulator}"])
        env = factory.make_navigation_env(cfg, 2, factory.make_pool(cfg), 3)
        reported.append(env.reset()["ranges"])
        env.close()
    near = (reported[0] - reported[1]).abs() < 2e-3
    assert near.double().mean() > 0.995


def test_posts_cover_four_sectors_of_a_turtlebot():
    lidar = instantiate(compose("train", ["lidar=posts"]).lidar)
    blind = ~lidar.coverage.measured(SEED[:1])[0]
    bearings = torch.rad2deg(lidar.beam_angles()[blind]).round().unique().tolist()
    for x, y in ((0.0381, 0.1505), (-0.0381, 0.1505), (-0.0381, -0.1505), (0.0381, -0.1505)):
        assert round(math.degrees(math.atan2(y, x))) % 360 in bearings
    width = 2 * math.asin(0.006 / math.hypot(0.0381, 0.1505))
    assert abs(blind.sum() - 4 * width / lidar.increment) <= 4


@pytest.mark.parametrize(
    "given, message",
    [
        ({"dropout": 1.1}, r"dropout=1.1: must be in \[0, 1\], a share of the beams"),
        ({"speckle": Uniform(-0.1, 0.1)}, r"speckle=Uniform\(low=-0.1, high=0.1\): must be in"),
        ({"dropout": 0.6, "speckle": 0.5}, r"dropout=0.6, speckle=0.5: their sum must be at most"),
        ({"speckle": 0.1, "speckle_min_range": 3.5}, r"speckle_min_range=3.5: must be in \[0, max"),
        ({"noise_per_m": -0.1}, r"noise_per_m=-0.1: must be finite and not negative"),
        ({"noise_amplitude": Uniform(-1.0, 0.1)}, r"noise_amplitude=Uniform\(.*\): must be finite"),
    ],
)
def test_invalid_errors_are_rejected(given, message):
    with pytest.raises(ValueError, match=message):
        Lidar(**given)
