"""What is measured is what is said: rooms, drives, and a robot that acts on its past."""

import torch

from navrl.benchmarks import RandomDrive, record_drive
from navrl.benchmarks.scanning import drive_task
from navrl.benchmarks.scenes import FREE_RADIUS, clutter
from navrl.config import compose, instantiate
from navrl.factory import make_env, make_navigation_env, make_pool, observation_shapes
from navrl.networks import make_actor
from navrl.sim import BatchedSimulator, Contact, DifferentialDrive, Lidar

TINY = ["scenario=corridor", "network=small", "pool_size=4", "num_threads=1"]


def simulator(num_worlds=3, max_pedestrians=10):
    return BatchedSimulator(
        num_worlds,
        DifferentialDrive(),
        Lidar(noise="none"),
        max_pedestrians=max_pedestrians,
    )


def test_rooms_have_the_requested_boxes_and_differ():
    scenes = clutter(3, 32)
    assert scenes.num_boxes.tolist() == [32] * 3
    assert not torch.equal(scenes.boxes[0], scenes.boxes[1])
    assert (scenes.boxes[:, 4:, :2].norm(dim=-1) >= FREE_RADIUS - 1e-9).all()


def test_turning_robots_touch_no_pedestrian():
    worlds = simulator()
    task = drive_task(worlds, clutter(3, 32, 10))
    before = worlds.state()
    for _ in range(100):
        assert task.work() == 3
    after = worlds.state()
    assert (after.contact == Contact.NONE).all()
    assert (after.time_s > 19).all()
    assert (after.pedestrians[..., :2] != before.pedestrians[..., :2]).any(-1).all()
    assert (worlds.ranges() < 3.5).float().mean() > 0.75  # few beams find nothing


def make_parts():
    cfg = compose("train", TINY)
    raw = make_navigation_env(cfg, 1, make_pool(cfg), 0)
    drive = record_drive(raw, 12)
    env = make_env(raw, instantiate(cfg.transforms))
    actor = make_actor(instantiate(cfg.network.encoder), observation_shapes(env))
    return instantiate(cfg.transforms), actor, drive, env


def test_random_drive_continues_after_episode_ends():
    drive = RandomDrive(make_parts()[3])
    steps = [drive() for _ in range(200)]
    assert set(steps) == {1}
    assert not drive.carrier["done"].any()
