"""Hashes of all inputs that determine the results of an evaluation."""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

import navrl
from navrl.factory.policy import bundle_folder, with_controller
from navrl.factory.values import flat_values
from navrl.jobs.run_folder import result_values

PACKAGE = Path(navrl.__file__).parent
_NO_RESULT = (
    "algos",
    "training",
    "viz",
    "deploy",
    "benchmarks",
    "cli",
)  # not in evaluations


def evaluation_inputs(cfg: DictConfig, policy: Mapping[str, Any]) -> dict[str, str]:
    """Return hashes of an evaluation's inputs; equal inputs give equal results.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.
        policy: Files of a bundle by name, or the node of a controller; see :func:`policy_hash`.

    Returns:
        ``policy_hash``, ``config_hash`` of every value that may change a result, and ``code_hash``
        of the package and of the user's own modules that the configuration names.
    """
    values = {name: value for name, value in result_values(cfg).items() if name != "policy"}
    return {
        "policy_hash": policy_hash(policy),
        "config_hash": _hash_of(values),
        "code_hash": _hash_of({"navrl": code_hash(), "own": _own_modules(cfg, policy)}),
    }


def bundle_files(folder: Path) -> dict[str, bytes]:
    """Return the files of a bundle that determine its behavior, by name."""
    return {name: (folder / name).read_bytes() for name in ("config.yaml", "weights.safetensors")}


def policy_hash(parts: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a policy's parts: bytes of files, or plain values of a node."""
    return _hash_of({name: _plain(part) for name, part in parts.items()})


@lru_cache(maxsize=1)
def code_hash() -> str:
    """Return the hash of the installed package's source, :func:`source_hash`."""
    return source_hash(PACKAGE)


def source_hash(package: Path) -> str:
    """Return the SHA-256 of the source files of a package that affect an evaluation."""
    found = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        place = file.relative_to(package)
        if place.parts[0] not in _NO_RESULT:
            found.update(f"{place.as_posix()}\n".encode())
            found.update(file.read_bytes())
    return found.hexdigest()


def _own_modules(cfg: DictConfig, policy: Mapping[str, Any]) -> dict[str, str]:
    """Return hashes of the modules outside navrl that the configuration or policy names."""
    plain = {key: part for key, part in policy.items() if not isinstance(part, bytes)}
    values = [*flat_values(cfg).items(), *flat_values(OmegaConf.create(plain)).items()]
    targets = {v for k, v in values if k.endswith(("_target_", "reference")) and isinstance(v, str)}
    modules = {target.replace(":", ".").rpartition(".")[0] for target in targets}
    names = modules | set(cfg.get("allow", ()))
    files = {name: _source_of(name) for name in sorted(names) if name.split(".")[0] != "navrl"}
    return {k: hashlib.sha256(file.read_bytes()).hexdigest() for k, file in files.items() if file}


def _source_of(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module) if module else None
    except (ImportError, ValueError):
        return None  # reported when it is built
    return Path(spec.origin) if spec and spec.origin and Path(spec.origin).is_file() else None


def _plain(part: Any) -> Any:
    return hashlib.sha256(part).hexdigest() if isinstance(part, bytes) else part


def _hash_of(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()


def policy_parts(cfg: DictConfig) -> dict[str, Any]:
    """Return a bundle's files, or a node and the files it names, for :func:`policy_hash`.

    Raises:
        ValueError: If the policy does not exist.
    """
    folder = bundle_folder(cfg.policy)
    if folder is None:
        plain = OmegaConf.to_container(with_controller(cfg).controller, resolve=True)
        node = cast(dict[str, Any], plain)
        values = flat_values(OmegaConf.create(node)).values()
        words = [
            word for value in values for word in (value if isinstance(value, list) else [value])
        ]
        files = {word: Path(word) for word in words if isinstance(word, str)}
        return node | {name: file.read_bytes() for name, file in files.items() if file.is_file()}
    return bundle_files(folder)
