"""Small scenarios made by hand."""

import numpy as np

from navrl.worlds import Pedestrian, Scenario, ScenarioBatch


def walker(*route, speed=1.0, offset=0.0, half_size=(0.15, 0.15)):
    """Somebody who walks back and forth between points."""
    return Pedestrian(np.array(route, dtype=float), speed, offset, half_size)


def stander(x, y, half_size=(0.15, 0.15)):
    """Somebody who stands."""
    return Pedestrian(np.array([[x, y]], dtype=float), 0.0, 0.0, half_size)


def scene(boxes=(), start=(0.0, 0.0, 0.0), pedestrians=(), noise_seed=0):
    """One scenario; its path and goal do not matter here."""
    return Scenario(
        suite="by hand",
        seed=0,
        index=0,
        kind="other",
        boxes=np.array(boxes, dtype=float).reshape(-1, 5),
        start=np.array(start, dtype=float),
        goal=np.array([1.0, 0.0]),
        path=np.array([[0.0, 0.0], [1.0, 0.0]]),
        pedestrians=tuple(pedestrians),
        noise_seed=noise_seed,
    )


def pack(*scenes, **limits):
    return ScenarioBatch.pack(scenes, **limits)


def random_scene(generator: np.random.Generator, num_walls=12, num_walkers=4):
    """Boxes and walkers all around, none within half a meter of the start."""
    boxes = []
    while len(boxes) < num_walls:
        x, y, hx, hy, yaw = generator.uniform([-5, -5, 0.05, 0.05, -4], [5, 5, 0.9, 0.3, 4])
        if np.hypot(x, y) > 0.7 + np.hypot(hx, hy):
            boxes.append((x, y, hx, hy, yaw))
    walkers = [
        walker(
            *generator.uniform(-4, 4, (generator.integers(2, 9), 2)),
            speed=generator.uniform(0.5, 1.0),
            offset=generator.uniform(0, 3),
        )
        for _ in range(num_walkers)
    ]
    standers = [stander(*generator.uniform(1, 4, 2))]
    return scene(boxes, (0, 0, generator.uniform(-3, 3)), walkers + standers)
