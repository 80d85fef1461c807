"""A shield that knows the base: its limits of acceleration and its delays."""

import math

import pytest
import torch
from torchrl.envs import Compose

from navrl.deploy import PolicyRunner
from navrl.envs import NavigationEnv, TransformedNavigationEnv
from navrl.policies import ZOO, load_bundle
from navrl.sim import BatchedSimulator, Delays, DifferentialDrive, Lidar, LimitedDrive, Uniform
from navrl.transforms import ActionShield, Base
from navrl.transforms.base_motion import IDEAL

SLOW = LimitedDrive(linear_acceleration=1.0, angular_acceleration=4.0)


def wall_ahead(distance, num=1):
    y = torch.linspace(-1.0, 1.0, 41)
    points = torch.stack([torch.full_like(y, distance), y], dim=-1).expand(num, -1, -1)
    returns = torch.ones(num, 41, dtype=torch.bool)
    static = torch.zeros(num, 1, 4), torch.zeros(num, 1, 2, dtype=torch.bool)
    return points, returns, *static


def random_scenes(num):
    generator = torch.Generator().manual_seed(7)
    points = torch.randn(num, 60, 2, generator=generator)
    returns = torch.rand(num, 60, generator=generator) < 0.7
    tagd = torch.randn(num, 5, 2, generator=generator).repeat(1, 1, 2)
    tagd[..., 2:] += 0.1 * torch.randn(num, 5, 2, generator=generator)
    valid = torch.ones(num, 5, 2, dtype=torch.bool)
    limits = torch.tensor([1.0, 2.0 * math.pi])
    action = torch.rand(num, 2, generator=generator) * limits - torch.tensor([0.0, math.pi])
    return action, points, returns, tagd, valid


def test_ideal_base_is_bit_equal_to_none():
    action, *seen = random_scenes(200)
    plain = ActionShield().command(action, *seen)
    assert (plain != action).any()
    zeros = torch.zeros(200, 2)
    for base in (IDEAL, Base(DifferentialDrive()), Base(LimitedDrive())):
        known = ActionShield(base=base).command(action, *seen, torch.rand(200, 2), zeros)
        assert torch.equal(known, plain)


def test_moving_base_brakes_before_it_is_too_late():
    # From 1 m/s at 1 m/s^2 the base needs 0.5 m: the hull is at the wall when the gap was 0.5 m.
    scene = wall_ahead(0.178 + 0.03 + 0.55)
    ahead, fast = torch.tensor([[1.0, 0.0]]), torch.tensor([[1.0, 0.0]])
    assert torch.equal(ActionShield(horizon=0.4).command(ahead, *scene), ahead)
    shield = ActionShield(horizon=0.8, base=Base(SLOW))
    instead = shield.command(ahead, *scene, fast, fast)
    assert not torch.equal(instead, ahead)
    places = Base(SLOW).places(instead[None], fast, fast[None], shield.times, step=0.2)
    gaps = torch.cdist(places[0, 0], scene[0][0]).amin(-1)
    assert (gaps > 0.178 + 0.03).all()
    standing = torch.zeros(1, 2)
    assert torch.equal(shield.command(ahead, *scene, standing, standing), ahead)


def test_places_follow_limits_and_commands_under_way():
    base = Base(SLOW, command_delays_s=(0.2, 0.2))
    command, given = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[[0.0, 0.0]]])
    places = base.places(command, torch.zeros(1, 2), given, [0.1, 0.2, 0.3, 0.4], step=0.2)
    # Nothing for 0.2 s; then v = 0.05, 0.1, 0.15, 0.2 in substeps of 0.05 s.
    expected = [0.0, 0.0, 0.05 * 0.15, 0.05 * 0.5]
    torch.testing.assert_close(places[0, 0, :, 0], torch.tensor(expected))


def test_commands_under_way_are_chosen_by_their_age():
    base = Base(DifferentialDrive(), command_delays_s=(0.3, 0.3))
    command = torch.zeros(1, 1, 2)
    given = torch.tensor([[[0.5, 0.0], [1.0, 0.0]]])  # latest first
    places = base.places(command, torch.zeros(1, 2), given, [0.1, 0.2, 0.3, 0.4], step=0.2)
    # The older one takes effect until 0.1 s, the latest until 0.3 s.
    torch.testing.assert_close(places[0, 0, :, 0], torch.tensor([0.1, 0.15, 0.2, 0.2]))


def test_age_of_the_scan_moves_pedestrians_on():
    point = torch.tensor([[[1.2, 0.0]]])
    tagd, valid = torch.tensor([[[1.4, 0.0, 1.2, 0.0]]]), torch.ones(1, 1, 2, dtype=torch.bool)
    scene = point, torch.ones(1, 1, dtype=torch.bool), tagd, valid
    stop, zeros = torch.tensor([[0.4, 0.0]]), torch.zeros(1, 2)
    kinematic = DifferentialDrive()
    now = ActionShield(base=Base(kinematic)).command(stop, *scene, zeros, zeros)
    aged = ActionShield(base=Base(kinematic, scan_age_s=0.5)).command(stop, *scene, zeros, zeros)
    assert torch.equal(now, stop)
    assert not torch.equal(aged, stop)


def test_base_of_the_environment_is_used():
    delays = Delays(
        scan_age_s=0.1, command_delay_s=Uniform(0.1, 0.3), turn_rate_delay_s=0.1, revolution_s=0.1
    )
    simulator = BatchedSimulator(2, SLOW, Lidar(num_beams=8), delays=delays)
    env = NavigationEnv(simulator, None, {})
    for wrap in (Compose, lambda step: step):
        shield = ActionShield(base="environment")
        whole = TransformedNavigationEnv(env, wrap(shield))
        base = shield._known_base()
        assert base.robot is whole.base.robot is SLOW
        assert base.scan_age_s == pytest.approx(0.15)
        assert base.command_delays_s == pytest.approx((0.2, 0.3))


def test_base_of_the_runner_is_used():
    bundle = load_bundle(ZOO / "paper")
    pipeline = Compose(*bundle.build("transforms"), ActionShield(base="environment"))
    delays = Delays(command_delay_s=0.1)
    runner = PolicyRunner(pipeline, bundle.actor, bundle.build("lidar"), SLOW, delays=delays)
    base = runner.transform[-2]._known_base()
    assert base.robot is SLOW and base.command_delays_s == (0.1, 0.1)
    path = [(0.0, 0.0), (4.0, 0.0)]
    with pytest.raises(ValueError, match="velocity=None: must be"):
        runner.act([2.0] * 1440, (0.0, 0.0, 0.0), path)
    command = runner.act([2.0] * 1440, (0.0, 0.0, 0.0), path, velocity=(0.0, 0.0))
    assert command.shape == (2,)


def test_environment_without_a_known_base_is_an_error():
    with pytest.raises(ValueError, match="base='environment': must be part of"):
        ActionShield(base="environment").command(
            torch.zeros(1, 2), *wall_ahead(1.0), torch.zeros(1, 2), torch.zeros(1, 2)
        )
    with pytest.raises(ValueError, match="base='wheels': must be"):
        ActionShield(base="wheels")
