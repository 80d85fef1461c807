"""Small pieces of work that the CPU's and CUDA's kernels must do alike, on any device.

Each case takes the device, calls the public functions there and returns their results on the CPU,
by name. The tests run the cases in three ways: on a GPU, in numba's CUDA simulator, and only as far
as the compiler.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from models import Fleeing, Omnidirectional
from rooms import sample_scan_pairs
from scenes import pack, random_scene, scene, walker

from navrl.ops.grouping import tagd
from navrl.ops.icp import align
from navrl.ops.icp_options import PAPER, ROBUST
from navrl.ops.noise import add_range_noise, noise_table
from navrl.ops.path import point_at, project_onto_path
from navrl.ops.pooling import min_pool
from navrl.ops.raycast import cast_rays
from navrl.sim import BatchedSimulator, Delays, DifferentialDrive, Lidar, Uniform


def draw(*shape, low=0.0, high=1.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return low + (high - low) * torch.rand(shape, generator=generator)


def worlds(
    device, count=3, steps=4, num_beams=72, model="kinematic", num_walls=10, robot=None, **options
):
    """Drive random worlds, some into a wall or a walker, with a partial reset on the way."""
    generator = np.random.default_rng(3)
    scenes = [scene(pedestrians=[walker((1.0, 0.0), (0.0, 0.0), speed=1.0)])]  # they meet
    scenes += [random_scene(generator, num_walls, num_walkers=2) for _ in range(count)]
    batch, n = pack(*scenes, max_pedestrians=4), count + 1
    sim = BatchedSimulator(
        n,
        robot or DifferentialDrive(model=model),
        Lidar(num_beams=num_beams, mount=(0.08, -0.03, 0.4)),
        max_pedestrians=4,
        max_walls=4,
        device=device,
        **options,
    )
    sim.reset(torch.arange(n), batch)
    results = {"first_scan": sim.ranges()}
    for step in range(steps):
        if step == steps - 1:
            sim.reset(torch.tensor([1]), batch[torch.tensor([-1])])
        command = draw(n, 2, seed=step) * torch.tensor([1.5, 6.0]) - torch.tensor([0.2, 3.0])
        command[0] = torch.tensor([0.5, 0.0])
        command = torch.nn.functional.pad(command, (0, sim.robot.command_size - 2))
        state = sim.step(command.to(device))
    results |= {name: value.nan_to_num(-9.0) for name, value in vars(state).items()}
    results |= {"ranges": sim.ranges(), "two_ranges": sim.ranges(torch.tensor([count, 0]))}
    results["scan_motion"] = sim.scan_motion()
    assert state.contact[0] != 0 or options
    return {name: value.cpu() for name, value in results.items()}


def wheeled_worlds(device):
    return worlds(device, count=1, steps=4, num_beams=9, model="wheeled")


def other_models(device):
    """A base driven by its own code, pedestrians that flee, delays of scans and commands."""
    delays = Delays(scan_age_s=0.26, speed_delay_s=0.1, turn_rate_delay_s=0.24)
    options = {"robot": Omnidirectional(), "pedestrians": Fleeing(), "delays": delays}
    return worlds(device, count=1, steps=4, num_beams=9, **options)


def varied_worlds(device):
    """Delays that differ between worlds and steps, and a spinning lidar."""
    delays = Delays(
        scan_age_s=Uniform(0.0, 0.3),
        command_delay_s=Uniform(0.0, 0.3),
        revolution_s=Uniform(0.0, 0.2),
        scan_jitter_s=0.1,
        command_jitter_s=0.1,
    )
    return worlds(device, count=2, steps=4, num_beams=23, delays=delays)


def rays(device):
    pose = draw(3, 3, low=-0.5, high=0.5)
    boxes = draw(3, 5, 5, low=-2.0, high=2.0, seed=1)
    boxes[..., 2:4] = 0.1 * boxes[..., 2:4].abs()
    boxes[0, 0, :2], boxes[0, 0, 2:4] = pose[0, :2], 0.2  # around the scanner
    boxes[1, 1] = math.nan
    number = torch.tensor([5, 4, 0])
    values = (value.to(device) for value in (pose, boxes, number))
    return {"ranges": cast_rays(*values, num_beams=61).cpu()}


def partial_rays(device):
    """Beams counted clockwise over less than a circle."""
    pose = draw(2, 3, low=-0.5, high=0.5)
    boxes = draw(2, 4, 5, low=-2.0, high=2.0, seed=1)
    boxes[..., 2:4] = 0.3 * boxes[..., 2:4].abs()
    values = (value.to(device) for value in (pose, boxes))
    return {"ranges": cast_rays(*values, num_beams=41, angle_min=2.0, angle_increment=-0.1).cpu()}


def noise(device):
    ranges = draw(3, 42, high=3.6).clamp(max=3.5)
    ranges[0, :5] = 0.001
    seed, step = torch.tensor([0, 5, 2**32 - 1]), torch.tensor([0, 7, 149])
    values = (value.to(device) for value in (ranges, seed, step, noise_table("gaussian", 0.05)))
    return {"noisy": add_range_noise(*values, 3.5).cpu()}


def pooling(device):
    results = {}
    for bearing in ("bin", "beam"):
        for dtype in (torch.float32, torch.float64):
            ranges = draw(2, 60, high=5.0).to(dtype)
            ranges[0, :7] = torch.tensor([math.nan, math.inf, -math.inf, -1.0, 0.0, 3.49995, 3.5])
            ranges[1, :12] = 3.5
            pooled = min_pool(ranges.to(device), 4, bearing=bearing)
            results |= {f"{k} {bearing} {dtype}": v.cpu() for k, v in pooled._asdict().items()}
    return results


def paths(device):
    path = draw(3, 12, 2, low=-0.2, high=0.5).cumsum(1)
    path[0, 8:] = path[0, 7]  # padded with the goal
    position, before = path[:, 5] + 0.1, draw(3, seed=4)
    path, position, before = (value.to(device) for value in (path, position, before))
    anywhere = project_onto_path(path, position)
    near = project_onto_path(path, position, before, ahead=0.7, behind=0.1)
    points = point_at(path, draw(3, 4, low=-0.5, high=5.0).to(device))
    results = {"points": points, "one": point_at(path, near.progress)}
    results |= {f"{name} anywhere": value for name, value in anywhere._asdict().items()}
    results |= {f"{name} near": value for name, value in near._asdict().items()}
    return {name: value.cpu() for name, value in results.items()}


def scan_pairs(device, count=3, num_points=24, dtype=torch.float64):
    pairs = sample_scan_pairs(
        count, seed=5, num_points=num_points, beams_per_point=2, num_pedestrians=2
    )
    source, target = pairs.source, pairs.target
    scans = (source.points.to(dtype), source.returns, target.points.to(dtype), target.returns)
    return [scan.to(device) for scan in scans]


def alignments(device, **size):
    """By both metrics, with and without windows, with a failure among the pairs."""
    results = {}
    scans = scan_pairs(device, **size)
    scans[1][1] = False  # nothing seen before
    options = {
        "robust": replace(ROBUST, gate=0.5, min_pairs=3),
        "paper": replace(PAPER, min_pairs=3),
        "few steps": replace(ROBUST, max_iterations=2, min_pairs=3, robust_scale=None),
    }
    for name, option in options.items():
        results |= {f"{k} {name}": v for k, v in align(*scans, option)._asdict().items()}
    seen = torch.arange(scans[0].shape[1], device=device) % 12 < 7  # blind sectors
    front = (scans[0], scans[1] & seen, scans[2], scans[3] & seen)
    partial = align(*front, options["robust"], seen=seen.expand_as(scans[1]))
    results |= {f"{k} partial": v for k, v in partial._asdict().items()}
    half = scans[0].shape[1] // 2
    shorter = [scans[0][:, :half], scans[1][:, :half], scans[2].flip(1), scans[3].flip(1)]
    results |= {f"{k} mixed": v for k, v in align(*shorter, options["paper"])._asdict().items()}
    assert (results["iterations robust"][0] > 3) and not results["converged paper"][1]
    return {name: value.cpu() for name, value in results.items()}


def alignments_single(device):
    """In the precision that the transforms align in."""
    return alignments(device, dtype=torch.float32)


def descriptors(device, **size):
    """With all ways to fill empty groups, and with scans that saw nothing."""
    source, returns, target, target_returns = scan_pairs(device, **size)
    returns[1], target_returns[1], target_returns[2] = False, False, False
    results = {}
    fills = (("center", "current", "groups"), ("zeros", "center", "groups"))
    fills += (("center", "zeros", "zeros"),)
    for number, fill in zip((7, 2, 5), fills, strict=True):
        groups = tagd(target, target_returns, source, returns, number, 0.4, 3.5, *fill)
        results |= {f"{key} {fill}": value.cpu() for key, value in groups._asdict().items()}
    return results


def descriptors_single(device):
    """In the precision that the transforms group in."""
    return descriptors(device, dtype=torch.float32)


CASES = {
    case.__name__: case
    for case in (
        worlds,
        wheeled_worlds,
        other_models,
        varied_worlds,
        rays,
        partial_rays,
        noise,
        pooling,
        paths,
        alignments,
        alignments_single,
        descriptors,
        descriptors_single,
    )
}
EXACT = {"noise", "pooling"}


def assert_same(name, results, expected):
    """Compare a case's results; integers and flags, and what rounds nowhere, bit for bit."""
    assert results.keys() == expected.keys()
    for key, value in results.items():
        tolerance = 0.0 if name in EXACT or not value.is_floating_point() else 1e-5
        torch.testing.assert_close(
            value,
            expected[key],
            atol=tolerance,
            rtol=0,
            msg=lambda m, key=key: f"{name} {key}: {m}",
        )
