"""A policy bundle: weights and all that is needed to run them, in one folder.

========================  ===================================================================
file                      content
========================  ===================================================================
``config.yaml``           resolved nodes: ``transforms``, ``actor``, ``lidar``, ``robot``
``weights.safetensors``   the actor's weights
``metrics.json``          what it scored when it was saved
``card.md``               where it comes from, for people
========================  ===================================================================

A bundle may come from a stranger: loading runs no pickle, resolves no interpolation and builds only
the transforms, networks, lidars and robots that navrl exports.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from tensordict.nn import TensorDictModule

from navrl.policies.nodes import BundleError, build_node, check_nodes

FORMAT = "navrl-policy-1"
_PARTS = ("transforms", "actor", "lidar", "robot")


@dataclass(frozen=True)
class PolicyBundle:
    """A loaded policy.

    Args:
        folder: Where it was loaded from.
        config: Plain nodes by part.
        actor: Writes ``action`` in [-1, 1], weights loaded, in evaluation mode.
        metrics: What it scored when it was saved.
        allow: Packages beside navrl's parts whose targets may be built.
    """

    folder: Path
    config: dict[str, Any]
    actor: TensorDictModule
    metrics: dict[str, Any]
    allow: tuple[str, ...]

    def build(self, part: str, **overrides: Any) -> Any:
        """Build ``transforms``, ``actor``, ``lidar`` or ``robot`` anew."""
        return build_node({**self.config[part], **overrides}, self.allow, part)

    def actor_with_attention(self) -> TensorDictModule:
        """Return the actor with its attention weights as further outputs."""
        actor = self.build("actor", with_attention=True)
        actor.load_state_dict(self.actor.state_dict())
        return actor.eval()


def save_bundle(
    folder: str | Path,
    *,
    config: Mapping[str, Any],
    actor: TensorDictModule,
    metrics: Mapping[str, Any],
    card: str,
) -> None:
    """Write a bundle; an existing one is replaced only once the new one is complete.

    Args:
        folder: Where to.
        config: Plain nodes for ``transforms``, ``actor``, ``lidar`` and ``robot``; what else it
            holds is kept too.
        actor: Whose weights are saved.
        metrics: Plain numbers.
        card: Markdown.

    Raises:
        ValueError: If a part is missing or holds what is not plain data.
    """
    missing = [part for part in _PARTS if part not in config]
    if missing:
        raise ValueError(f"config: missing {missing}")
    try:
        text = yaml.dump({"format": FORMAT, **config}, Dumper=_PlainDumper, sort_keys=False)
    except yaml.YAMLError as error:
        raise ValueError(f"config: must be plain data ({error})") from error
    folder = Path(folder)
    fresh = folder.with_name(f".{folder.name}.{os.getpid()}.tmp")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    (fresh / "config.yaml").write_text(text, encoding="utf-8")
    state = actor.state_dict().items()
    weights = {name: value.detach().clone().contiguous() for name, value in state}
    save_file(weights, fresh / "weights.safetensors")
    (fresh / "weights.safetensors").chmod(0o644)  # it comes readable by its owner alone
    metrics_text = json.dumps(dict(metrics), indent=2) + "\n"
    (fresh / "metrics.json").write_text(metrics_text, encoding="utf-8")
    (fresh / "card.md").write_text(card, encoding="utf-8")
    old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
    if folder.exists():
        folder.rename(old)
    fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def load_bundle(folder: str | Path, allow: Sequence[str] = ()) -> PolicyBundle:
    """Load a bundle.

    Args:
        folder: Bundle folder.
        allow: Packages whose targets may be built too. Name only those you trust: their code is
            run.

    Raises:
        BundleError: If a file is missing, damaged or of another format, if the weights do not fit
            the network, or if the config names a target that is not allowed.
        ValueError: If ``allow`` is a single name.
    """
    if isinstance(allow, str):
        raise ValueError(f"allow={allow!r}: need a list of packages")
    folder, allow = Path(folder), tuple(allow)
    config = _read_config(folder / "config.yaml")
    for part in _PARTS:
        check_nodes(config[part], allow, part)
    metrics = _read_metrics(folder / "metrics.json")
    actor = build_node(config["actor"], allow, "actor")
    if not isinstance(actor, TensorDictModule):
        raise BundleError(f"actor: need a TensorDictModule, got {type(actor).__name__}")
    _load_weights(actor, folder / "weights.safetensors")
    return PolicyBundle(folder, config, actor.eval(), metrics, allow)


def saved_metrics(folder: str | Path) -> dict[str, Any] | None:
    """Return what the bundle in ``folder`` scored when it was saved; ``None`` without a bundle.

    Raises:
        BundleError: If the file of the scores is missing or damaged.
    """
    folder = Path(folder)
    return _read_metrics(folder / "metrics.json") if folder.is_dir() else None


def _read_config(file: Path) -> dict[str, Any]:
    try:
        config = yaml.load(file.read_text(encoding="utf-8"), Loader=_PlainLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise BundleError(f"{file}: {_reason(error)}") from error
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        found = config.get("format") if isinstance(config, dict) else type(config).__name__
        raise BundleError(f"{file}: format {found!r}, need {FORMAT!r}")
    missing = [part for part in _PARTS if not isinstance(config.get(part), dict)]
    if missing:
        raise BundleError(f"{file}: missing {missing}")
    return config


def _read_metrics(file: Path) -> dict[str, Any]:
    try:
        metrics = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise BundleError(f"{file}: {_reason(error)}") from error
    if not isinstance(metrics, dict):
        raise BundleError(f"{file}: need an object, got {type(metrics).__name__}")
    return metrics


def _load_weights(actor: TensorDictModule, file: Path) -> None:
    try:
        weights = load_file(file)
    except (OSError, SafetensorError) as error:
        raise BundleError(f"{file}: {_reason(error)}") from error
    try:
        actor.load_state_dict(weights)
    except RuntimeError as error:
        first, *others = str(error).split("\n\t")[1:] or [str(error)]
        more = f" (and {len(others)} more)" if others else ""
        raise BundleError(f"{file}: does not fit the actor: {first.strip()}{more}") from error


def _reason(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return getattr(error, "strerror", None) or str(error)


class _PlainLoader(yaml.SafeLoader):
    """Safe YAML without aliases: a few lines of those expand to gigabytes, or to themselves."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not allowed")
        return super().compose_node(parent, index)


class _PlainDumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True
