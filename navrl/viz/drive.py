"""Forward speed and turn rate of a recorded episode with any base."""

from __future__ import annotations

import numpy as np

from navrl.evaluation.recording import Recording


def forward_and_turn(recording: Recording) -> np.ndarray:
    """Return forward speed and turn rate of each step, ``[T, 2]``, m/s and rad/s.

    They are the command of a base with two; those of other bases are measured from the poses.
    """
    if recording.action.shape[1] == 2:
        return recording.action
    moved, yaw = np.diff(recording.pose[:, :2], axis=0), recording.pose[:-1, 2]
    forward = moved[:, 0] * np.cos(yaw) + moved[:, 1] * np.sin(yaw)
    turned = (np.diff(recording.pose[:, 2]) + np.pi) % (2 * np.pi) - np.pi
    return np.stack([forward, turned], axis=1) / recording.time_step_s
