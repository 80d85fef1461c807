"""Contacts and distances by hand, in the plain form that the kernels are compiled from."""

import math

import pytest
import torch

from navrl.ops.contact import (
    HIT_BY_PEDESTRIAN,
    MOVING_SPEED,
    PEDESTRIAN,
    classify_contact,
    nearest_point_on_box,
)
from navrl.ops.distance import point_box_distance

BOX = (2.0, 1.0, 0.5, 0.25)  # center and half sizes, m


@pytest.mark.parametrize(
    ("point", "nearest"),
    [
        ((3.0, 1.1), (2.5, 1.1)),
        ((1.0, 0.9), (1.5, 0.9)),
        ((2.2, 3.0), (2.2, 1.25)),
        ((2.2, -3.0), (2.2, 0.75)),
        ((4.0, 3.0), (2.5, 1.25)),
        ((0.0, 0.0), (1.5, 0.75)),
        ((2.4, 0.8), (2.4, 0.8)),
        ((2.5, 1.25), (2.5, 1.25)),
    ],
    ids=["front", "back", "left", "right", "corner", "other corner", "inside", "on the corner"],
)
@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi / 2, -2.3])
def test_nearest_point_and_distance_of_a_turned_box(point, nearest, yaw):
    """The same picture, turned about the origin."""
    cos, sin = math.cos(yaw), math.sin(yaw)

    def turned(x, y):
        return cos * x - sin * y, sin * x + cos * y

    center = turned(*BOX[:2])
    found = nearest_point_on_box(*turned(*point), *center, *BOX[2:], cos, sin)
    assert found == pytest.approx(turned(*nearest), abs=1e-12)
    boxes = torch.tensor([[*center, *BOX[2:], yaw]], dtype=torch.float64)
    distance = point_box_distance(torch.tensor(turned(*point), dtype=torch.float64), boxes)
    assert distance.tolist() == pytest.approx([math.dist(point, nearest)], abs=1e-12)


def test_distance_to_an_absent_box_is_infinite():
    boxes = torch.tensor([[math.nan] * 5, [1.0, 0.0, 0.25, 0.25, 0.0]])
    assert point_box_distance(torch.zeros(2), boxes).tolist() == [math.inf, 0.75]


@pytest.mark.parametrize(
    ("v", "point", "fault"),
    [
        (1.0, (0.1, 0.0), PEDESTRIAN),
        (1.0, (-0.1, 0.0), HIT_BY_PEDESTRIAN),
        (-1.0, (-0.1, 0.0), PEDESTRIAN),
        (-1.0, (0.1, 0.0), HIT_BY_PEDESTRIAN),
        (0.0, (0.1, 0.0), HIT_BY_PEDESTRIAN),
        (1.01 * MOVING_SPEED, (0.1, 0.0), PEDESTRIAN),
        (0.99 * MOVING_SPEED, (0.1, 0.0), HIT_BY_PEDESTRIAN),
        (-1.01 * MOVING_SPEED, (-0.1, 0.0), PEDESTRIAN),
        (-0.99 * MOVING_SPEED, (-0.1, 0.0), HIT_BY_PEDESTRIAN),
        (1.0, (0.0, 0.1), HIT_BY_PEDESTRIAN),
        (1.0, (0.01, 0.3), PEDESTRIAN),
        (1.0, (-0.01, 0.3), HIT_BY_PEDESTRIAN),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 2.0, -1.2])
def test_at_fault_party_by_speed_and_half_plane(v, point, fault, yaw):
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = 3.0, -2.0
    px = x + cos * point[0] - sin * point[1]
    py = y + sin * point[0] + cos * point[1]
    if point[0] == 0.0:
        px, py = px - 1e-12 * cos, py - 1e-12 * sin  # exactly abeam is not ahead
    assert classify_contact(x, y, cos, sin, v, px, py) == fault
