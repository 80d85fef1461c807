"""Golden drives have no step at which rounding decides."""

import numpy as np
import pytest

from navrl.export.golden import record


class Threshold:
    """Runner that turns left if its nearest range is at least 2 m, else right."""

    def reset(self):
        pass

    def act(self, scan, *others):
        return np.array([0.5, 1.0 if scan.min() >= 2.0 else -1.0])


def drive(*nearest):
    count = len(nearest)
    ranges = np.full((count, 8), 3.0)
    ranges[:, 3] = nearest
    line = np.stack([np.linspace(0.0, 4.0, 20), np.zeros(20)], axis=-1)
    return {
        "ranges": ranges,
        "pose": np.zeros((count, 3)),
        "path": line,
        "velocity": np.zeros((count, 2)),
    }


def test_drive_ends_before_a_command_that_jumps():
    drives = [drive(2.5, 1.5, 2.0, 2.5), drive(2.0, 2.5), drive(1.999, 2.001, 2.5, 1.5)]
    golden = record(Threshold(), drives, ["ranges", "pose", "path", "velocity"], 5)
    assert golden["drive"].tolist() == [0, 0, 2, 2, 2]
    assert golden["ranges_mm"][:, 3].tolist() == [2500, 1500, 1999, 2001, 2500]
    assert golden["command"][:, 1].tolist() == [1.0, -1.0, -1.0, 1.0, 1.0]
    assert golden["path"].shape == (3, 200, 2)


def test_drives_are_taken_only_as_needed():
    def endless():
        while True:
            yield drive(2.5, 1.5, 2.5)

    golden = record(Threshold(), endless(), ["ranges", "pose", "path"], 7)
    assert golden["drive"].tolist() == [0, 0, 0, 1, 1, 1, 2]


def test_too_few_steps_are_an_error():
    with pytest.raises(ValueError, match="golden_steps=3: must be at most 2"):
        record(Threshold(), [drive(2.5, 1.5, 2.0, 2.5)], ["ranges", "pose", "path"], 3)


class Steep(Threshold):
    """Runner whose turn rate rises by 50 rad/s per meter of the nearest range around 2 m."""

    def act(self, scan, *others):
        return np.array([0.5, 50.0 * np.clip(scan.min() - 2.0, -0.01, 0.01)])


def test_drive_ends_before_a_steep_command():
    """A nudge alone moves it by more than the tolerance of a file."""
    drives = [drive(2.5, 2.005, 2.5), drive(1.5, 2.5)]
    golden = record(Steep(), drives, ["ranges", "pose", "path"], 3)
    assert golden["ranges_mm"][:, 3].tolist() == [2500, 1500, 2500]
