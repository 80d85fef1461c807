"""References to policies that are not bundles; importing this loads no torch.

=====================  ==========================================================================
``policy=``            is played by
=====================  ==========================================================================
``FILE.onnx``          :class:`navrl.policies.OnnxPolicy`: a network, runs no code of the file
``FILE.zip``           :class:`navrl.policies.StableBaselines3Policy`: runs code of the file, so
                       ``trusted=true`` is needed
``MODULE:NAME``        :func:`navrl.policies.load_policy`: a class or function of a Python module
``process:COMMAND``    :class:`navrl.policies.RemotePolicy`: a process that the command starts
``tcp://HOST:PORT``    :class:`navrl.policies.RemotePolicy`: a server that is running
=====================  ==========================================================================
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

KINDS = "FILE.onnx, FILE.zip, MODULE:NAME, process:COMMAND or tcp://HOST:PORT"
"""Kinds of references, for messages."""

_PROCESS, _TCP = "process:", "tcp://"
_CALLABLE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_ROBOT = "${robot}"


def foreign_node(policy: str) -> dict[str, Any] | None:
    """Return the configuration node of a policy outside navrl; ``None`` for any other value.

    Args:
        policy: Value of ``policy=``.

    Raises:
        ValueError: If a file is missing, or a command or address is malformed.

    Example:
        >>> foreign_node("my_package.cautious:Cautious")["_target_"]
        'navrl.policies.load_policy'
    """
    if policy.startswith((_PROCESS, _TCP)):
        return {
            "_target_": "navrl.policies.RemotePolicy",
            "address": _command(policy) if policy.startswith(_PROCESS) else policy,
            "robot": _ROBOT,
            "time_step_s": "${simulator.time_step_s}",
        }
    if _CALLABLE.fullmatch(policy):
        return {"_target_": "navrl.policies.load_policy", "reference": policy, "robot": _ROBOT}
    if policy.endswith(".onnx"):
        node = {"_target_": "navrl.policies.OnnxPolicy", "robot": _ROBOT}
    elif policy.endswith(".zip"):
        node = {"_target_": "navrl.policies.StableBaselines3Policy"}
        node["trusted"] = "${oc.select:trusted,false}"
    else:
        return None
    if not Path(policy).is_file():
        raise ValueError(f"policy={policy}: must be a file that exists")
    return {**node, "file": policy}


def foreign_name(policy: str) -> str:
    """Return a short name of a reference for tables; other policies as they are.

    Example:
        >>> foreign_name("models/ppo.onnx"), foreign_name("process:python3 my_policy.py --fast")
        ('ppo', 'my_policy')
    """
    if policy.startswith(_TCP):
        return policy.removeprefix(_TCP)
    if policy.startswith(_PROCESS):
        words = _command(policy)
        scripts = [word for word in words if Path(word).suffix and not word.startswith("-")]
        return Path((scripts or words)[0]).stem
    if _CALLABLE.fullmatch(policy):
        return policy.partition(":")[2]
    return Path(policy).stem if policy.endswith((".onnx", ".zip")) else policy


def _command(policy: str) -> list[str]:
    try:
        words = shlex.split(policy.removeprefix(_PROCESS))
    except ValueError as error:
        raise ValueError(f"policy={policy}: {error}") from error
    if not words:
        raise ValueError(f"policy={policy}: must be followed by a command, as process:./my_policy")
    return words
