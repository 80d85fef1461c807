"""Paths among oriented boxes and discs."""

import math

import numpy as np
import pytest

from navrl.worlds import ClearanceMap
from navrl.worlds.planner import NoPathError

NO_DISCS = np.zeros((0, 3))


def room(*boxes):
    outer = [(0, 3, 4, 0.1, 0), (0, -3, 4, 0.1, 0), (-4, 0, 0.1, 3, 0), (4, 0, 0.1, 3, 0)]
    return np.array([*outer, *boxes], dtype=float)


def wall_with_door(width, yaw):
    """Two halves of a wall through the center, turned by yaw, with a door in the middle."""
    half = (5.0 - width / 2) / 2
    offset = width / 2 + half
    along = np.array([math.cos(yaw), math.sin(yaw)])
    return [(*(side * offset * along), half, 0.05, yaw) for side in (-1, 1)]


@pytest.mark.parametrize("yaw", [math.pi / 2, math.pi / 4, 1.0])
def test_path_leads_through_the_door_of_a_turned_wall(yaw):
    grid = ClearanceMap(room(*wall_with_door(0.72, yaw)), NO_DISCS)
    across = np.array([math.cos(yaw + math.pi / 2), math.sin(yaw + math.pi / 2)])
    path = grid.path(-2.0 * across, 2.0 * across)
    assert grid.distance(path).min() >= 0.23
    crossing = path[np.abs(path @ across).argmin()]
    assert np.linalg.norm(crossing) < 0.08  # the middle of the door
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.101


def test_narrow_door_and_close_points_have_no_path():
    grid = ClearanceMap(room(*wall_with_door(0.40, 1.0)), NO_DISCS)
    across = np.array([math.cos(1.0 + math.pi / 2), math.sin(1.0 + math.pi / 2)])
    with pytest.raises(NoPathError, match="no path from"):
        grid.path(-2.0 * across, 2.0 * across)
    with pytest.raises(NoPathError):
        grid.path([3.8, 0.0], [0.5, 2.0])


def test_path_keeps_away_from_obstacles_where_there_is_space():
    free = ClearanceMap(room(), NO_DISCS)
    straight = free.path([-3, 0], [3, 0])
    post = ClearanceMap(room(), np.array([[0.0, 0.0, 0.1]]))
    around = post.path([-3, 0], [3, 0])
    assert np.abs(straight[:, 1]).max() < 0.06
    assert 0.3 <= post.distance(around).min() <= 0.6  # more than the clearance of 0.23 m


def test_clearance_of_cells_is_the_distance_to_the_shapes():
    boxes, discs = room((1.0, 1.0, 0.5, 0.2, 0.6)), np.array([[-2.0, 0.5, 0.3]])
    grid = ClearanceMap(boxes, discs)
    points = np.random.default_rng(0).uniform(-3, 3, (500, 2))
    cells = grid.origin + (grid.index(points) + 0.5) * grid.cell
    wanted = np.minimum(grid.distance(cells), grid.comfort)
    i, j = grid.index(points).T
    np.testing.assert_allclose(grid.clearance[i, j], wanted, atol=1e-9)


def test_smallest_distance_is_exact_up_to_comfort():
    random = np.random.default_rng(3)
    boxes = random.uniform([-3, -3, 0.05, 0.05, -3], [3, 3, 0.4, 0.4, 3], (40, 5))
    grid = ClearanceMap(boxes, np.array([[0.0, 0.0, 0.3]]))
    for _ in range(200):
        points = random.uniform(-4.5, 4.5, (int(random.integers(1, 60)), 2))
        wanted = min(grid.distance(points).min(), grid.comfort)
        assert grid._smallest_distance(points) == wanted


def test_tight_map_covers_the_obstacles_and_a_margin():
    wall = np.array([[0.0, 0.0, 10.0, 0.1, 0.0]])
    assert ClearanceMap(wall, NO_DISCS, is_tight=True).clearance.shape == (440, 44)
    assert ClearanceMap(wall, NO_DISCS).clearance.shape[1] > 400


def test_values_out_of_range_raise():
    with pytest.raises(ValueError, match=r"comfort=0\.2: must be > clearance"):
        ClearanceMap(room(), NO_DISCS, clearance=0.23, comfort=0.2)
    with pytest.raises(ValueError, match="must have at least one obstacle"):
        ClearanceMap(np.zeros((0, 5)), NO_DISCS)
