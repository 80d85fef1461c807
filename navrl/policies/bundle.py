"""Policy bundles: folders with weights and everything needed to run them.

========================  ===================================================================
file                      content
========================  ===================================================================
``config.yaml``           resolved nodes: ``transforms``, ``actor``, ``lidar``, ``robot``
``weights.safetensors``   the actor's weights
``metrics.json``          scores at the time of saving
``card.md``               model card: provenance and scores
========================  ===================================================================

A bundle may be untrusted: loading uses no pickle, resolves no interpolation and builds only the
transforms, networks, lidars and robots that navrl exports.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from tensordict.nn import TensorDictModule

from navrl.deprecation import renamed_inputs, renamed_keys
from navrl.files import replacing, write_json, write_text
from navrl.policies.limits import check_limits, check_weights, put_weights
from navrl.policies.names import bundle_folder, zoo_names
from navrl.policies.nodes import BundleError, build_node, check_nodes, reason
from navrl.policies.plausibility import (
    KINDS,
    check_finite_weights,
    check_part,
    check_weights_kind,
)
from navrl.untrusted import DamagedFileError, read_json, read_yaml

FORMAT = "navrl-policy-1"
_PARTS = ("transforms", "actor", "lidar", "robot")
_REMEDY = "get the bundle again, or save it again"


@dataclass(frozen=True)
class PolicyBundle:
    """Loaded policy bundle.

    Args:
        folder: Folder of the bundle.
        config: Plain configuration nodes by part.
        actor: Writes ``action`` in [-1, 1], weights loaded, in evaluation mode.
        metrics: Scores at the time of saving.
        allow: Trusted packages, besides navrl's parts, whose targets may be built.
    """

    folder: Path
    config: dict[str, Any]
    actor: TensorDictModule
    metrics: dict[str, Any]
    allow: tuple[str, ...]

    def build(self, part: str, **overrides: Any) -> Any:
        """Build a new ``transforms``, ``actor``, ``lidar`` or ``robot``."""
        return build_node({**self.config[part], **overrides}, self.allow, part)

    def actor_with_attention(self) -> TensorDictModule:
        """Return the actor with its attention weights as additional outputs."""
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
    """Write a bundle; an existing one is replaced when the new one is complete.

    Args:
        folder: Destination.
        config: Plain nodes for ``transforms``, ``actor``, ``lidar`` and ``robot``; other keys are
            saved too.
        actor: Network whose weights are saved.
        metrics: Scores, plain numbers.
        card: Model card in Markdown.

    Raises:
        OSError: If a file cannot be written; an existing bundle is retained.
        ValueError: If a part is missing or is not plain data, or if a weight is not finite.
    """
    check_finite_weights(actor, "actor")
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
    try:
        write_text(fresh / "config.yaml", text)
        state = actor.state_dict().items()
        with replacing(fresh / "weights.safetensors") as stream:
            stream.write(save({k: value.detach().clone().contiguous() for k, value in state}))
        write_json(fresh / "metrics.json", dict(metrics), indent=2)
        write_text(fresh / "card.md", card)
        old = folder.with_name(f".{folder.name}.{os.getpid()}.old")
        if folder.exists():
            folder.rename(old)
        fresh.rename(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)


def load_bundle(folder: str | Path, allow: Sequence[str] = ()) -> PolicyBundle:
    """Load a bundle.

    Args:
        folder: Bundle folder.
        allow: Additional packages whose targets may be built. Name only those you trust: their code
            is run.

    Raises:
        BundleError: If a file is missing, damaged or of another format, if the weights do not fit
            the network or are not finite, if the config names a target that is not allowed, if a
            part cannot be built, if a number is beyond :mod:`navrl.policies.limits`, or if the
            robot's limits are beyond :mod:`navrl.policies.plausibility`.
        ValueError: If ``allow`` is a single name.
    """
    if isinstance(allow, str):
        raise ValueError(f"allow={allow!r}: must be a list of packages")
    folder, allow = Path(folder), tuple(allow)
    config = _read_config(folder / "config.yaml")
    for part in _PARTS:
        check_nodes(config[part], allow, part)
        check_limits(config[part], part)
    metrics = _read(read_json, folder / "metrics.json")
    check_weights(config["actor"], folder / "weights.safetensors", allow)
    actor = build_node(config["actor"], allow, "actor")
    if not isinstance(actor, TensorDictModule):
        raise BundleError(f"actor: must be a TensorDictModule, got {type(actor).__name__}")
    _load_weights(actor, folder / "weights.safetensors")
    bundle = PolicyBundle(folder, config, actor.eval(), metrics, allow)
    for part in KINDS:
        check_part(part, bundle.build(part))
    return bundle


def _read(reader: Callable[[Path, str], dict[str, Any]], file: Path) -> dict[str, Any]:
    try:
        return reader(file, _REMEDY)
    except DamagedFileError as error:
        raise BundleError(str(error)) from error
    except OSError as error:
        raise BundleError(f"{file}: {reason(error)}") from error


def load_actor(policy: str, allow: Sequence[str] = ()) -> TensorDictModule:
    """Load the network of a bundle, e.g. as a guide of a training with the same observations.

    Args:
        policy: Name in the zoo, folder of a bundle or of a training run.
        allow: See :func:`load_bundle`.

    Raises:
        BundleError: If there is no such bundle, or it is damaged or not allowed.

    Example:
        >>> load_actor("paper").in_keys
        ['spatial', 'waypoints_scaled', 'temporal']
    """
    folder = bundle_folder(policy)
    if folder is None:
        raise BundleError(f"policy={policy}: must be a bundle or one of {', '.join(zoo_names())}")
    return load_bundle(folder, allow).actor


def saved_metrics(folder: str | Path) -> dict[str, Any] | None:
    """Return the saved scores of the bundle in ``folder``; ``None`` without a bundle.

    Raises:
        BundleError: If the file of the scores is missing or damaged.
    """
    folder = Path(folder)
    return _read(read_json, folder / "metrics.json") if folder.is_dir() else None


def _read_config(file: Path) -> dict[str, Any]:
    config = renamed_inputs(renamed_keys(_read(read_yaml, file), is_silent=True))
    if config.get("format") != FORMAT:
        raise BundleError(f"{file}: format={config.get('format')!r}: must be {FORMAT!r}")
    missing = [part for part in _PARTS if not isinstance(config.get(part), dict)]
    if missing:
        raise BundleError(f"{file}: missing {missing}")
    return config


def _load_weights(actor: TensorDictModule, file: Path) -> None:
    try:
        weights = load_file(file)
    except (OSError, SafetensorError) as error:
        raise BundleError(f"{file}: {reason(error)}; {_REMEDY}") from error
    check_weights_kind(weights, actor, str(file))
    put_weights(actor, weights, file)
    check_finite_weights(actor, str(file))


class _PlainDumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True
