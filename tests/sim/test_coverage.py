"""Field of view and blind sectors: which beams measure, and what the others read."""

import math

import pytest
import torch

from navrl import factory
from navrl.config import compose, instantiate
from navrl.sim import Lidar, Uniform
from navrl.sim.draws import draw

SEEDS = torch.arange(500)
STEP = torch.zeros(500, dtype=torch.int64)


@pytest.mark.parametrize("degrees, beams", [(270, 1081), (240, 961), (180, 721)])
def test_field_of_view_is_centered_on_the_x_axis(degrees, beams):
    lidar = instantiate(compose("train", [f"lidar=fov_{degrees}"]).lidar)
    measured = lidar.coverage.measured(SEEDS[:2])
    assert measured.sum(-1).tolist() == [beams, beams]  # a border beam on either side and ahead
    half = 2 * degrees  # beams of 0.25 degrees
    assert measured[0, half] and not measured[0, half + 1]
    assert measured[0, -half] and not measured[0, -half - 1]
    assert lidar.coverage.is_fixed and not lidar.coverage.is_full


def test_blind_beams_read_as_without_return():
    lidar = Lidar(8, noise="none", field_of_view=math.pi, blind_sectors=[(math.pi / 4, 0.1)])
    ranges = torch.arange(1.0, 9.0).expand(500, -1) / 4
    seen = lidar.add_noise(ranges, SEEDS, STEP)[3].tolist()
    assert seen == [0.25, 3.5, 0.75, 3.5, 3.5, 3.5, 1.75, 2.0]
    noisy = Lidar(8, field_of_view=math.pi).add_noise(ranges, SEEDS, STEP)
    assert (noisy[:, 3:6] == 3.5).all() and (noisy[:, [0, 1, 2, 6, 7]] < 3.5).all()


def test_full_circle_adds_the_same_noise_as_before():
    ranges = torch.rand(500, 40) * 3.5
    plain, full = Lidar(40), Lidar(40, field_of_view=2 * math.pi, blind_sectors=[])
    assert torch.equal(plain.add_noise(ranges, SEEDS, STEP), full.add_noise(ranges, SEEDS, STEP))
    view = Lidar(40, field_of_view=math.pi)
    measured = view.coverage.measured(SEEDS)
    seen, noisy = view.add_noise(ranges, SEEDS, STEP), plain.add_noise(ranges, SEEDS, STEP)
    assert torch.equal(seen[measured], noisy[measured])


def test_field_of_view_is_drawn_once_per_episode():
    lidar = Lidar(3600, noise="none", field_of_view=Uniform(math.pi, 2 * math.pi))
    measured = lidar.coverage.measured(SEEDS)
    drawn = draw("lidar.field_of_view", lidar.coverage.field_of_view, SEEDS)
    share = measured.double().mean(-1)
    torch.testing.assert_close(share, drawn / (2 * math.pi), atol=2 / 3600, rtol=0)
    assert 0.74 < share.mean() < 0.76 and not lidar.coverage.is_fixed
    shuffled = torch.randperm(500)
    assert torch.equal(lidar.coverage.measured(SEEDS[shuffled]), measured[shuffled])
    assert lidar.coverage.in_all_episodes().sum() == 1801


def test_sectors_are_drawn_per_episode():
    sector = (Uniform(-0.5, 0.5), Uniform(0.0, 0.2))
    measured = Lidar(36000, blind_sectors=[sector]).coverage.measured(SEEDS)
    blind = (~measured).double()
    width = draw("lidar.blind_sectors.0.width", sector[1], SEEDS)
    torch.testing.assert_close(blind.mean(-1) * 2 * math.pi, width, atol=4e-4, rtol=0)
    bearing = draw("lidar.blind_sectors.0.bearing", sector[0], SEEDS)
    angles = Lidar(36000).beam_angles()
    x, y = (blind * angles.cos()).sum(-1), (blind * angles.sin()).sum(-1)
    wide = width > 0.01
    torch.testing.assert_close(torch.atan2(y, x)[wide], bearing[wide], atol=2e-4, rtol=0)


@pytest.mark.parametrize(
    "given, message",
    [
        ({"field_of_view": 0.0}, r"field_of_view=0.0: must be in \(0, 2 pi\] rad"),
        ({"field_of_view": 270.0}, r"field_of_view=270.0: must be in \(0, 2 pi\] rad"),
        ({"field_of_view": Uniform(1.0, 14.0)}, r"field_of_view=Uniform\(low=1.0, high=14.0\): m"),
        ({"blind_sectors": [(0.1,)]}, r"blind_sectors\[0\]=\[0.1\]: must be \(bearing, width\)"),
        ({"blind_sectors": [(0.1, -1.0)]}, r"blind_sectors\[0\]: width=-1.0: must be in \[0, 2 pi"),
        ({"blind_sectors": [(math.nan, 1.0)]}, r"blind_sectors\[0\]: bearing=nan: must be finite"),
    ],
)
def test_invalid_coverage_is_rejected(given, message):
    with pytest.raises(ValueError, match=message):
        Lidar(**given)


@pytest.mark.parametrize("simulator", ["batched", "bullet"])
def test_environment_reports_the_beams_that_measure(simulator):
    """Blind beams are the same after a partial reset, on both simulators."""
    words = ["scenario=office", "pool_size=8", "num_worlds=3", "num_threads=1", "lidar=fov_240"]
    cfg = compose("train", [*words, f"simulator={simulator}"])
    cfg.lidar.field_of_view = {"_target_": "navrl.sim.Uniform", "low": 3.2, "high": 6.0}
    env = factory.make_navigation_env(cfg, 3, factory.make_pool(cfg), 0)
    first = env.reset()
    expected = env.simulator.lidar.coverage.measured(env._noise_seed)
    assert torch.equal(first["measured"], expected) and 0.5 < expected.float().mean() < 1.0
    assert (first["ranges"][~first["measured"]] == 3.5).all()
    stepped = env.rand_step(first.clone())["next"]
    assert torch.equal(stepped["measured"], expected)
    mask = torch.tensor([[False], [True], [False]])
    again = env.reset(stepped.clone().set("_reset", mask))
    assert torch.equal(again["measured"][[0, 2]], expected[[0, 2]])
    assert not torch.equal(again["measured"][1], expected[1])
    env.close()
