"""Loader of exported policies, to be copied to robots: it needs numpy and onnxruntime."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import onnxruntime

FORMAT = "navrl-onnx-1"
STATE, NEXT = "state_", "next_"
"""Prefixes of the inputs of the last step's state and of the outputs for the next step."""
TOLERANCE = 1e-5  # largest error of a golden command, m/s and rad/s
_TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(bool)": np.bool_,
    "tensor(int64)": np.int64,
}
_MAX_YAW = 2.0 * np.pi


class OnnxFileError(ValueError):
    """File that is not an exported policy, or that does not give its golden commands."""


class OnnxPolicy:
    """Run an exported policy, with one call per scan.

    Args:
        file: File of ``navrl-export``.
        check_steps: Steps of the golden drive that must be reproduced; 0 for none.
        num_threads: Threads of ONNX Runtime.

    Attributes:
        metadata: Entries of the file: beams, largest range, time step, robot, policy and version.
        drive_state: State after the last call of :meth:`act`, e.g. ``drive`` or ``blind``; ``None``
            before the first one.

    Raises:
        OnnxFileError: If the file is no policy, or does not reproduce its golden drive.
        OSError: If the file cannot be read.
    """

    def __init__(self, file: str | Path, check_steps: int = 10, num_threads: int = 1) -> None:
        """Load the file and check it."""
        self._session = open_session(file, num_threads)
        entries = dict(self._session.get_modelmeta().custom_metadata_map)
        if entries.pop("format", None) != FORMAT:
            raise OnnxFileError(f"{file}: must be a file of navrl-export, format {FORMAT}")
        del entries["golden"]
        self.metadata = {name: json.loads(value) for name, value in entries.items()}
        if self.metadata["kind"] != "policy":
            raise OnnxFileError(f"{file}: must be a policy, got a network without its transforms")
        inputs = {each.name: each for each in self._session.get_inputs()}
        self._zeros = {
            name: np.zeros([1, *each.shape[1:]], _TYPES[each.type]) for name, each in inputs.items()
        }
        self._outputs = [each.name for each in self._session.get_outputs()]
        self.drive_state: str | None = None
        self.reset()
        errors = self.golden_errors(check_steps) if check_steps else np.zeros(0)
        if not (errors <= TOLERANCE).all():
            raise OnnxFileError(
                f"{file}: must give the commands of its golden drive within {TOLERANCE:g}, off by "
                f"{errors.max():g}; export the policy again"
            )

    def reset(self) -> None:
        """Forget the last step: the next scan is the first of a new drive."""
        self._state = self.initial_state(1)

    def initial_state(self, batch: int) -> dict[str, np.ndarray]:
        """Return the state before the first step of ``batch`` robots, by input."""
        return {
            name: zeros.repeat(batch, axis=0)
            for name, zeros in self._zeros.items()
            if name.startswith(STATE)
        }

    def step(
        self, sensors: Mapping[str, np.ndarray], state: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Return commands ``[B, C]``, drive states ``[B]`` and the next state of B robots.

        Args:
            sensors: Inputs ``[B, ...]`` by name; others than the policy's are ignored.
            state: Result of :meth:`initial_state` or of the step before.
        """
        names = [name for name in self._zeros if not name.startswith(STATE)]
        results = self._session.run(None, {**{name: sensors[name] for name in names}, **state})
        named = dict(zip(self._outputs, cast(list[np.ndarray], results), strict=True))
        after = {name: named[f"{NEXT}{name.removeprefix(STATE)}"] for name in state}
        return named["command"], named["drive_state"], after

    def act(
        self,
        ranges: ArrayLike,
        pose: ArrayLike,
        path: ArrayLike,
        velocity: ArrayLike | None = None,
        scan_motion: ArrayLike | None = None,
        command: ArrayLike | None = None,
    ) -> np.ndarray:
        """Return the command ``[C]`` for one scan, e.g. (v, w) in m/s and rad/s.

        Args:
            ranges: ``[beams]`` m; REP 117: NaN is invalid, -inf too close, inf or 0 no return.
            pose: ``[3]`` (x, y, yaw), m and rad, in the frame of ``path``.
            path: ``[P, 2]`` m, from about the robot to the goal.
            velocity: ``[C]`` velocity now; required by policies that read it.
            scan_motion: ``[2, 3]`` frames of the first and last beam in the present one; ``None``
                for a scan without age.
            command: ``[C]`` command that was driven last, if it was not the last result.

        Raises:
            ValueError: If a value has another shape or is not finite, the yaw is not in radians, or
                the policy needs a velocity that is not given.
        """
        given = {"pose": pose, "path": self._padded(path), "velocity": velocity}
        given["scan_motion"] = np.zeros((2, 3)) if scan_motion is None else scan_motion
        row = {name: self._row(name, value) for name, value in given.items() if name in self._zeros}
        row["ranges"] = self._row("ranges", ranges, finite=False)
        if "pose" in row and abs(row["pose"][0, 2]) > _MAX_YAW:
            raise ValueError(f"pose: yaw={row['pose'][0, 2]:g}: must be in rad, in [-2 pi, 2 pi]")
        state = dict(self._state)
        commands = f"{STATE}commands"
        if command is not None and commands in state:
            state[commands] = state[commands].copy()
            state[commands][0, 0] = command
        result, number, self._state = self.step(row, state)
        self.drive_state = self.metadata["drive_states"][int(number[0])]
        return result[0]

    def _row(self, name: str, value: ArrayLike | None, finite: bool = True) -> np.ndarray:
        """Return a checked input ``[1, ...]``."""
        zeros = self._zeros[name]
        if value is None:
            raise ValueError(f"{name}=None: must be given, this policy reads it")
        with np.errstate(over="ignore"):
            row = np.asarray(value, zeros.dtype)[None]
        if row.shape != zeros.shape:
            raise ValueError(f"{name}.shape={row.shape[1:]}: must be {zeros.shape[1:]}")
        if finite and not np.isfinite(row).all():
            raise ValueError(f"{name}: must be finite")
        return row

    def _padded(self, path: ArrayLike) -> np.ndarray:
        """Return a path that repeats its last point."""
        path = np.asarray(path, np.float64)
        num_points = self._zeros["path"].shape[1] if "path" in self._zeros else len(path)
        if path.ndim != 2 or path.shape[1] != 2 or not 1 <= len(path) <= num_points:
            raise ValueError(f"path.shape={path.shape}: must be [P, 2], P from 1 to {num_points}")
        return np.concatenate([path, np.repeat(path[-1:], num_points - len(path), axis=0)])

    def golden(self) -> dict[str, np.ndarray]:
        """Return the recorded drives of the file; see :func:`navrl.export.golden.record`."""
        return unpack(self._session.get_modelmeta().custom_metadata_map["golden"])

    def golden_errors(self, num_steps: int | None = None) -> np.ndarray:
        """Return the largest error of the command at each step of the file's golden drives.

        Args:
            num_steps: Number of steps from the start; ``None`` for all.
        """
        golden = self.golden()
        drives = golden["drive"][:num_steps]
        errors = []
        for step, drive in enumerate(drives):
            if step == 0 or drive != drives[step - 1]:
                self.reset()
            error = np.abs(self.act(**golden_step(golden, step)) - golden["command"][step])
            errors.append(error.max())
        self.reset()
        self.drive_state = None
        return np.array(errors)


def open_session(file: str | Path, num_threads: int) -> onnxruntime.InferenceSession:
    """Return a session of ONNX Runtime for a file.

    Raises:
        OnnxFileError: If it is no ONNX file.
        OSError: If the file cannot be read.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = num_threads
    providers = ["CPUExecutionProvider"]
    try:
        return onnxruntime.InferenceSession(Path(file).read_bytes(), options, providers=providers)
    except OSError:
        raise
    except Exception as error:  # of ONNX Runtime's own types
        raise OnnxFileError(f"{file}: must be an ONNX file ({error})") from error


def run_network(file: str | Path, inputs: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the actions ``[B, A]`` of an exported network.

    Args:
        file: File of ``navrl-export`` with ``network_only=true``.
        inputs: Scaled inputs ``[B, ...]`` by name.
    """
    session = open_session(file, num_threads=1)
    (action,) = session.run(None, dict(inputs))
    return cast(np.ndarray, action)


def golden_step(golden: Mapping[str, np.ndarray], step: int) -> dict[str, np.ndarray]:
    """Return the arguments of :meth:`OnnxPolicy.act` at a step of a golden drive."""
    sensors = {"ranges": golden["ranges_mm"][step].astype(np.float32) / np.float32(1000.0)}
    sensors["path"] = golden["path"][int(golden["drive"][step])]
    others = ("pose", "velocity", "scan_motion")
    return sensors | {name: golden[name][step] for name in others if name in golden}


def unpack(text: str) -> dict[str, np.ndarray]:
    """Return the arrays of a golden drive."""
    with np.load(io.BytesIO(base64.b64decode(text)), allow_pickle=False) as arrays:
        return dict(arrays)
