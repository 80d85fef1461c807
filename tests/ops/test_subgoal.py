"""Subgoals never end where the robot would touch a return, and the arcs lead to them."""

import math

import pytest
import torch

from navrl.ops.subgoal import free_distance, steer_to
from navrl.sim import DifferentialDrive

RADIUS = 0.178
LIMITS = {"horizon": 1.0, "max_speed": 1.0, "max_turn_rate": math.pi}


def polar(distance, bearing):
    return torch.stack([distance * bearing.cos(), distance * bearing.sin()], dim=-1)


def random_scans(num_scans: int = 300, num_rays: int = 60, seed: int = 0):
    """Scans none of whose returns touches the robot, and a bearing for each."""
    generator = torch.Generator().manual_seed(seed)
    ranges = RADIUS + 3.3 * torch.rand(num_scans, num_rays, generator=generator, dtype=torch.double)
    angle = torch.arange(num_rays, dtype=torch.double) * (2 * math.pi / num_rays)
    returns = torch.rand(num_scans, num_rays, generator=generator) < 0.3
    bearing = math.pi * (2 * torch.rand(num_scans, generator=generator, dtype=torch.double) - 1)
    return polar(ranges, angle), returns, bearing


def test_free_distance_ends_one_radius_before_a_return():
    points = torch.tensor([[1.0, 0.0], [0.0, 2.0], [-0.5, 0.0]])
    returns = torch.tensor([True, True, False])
    for bearing, free in ((0.0, 1.0), (math.pi / 2, 2.0), (math.pi, math.inf), (0.7, math.inf)):
        distance = free_distance(points, returns, torch.tensor(bearing), RADIUS)
        assert float(distance) == pytest.approx(free - RADIUS, abs=1e-6)


def test_free_distance_is_exact():
    points, returns, bearing = random_scans()
    free = free_distance(points, returns, bearing, RADIUS)
    is_stopped = free.isfinite()
    assert 0.5 < is_stopped.double().mean() < 1.0
    for share in torch.linspace(0.0, 1.0, 21):
        center = polar(share * free.clamp_max(4.0), bearing).unsqueeze(-2)
        gap = torch.where(returns, (points - center).norm(dim=-1), math.inf)
        assert (gap >= RADIUS - 1e-9).all()
    beyond = polar(free + 1e-3, bearing).unsqueeze(-2)
    gap = torch.where(returns, (points - beyond).norm(dim=-1), math.inf).amin(-1)
    assert (gap[is_stopped] < RADIUS).all()


def test_touching_obstacle_blocks_only_motion_towards_it():
    points, returns = torch.tensor([[0.1, 0.0]]), torch.tensor([True])
    bearing = torch.tensor([0.0, 1.0, 2.0, math.pi])
    free = free_distance(points.expand(4, 1, 2), returns.expand(4, 1), bearing, RADIUS)
    assert free.tolist() == [0.0, 0.0, math.inf, math.inf]


@pytest.mark.parametrize("bearing", [-1.5, -0.4, 0.0, 1e-4, 0.8, 1.57])
@pytest.mark.parametrize("distance", [0.05, 0.4, 1.0])
def test_the_arc_of_one_horizon_ends_at_the_subgoal(distance, bearing):
    unlimited = {"horizon": 2.0, "max_speed": 99.0, "max_turn_rate": 99.0}
    d, b = torch.tensor([distance, bearing], dtype=torch.double)
    command = steer_to(d, b, **unlimited)
    robot = DifferentialDrive(max_speed=99.0, max_turn_rate=99.0)
    pose, _ = robot.advance(torch.zeros(3).double(), command, command, 2.0)
    torch.testing.assert_close(pose[:2], polar(d, b), atol=1e-6, rtol=0)


def test_limits_scale_the_command_along_the_arc():
    distance = torch.linspace(0.01, 3.0, 40).unsqueeze(-1)
    bearing = torch.linspace(-math.pi, math.pi, 41)
    v, w = steer_to(distance, bearing, 0.4, max_speed=0.7, max_turn_rate=2.0).unbind(-1)
    assert (v >= 0).all() and v.max() <= 0.7 + 1e-6 and w.abs().max() <= 2.0 + 1e-6
    is_ahead = (bearing.abs() < math.pi / 2).expand_as(v)
    curvature = (2 * bearing.sin() / distance).expand_as(v)
    torch.testing.assert_close((w - curvature * v)[is_ahead], torch.zeros(int(is_ahead.sum())))
    assert (v[:, bearing.abs() > math.pi / 2 + 1e-3] == 0).all()
    assert v.isfinite().all() and w.isfinite().all()


@pytest.mark.parametrize("model", ["kinematic", "wheeled"])
def test_repeated_commands_reach_any_free_subgoal(model):
    robot = DifferentialDrive(model=model)
    angles = torch.linspace(-math.pi, math.pi, 25)
    goal = polar(torch.tensor([[0.3], [1.0], [2.5]]), angles).reshape(-1, 2).double()
    pose = torch.zeros(len(goal), 3).double()
    velocity = torch.zeros(len(goal), 2).double()
    for _ in range(75):  # steps of 0.2 s
        offset = goal - pose[:, :2]
        bearing = torch.atan2(offset[:, 1], offset[:, 0]) - pose[:, 2]
        bearing = torch.remainder(bearing + math.pi, 2 * math.pi) - math.pi
        command = steer_to(offset.norm(dim=-1).clamp_max(1.0), bearing, **LIMITS)
        for _ in range(10):
            pose, velocity = robot.advance(pose, velocity, command, 0.02)
    assert (goal - pose[:, :2]).norm(dim=-1).max() < 0.05
