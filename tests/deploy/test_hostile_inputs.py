"""Twenty-one hostile inputs, each listed on the page: the robot stands, or the call raises."""

import math
import re

import numpy as np
import pages
import pytest

from navrl.deploy import Controller, DriveState
from navrl.policies import ZOO

PATH = [(0.1 * i, 0.0) for i in range(41)]  # m, straight ahead
BEARING = -np.pi + np.arange(360) * 2 * np.pi / 360
CORRIDOR = np.minimum(1.5 / np.maximum(np.abs(np.sin(BEARING)), 1e-9), 11.0)
ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", re.M)


def page_rows():
    """Return the results that the page lists by input: of the control loop and of a file."""
    text = (pages.ROOT / "docs" / "robots.md").read_text().partition("## Hostile inputs")[2]
    rows = ROW.findall(text.partition("\n## ")[0])[1:]  # without the head
    return {name: results for name, *results in rows}


def listed_state(result):
    """Return the state of a result, e.g. of '`ValueError`, then `stale_scan`'."""
    return result.rpartition("then ")[2].strip("`")


def ahead(value, degrees=10):
    return np.where(np.abs(BEARING) <= np.radians(degrees), value, CORRIDOR)


def scan(control, now, ranges, **arguments):
    control.on_scan(now - 0.19, ranges, **arguments)


def moved(control, now, x):
    """Odometry of a robot that drives although its scans do not change."""
    for step in range(4):
        stamp = now - 0.24 + 0.08 * step
        control.on_odometry(stamp, (x * step, 0.0, 0.0), (0.0, 0.0))
        scan(control, stamp, CORRIDOR)


INPUTS = {
    "all beams NaN": lambda c, t: scan(c, t, np.full(360, np.nan)),
    "all beams +inf": lambda c, t: scan(c, t, np.full(360, np.inf)),
    "all beams 0": lambda c, t: scan(c, t, np.zeros(360)),
    "all beams at range_max": lambda c, t: scan(c, t, np.full(360, 12.0)),
    "all beams NaN but one": lambda c, t: scan(c, t, np.r_[np.full(359, np.nan), 3.0]),
    "all beams negative": lambda c, t: scan(c, t, np.full(360, -1.0)),
    "-inf straight ahead": lambda c, t: scan(c, t, ahead(-np.inf, 0.5)),
    "NaN in a sector of 20 degrees ahead": lambda c, t: scan(c, t, ahead(np.nan)),
    "readings below range_min ahead": lambda c, t: scan(c, t, ahead(0.05)),
    "ranges in millimeters": lambda c, t: scan(c, t, 1000.0 * CORRIDOR),
    "a scan without beams": lambda c, t: scan(c, t, []),
    "angle_increment of 0 or in degrees": lambda c, t: scan(c, t, CORRIDOR, angle_increment=1.0),
    "range_max of 0": lambda c, t: scan(c, t, CORRIDOR, range_max=0.0),
    "a scan of a second ago": lambda c, t: c.on_scan(t - 1.0, CORRIDOR),
    "a scan of the future": lambda c, t: c.on_scan(t + 5.0, CORRIDOR),
    "one scan again and again while the robot moves": lambda c, t: moved(c, t, 0.3),
    "a pose that is not finite": lambda c, t: c.on_pose(t, (np.nan, 0.0, 0.0)),
    "a velocity of odometry that is not finite": lambda c, t: c.on_odometry(
        t + 0.01, (0.0, 0.0, 0.0), (np.nan, 0.0)
    ),
    "a yaw in degrees": lambda c, t: c.on_pose(t, (0.0, 0.0, 90.0)),
    "a pose in millimeters": lambda c, t: c.on_pose(t, (2000.0, 0.0, 0.0)),
    "a path that is not finite or empty": lambda c, t: c.on_path([(0.0, 0.0), (np.nan, 0.0)]),
}

SECOND = {
    "angle_increment of 0 or in degrees": lambda c, t: scan(c, t, CORRIDOR, angle_increment=0.0),
    "a path that is not finite or empty": lambda c, t: c.on_path([]),
}  # rows with an "or"


@pytest.fixture(scope="module", params=["paper", "navrl-best", "navrl-best-deployed"])
def control(request):
    return Controller.from_bundle(ZOO / request.param, "rplidar_a1")


def start(control, now, has_driven):
    """Restart, and drive for some steps."""
    control.tick(now - 100.0)  # a clock that goes back clears the inputs
    control.tick(now - (0.9 if has_driven else 0.1))
    control.runner.reset()
    control.on_path(PATH)
    for step in range(3 if has_driven else 0):
        stamp = now - 0.8 + 0.2 * step
        control.on_odometry(stamp, (0.0, 0.0, 0.0), (0.0, 0.0))
        control.on_pose(stamp, (0.0, 0.0, 0.0))
        scan(control, stamp, CORRIDOR + 0.001 * step)
        assert control.tick(stamp).v > 0.5
    control.on_odometry(now, (0.0, 0.0, 0.0), (0.0, 0.0))
    control.on_pose(now, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("has_driven", [False, True])
@pytest.mark.parametrize(("name", "give"), [*INPUTS.items(), *SECOND.items()])
def test_hostile_input_commands_zero_or_raises(control, name, give, has_driven):
    now = 1000.0
    start(control, now - 0.3, has_driven)
    if any(kind in name for kind in ("pose", "yaw", "path", "odometry")):
        scan(control, now, CORRIDOR + 0.01)
    error = None
    try:
        give(control, now)
    except ValueError as raised:
        error = raised
    result = page_rows()[name][0]
    assert (error is not None) == ("ValueError" in result)
    for tick in (now, now + 0.05, now + 0.1):
        v, w, state = control.tick(tick)
        assert v == w == 0.0, f"{state} {error}"
        assert state == listed_state(result) and state is not DriveState.DRIVE


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_hostile_stamps_and_velocities_raise(control, value):
    with pytest.raises(ValueError, match=r"stamp=.*: must be finite"):
        control.on_scan(value, CORRIDOR)
    with pytest.raises(ValueError, match=r"velocity=.*: must be 2 finite numbers"):
        control.on_odometry(1.0, (0, 0, 0), (value, 0.0))


def test_page_lists_each_hostile_input():
    assert len(INPUTS) == 21 and set(page_rows()) == set(INPUTS)
