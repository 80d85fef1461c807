"""Scalable worlds: a room with boxes and pedestrians around a robot at its center."""

from __future__ import annotations

import math

import numpy as np

from navrl.worlds import Pedestrian, Scenario, ScenarioBatch

ROOM_HALF_SIZE = 3.2  # m; walls are within the range of 3.5 m, corners are not
FREE_RADIUS = 0.8  # m around the robot without boxes and pedestrians
WALL = 0.1  # m, half thickness
WALKER = 0.15  # m, half size
WALK_SPEED = 0.5  # m/s


def clutter(num_worlds: int, num_boxes: int, num_pedestrians: int = 0) -> ScenarioBatch:
    """Return rooms with random positions of boxes and pedestrians.

    Args:
        num_worlds: Number of rooms S.
        num_boxes: Boxes in each room, including its four walls; the others have random positions
            and orientations and are 0.1 to 0.5 m long and wide.
        num_pedestrians: Walkers in each room, on straight radial routes around the robot.

    Raises:
        ValueError: If ``num_boxes`` is less than 4.
    """
    if num_boxes < 4:
        raise ValueError(f"num_boxes={num_boxes}: must be >= 4, the room's walls")
    return ScenarioBatch.pack([_room(i, num_boxes, num_pedestrians) for i in range(num_worlds)])


def _room(index: int, num_boxes: int, num_pedestrians: int) -> Scenario:
    generator = np.random.default_rng([index, num_boxes, num_pedestrians])
    return Scenario(
        suite="benchmark",
        seed=0,
        index=index,
        kind="room",
        boxes=np.concatenate([walls(), _boxes(generator, num_boxes - 4)]),
        start=np.array([0.0, 0.0, generator.uniform(-math.pi, math.pi)]),
        goal=np.array([2.0, 0.0]),
        path=np.stack([np.linspace(0.0, 2.0, 21), np.zeros(21)], axis=-1),
        pedestrians=tuple(walkers(num_pedestrians)),
        noise_seed=index,
    )


def walls() -> np.ndarray:
    """Return the four walls of the room, ``[4, 5]`` (cx, cy, hx, hy, yaw), m and rad."""
    out, long = ROOM_HALF_SIZE + WALL, ROOM_HALF_SIZE + 2 * WALL
    sides = [
        (out, 0, WALL, long),
        (-out, 0, WALL, long),
        (0, out, long, WALL),
        (0, -out, long, WALL),
    ]
    return np.array([(*side, 0.0) for side in sides])


def _boxes(generator: np.random.Generator, count: int) -> np.ndarray:
    """Return boxes ``[count, 5]`` in the room outside of ``FREE_RADIUS`` around the robot."""
    half = generator.uniform(0.05, 0.25, (count, 2))
    center = generator.uniform(-ROOM_HALF_SIZE, ROOM_HALF_SIZE, (count, 2))
    distance = np.linalg.norm(center, axis=1, keepdims=True)
    center *= np.maximum(1.0, FREE_RADIUS / distance)
    return np.concatenate([center, half, generator.uniform(0, math.pi, (count, 1))], axis=1)


def walkers(count: int) -> list[Pedestrian]:
    """Return walkers that move back and forth between 0.8 m and 2.8 m from the robot."""
    people = []
    for angle in np.arange(count) * (2 * math.pi / max(count, 1)):
        towards = np.array([math.cos(angle), math.sin(angle)])
        route = np.stack([FREE_RADIUS * towards, (ROOM_HALF_SIZE - 0.4) * towards])
        people.append(
            Pedestrian(route, WALK_SPEED, offset=float(angle), half_size=(WALKER, WALKER))
        )
    return people
