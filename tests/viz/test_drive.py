"""Pictures show forward speed and turn rate, also of bases with other commands."""

from types import SimpleNamespace

import numpy as np
import pytest

from navrl.viz.drive import forward_and_turn


def test_two_commands_are_shown_unchanged():
    recording = SimpleNamespace(action=np.array([[0.5, -1.0]], dtype=np.float32))
    assert forward_and_turn(recording) is recording.action


def test_other_commands_are_measured_from_poses():
    """Facing left, a step of 0.1 m along y is forward; the yaw passes from pi to -pi."""
    pose = np.array([[0, 0, np.pi / 2], [0.3, 0.1, np.pi - 0.05], [0.3, 0.1, -np.pi + 0.05]])
    recording = SimpleNamespace(action=np.zeros((2, 3)), pose=pose, time_step_s=0.2)
    found = forward_and_turn(recording)
    assert found[:, 0] == pytest.approx([0.5, 0.0])
    assert found[1, 1] == pytest.approx(0.5)
