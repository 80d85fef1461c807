"""Controller around a network in an ONNX file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, cast

import numpy as np
import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.deprecation import input_key
from navrl.extras import install_hint
from navrl.policies.classical.commands import normalized_action
from navrl.policies.controller import Controller
from navrl.sim import RobotModel
from navrl.untrusted import DamagedFileError, read_bytes

_TYPES = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(bool)": np.bool_,
    "tensor(int64)": np.int64,
}
_REMEDY = "export the network again, with its weights inside the file"
_ACTIONS = ("normalized", "physical")


class _Input(Protocol):
    """Interface of an input or output of a network in onnxruntime."""

    name: str
    shape: list[int | str | None]
    type: str


class _Network(Protocol):
    """Interface of a session of onnxruntime."""

    def get_inputs(self) -> list[_Input]: ...
    def get_outputs(self) -> list[_Input]: ...
    def run(self, names: None, feeds: Mapping[str, np.ndarray]) -> list[np.ndarray]: ...


class OnnxPolicy(Controller):
    """Play a network from an ONNX file: observations in, action out.

    The network has an input for each key that it reads, ``[N, ...]``, and writes the action
    ``[N, C]``. Its first dimension is dynamic, or 1: then worlds are computed one after another.
    Transforms, lidar and robot are those of the configuration. The file runs no code.

    Args:
        file: ONNX file with its weights inside.
        robot: Robot whose limits scale a physical action.
        inputs: Key of each input whose name is not that of a key, e.g. ``{"obs": "ranges"}``.
        action: ``"normalized"``: the output is in [-1, 1]; ``"physical"``: it is a command, e.g.
            (v, w) in m/s and rad/s.

    Raises:
        ImportError: If onnxruntime is not installed.
        ValueError: If the file is missing, damaged or has no single output, an input is of another
            type, or an argument is not allowed.

    Reference:
        The ONNX format, https://onnx.ai/onnx/intro.
    """

    requires = ("onnxruntime",)

    def __init__(
        self,
        file: str | Path,
        robot: RobotModel,
        inputs: Mapping[str, str] | None = None,
        action: str = "normalized",
    ) -> None:
        """Load the network and check its inputs."""
        super().__init__()
        if action not in _ACTIONS:
            raise ValueError(f"action={action!r}: must be one of {', '.join(_ACTIONS)}")
        self._session, self._file = _session(Path(file)), str(file)
        self._robot, self._is_physical = robot, action == "physical"
        inputs = dict(inputs or {})
        found = {one.name: one for one in self._session.get_inputs()}
        unknown = sorted(inputs.keys() - found.keys())
        if unknown:
            raise ValueError(f"inputs={unknown}: {file} has {', '.join(found)}")
        wrong = [f"{one.name}: {one.type}" for one in found.values() if one.type not in _TYPES]
        if wrong:
            raise ValueError(f"{file}: {wrong[0]}: must be one of {', '.join(_TYPES)}")
        self._inputs = {name: (inputs.get(name, name), one) for name, one in found.items()}
        self._is_single = any(one.shape[:1] == [1] for one in found.values())
        self.in_keys = list(dict.fromkeys(key for key, _ in self._inputs.values()))
        self.out_keys = [keys.ACTION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[N, C]``.

        Raises:
            ValueError: If an observation is missing or has another shape than the network's, or the
                output has another shape.
        """
        count, size = tensordict.batch_size.numel(), self._robot.command_size
        feeds = {name: self._value(tensordict, *one) for name, one in self._inputs.items()}
        rows = [slice(k, k + 1) for k in range(count)] if self._is_single else [slice(None)]
        outputs = [
            self._session.run(None, {name: value[row] for name, value in feeds.items()})[0]
            for row in rows
        ]
        found = np.concatenate(outputs)
        if found.shape != (count, size):
            raise ValueError(f"{self._file}: output {list(found.shape)}: must be {[count, size]}")
        action = torch.from_numpy(found.astype(np.float32))
        if self._is_physical:
            action = normalized_action(self._robot, action)
        return tensordict.set(keys.ACTION, action.clamp(-1.0, 1.0))

    def _value(self, tensordict: TensorDictBase, key: str, declared: _Input) -> np.ndarray:
        """Return the observation of an input, of its type."""
        value = tensordict.get(input_key(key, tensordict.keys()), None)
        if value is None:
            known = ", ".join(sorted(map(str, tensordict.keys())))
            raise ValueError(
                f"{self._file}: input {declared.name}: must be an observed key (here {known}); "
                f"+change.controller.inputs.{declared.name}=KEY names it"
            )
        shape = list(declared.shape[1:])
        if len(shape) != value.ndim - 1 or any(
            isinstance(want, int) and want != have
            for want, have in zip(shape, value.shape[1:], strict=True)
        ):
            raise ValueError(
                f"{self._file}: input {declared.name}: must have the shape {shape} per world, "
                f"{key} has {list(value.shape[1:])}"
            )
        return value.numpy().astype(_TYPES[declared.type])


def _session(file: Path) -> _Network:
    try:
        import onnxruntime  # pyright: ignore[reportMissingImports] -- an extra
    except ImportError as error:
        raise ImportError(f"policy: needs onnxruntime (MIT); {install_hint('onnx')}") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = torch.get_num_threads(), 4
    try:  # bytes have no folder, in which weights could be read from other files
        content = read_bytes(file, _REMEDY)
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except FileNotFoundError as error:
        raise ValueError(f"file={file}: must be an ONNX file that exists") from error
    except (DamagedFileError, OSError):
        raise
    except Exception as error:  # onnxruntime has no base class of its errors
        line = str(error).splitlines()[0][:200]
        raise DamagedFileError(file, f"not a usable ONNX network ({line})", _REMEDY) from error
    if len(session.get_outputs()) != 1:
        names = ", ".join(one.name for one in session.get_outputs())
        raise ValueError(f"{file}: outputs {names}: must be one, the action")
    return cast(_Network, session)
