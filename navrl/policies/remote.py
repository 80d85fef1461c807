"""Controller in another process, on this computer or another one, by lines of JSON.

navrl writes one line for each message and reads one line for each answer:

========================  ====================================================================
message                   answer
========================  ====================================================================
``{"type": "hello",``     ``{"observes": ["ranges", "pose", "path"], "action": "physical"}``:
``"protocol":``           the observed keys that each step needs, and whether actions are
``"navrl-remote-1",``     ``"physical"``, e.g. (v, w) in m/s and rad/s, or ``"normalized"``
``"low": [0, -3.14],``    to [-1, 1] by the robot's limits ``low`` and ``high``
``"high": [1, 3.14],``
``"time_step_s": 0.2}``
``{"type": "reset",``     none: ``worlds`` episodes begin, all at once
``"worlds": 100}``
``{"type": "step",``      ``{"action": [[0.5, 0.1], ...]}``: ``[worlds, C]``, finite numbers;
``"observations":``       or ``{"error": "reason"}``, which ends the evaluation
``{"ranges": [...]}}``
========================  ====================================================================

At the end navrl closes the connection; a process should then end.
"""

from __future__ import annotations

import json
import socket
import subprocess
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.checks import check_positive
from navrl.policies.classical.commands import normalized_action
from navrl.policies.controller import Controller
from navrl.sim import RobotModel

PROTOCOL = "navrl-remote-1"
"""Name and version of the protocol."""

_MAX_LINE_BYTES = 64 * 2**20  # actions of 10,000 worlds have about 1 MB
_CHUNK = 2**20  # bytes per read
_ACTIONS = ("physical", "normalized")


class RemotePolicyError(ConnectionError):
    """Error of a remote policy: no connection, no answer in time, or an invalid answer."""


class RemotePolicy(Controller):
    """Controller that another process computes; see :mod:`navrl.policies.remote`.

    It is sent only the keys that it asks for, none of the true state.

    Args:
        address: Command of a process that navrl starts, as a list of words, whose standard input
            and output are the connection; or ``tcp://HOST:PORT`` of a running server. navrl does
            not encrypt: use a server of another computer in networks that you trust.
        robot: Robot whose limits scale physical actions.
        time_step_s: Duration of a step, s; sent in the first message.
        timeout_s: Maximum time for an answer, s.
        start_timeout_s: Maximum time for the first answer, s; the process may load a model.

    Raises:
        RemotePolicyError: If the first answer is late or invalid.
        ValueError: If a time is not positive, or the address is malformed.
    """

    def __init__(
        self,
        address: str | Sequence[str],
        robot: RobotModel,
        time_step_s: float = 0.2,
        timeout_s: float = 10.0,
        start_timeout_s: float = 60.0,
    ) -> None:
        """Connect, and exchange the first messages."""
        super().__init__()
        check_positive(timeout_s=timeout_s, start_timeout_s=start_timeout_s)
        self._robot, self._timeout_s = robot, timeout_s
        self._lines = _Lines(address, start_timeout_s)
        low, high = robot.command_limits
        hello = {"low": list(low), "high": list(high), "time_step_s": time_step_s}
        try:
            self._lines.send({"type": "hello", "protocol": PROTOCOL, **hello}, start_timeout_s)
            answer = self._lines.receive(start_timeout_s)
            self._observes = self._checked_keys(answer.get("observes"))
            self.in_keys = [*self._observes]
            self.out_keys = [keys.ACTION]
            self._is_physical = answer.get("action", "physical") == "physical"
            if answer.get("action", "physical") not in _ACTIONS:
                raise self._lines.error(f"action={answer['action']!r}: must be one of {_ACTIONS}")
        except BaseException:
            self.close()
            raise

    def prepare(self, scenarios: Sequence[object]) -> None:
        """Report that the episodes of all worlds begin; their scenarios are not sent."""
        self._lines.send({"type": "reset", "worlds": len(scenarios)}, self._timeout_s)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[N, C]``.

        Raises:
            RemotePolicyError: If a key is not observed, or the answer is late or invalid.
        """
        observations = {key: self._observed(tensordict, key).tolist() for key in self._observes}
        self._lines.send({"type": "step", "observations": observations}, self._timeout_s)
        answer = self._lines.receive(self._timeout_s)
        shape = (tensordict.batch_size.numel(), self._robot.command_size)
        try:
            action = np.asarray(answer.get("action"), dtype=np.float64)
        except (TypeError, ValueError):
            action = np.zeros(0)
        if action.shape != shape or not np.isfinite(action).all():
            found = str(answer.get("action"))[:60]
            raise self._lines.error(
                f"action={found}: must be finite numbers of shape {list(shape)}"
            )
        values = torch.from_numpy(action)
        if self._is_physical:
            values = normalized_action(self._robot, values)
        return tensordict.set(keys.ACTION, values.clamp(-1.0, 1.0).float())

    def close(self) -> None:
        """Close the connection; a started process gets some seconds to end."""
        self._lines.close()

    def _checked_keys(self, observes: object) -> list[str]:
        if not isinstance(observes, list) or not all(isinstance(key, str) for key in observes):
            raise self._lines.error(f"observes={str(observes)[:60]}: must be a list of keys")
        return observes

    def _observed(self, tensordict: TensorDictBase, key: str) -> torch.Tensor:
        value = tensordict.get(key, None)
        if value is None:
            known = ", ".join(sorted(map(str, tensordict.keys())))
            raise self._lines.error(f"observes={key}: is not observed; here are {known}")
        return value


class _Lines:
    """Connection that sends and receives JSON, one object per line.

    After the first error every call raises it again, so that a second timeout is not waited for.
    """

    def __init__(self, address: str | Sequence[str], timeout_s: float) -> None:
        self._process: subprocess.Popen | None = None
        self._failure: RemotePolicyError | None = None
        self._buffer = b""
        self._address = address if isinstance(address, str) else " ".join(address)
        try:
            self._socket = self._connected(address, timeout_s)
        except OSError as error:
            raise RemotePolicyError(f"{self._address}: {error.strerror or error}") from error

    def _connected(self, address: str | Sequence[str], timeout_s: float) -> socket.socket:
        if isinstance(address, str):
            host, _, port = address.removeprefix("tcp://").rpartition(":")
            if not address.startswith("tcp://") or not host or not port.isdecimal():
                raise ValueError(f"address={address}: must be tcp://HOST:PORT")
            return socket.create_connection((host.strip("[]"), int(port)), timeout_s)
        ours, theirs = socket.socketpair()  # unlike a pipe it has timeouts
        with theirs:
            self._process = subprocess.Popen(
                list(address), stdin=theirs.fileno(), stdout=theirs.fileno()
            )
        return ours

    def send(self, message: dict[str, Any], timeout_s: float) -> None:
        """Send a message.

        Raises:
            RemotePolicyError: If it is not read in time, or the connection has ended.
        """
        self._check()
        self._socket.settimeout(timeout_s)
        try:
            self._socket.sendall(json.dumps(message).encode() + b"\n")
        except TimeoutError as error:
            raise self.error(f"read no message for timeout_s={timeout_s:g} s") from error
        except OSError as error:
            raise self.error(self._ended()) from error

    def receive(self, timeout_s: float) -> dict[str, Any]:
        """Return the next answer.

        Raises:
            RemotePolicyError: If it is late, is not an object in a line of JSON or has an error.
        """
        self._check()
        end = time.monotonic() + timeout_s
        while b"\n" not in self._buffer:
            self._socket.settimeout(max(end - time.monotonic(), 1e-3))
            try:
                data = self._socket.recv(_CHUNK)
            except TimeoutError as error:
                raise self.error(f"no answer for timeout_s={timeout_s:g} s") from error
            except OSError:
                data = b""
            if not data:
                raise self.error(self._ended())
            self._buffer += data
            if len(self._buffer) > _MAX_LINE_BYTES:
                raise self.error(f"answer: must have at most {_MAX_LINE_BYTES:,} bytes")
        line, _, self._buffer = self._buffer.partition(b"\n")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise self.error(f"answer={line[:60]!r}: must be a JSON object in one line")
        if "error" in answer:
            raise self.error(str(answer["error"])[:500])
        return answer

    def error(self, reason: str) -> RemotePolicyError:
        """Return an error of this connection, which every later call raises again."""
        self._failure = RemotePolicyError(f"policy {self._address}: {reason}")
        return self._failure

    def close(self) -> None:
        self._socket.close()
        if self._process is not None:
            try:
                self._process.wait(timeout=2.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _check(self) -> None:
        if self._failure is not None:
            raise RemotePolicyError(*self._failure.args)

    def _ended(self) -> str:
        if self._process is None:
            return "the server closed the connection"
        try:
            status = self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            return "the process closed its output"
        return f"the process ended with exit status {status}; its messages are above"
