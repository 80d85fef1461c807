"""Start of a training from the weights of a saved policy or of another run."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModule
from torch import Tensor

from navrl.algos import Algorithm
from navrl.config import target_packages
from navrl.policies import load_bundle
from navrl.policies.names import bundle_folder, zoo_names
from navrl.training.checkpoint import CheckpointStore

log = logging.getLogger(__name__)

Weights = Mapping[str, Tensor]


def is_resumed(folder: Path) -> bool:
    """Return whether the run in ``folder`` has a checkpoint, whose weights it continues from."""
    return CheckpointStore(folder / "checkpoint").exists


def start_actor(cfg: DictConfig, actor: TensorDictModule) -> None:
    """Copy the weights of the bundle ``cfg.warm_start`` to the layers of ``actor`` that match.

    Args:
        cfg: A composed ``conf/train.yaml``; the packages of its classes are trusted in the bundle.
        actor: Actor, modified in place.

    Raises:
        ValueError: If there is no such bundle, or none of its layers matches.
        BundleError: If the bundle is damaged or not allowed.
    """
    folder = bundle_folder(cfg.warm_start)
    if folder is None:
        raise ValueError(
            f"warm_start={cfg.warm_start}: must be null, the folder of a run or bundle, or one of "
            f"{', '.join(zoo_names())}"
        )
    saved = load_bundle(folder, sorted(target_packages(cfg) - {"navrl"})).actor.state_dict()
    own = actor.state_dict()
    taken = matching_layers(saved, own)
    if not taken:
        raise ValueError(
            f"warm_start={cfg.warm_start}: must have a layer of the same name and shapes as the "
            f"actor of network={cfg.network.get('encoder', {}).get('_target_', 'this run')}, "
            f"e.g. {_shapes(own)}; it has {_shapes(saved)}"
        )
    actor.load_state_dict({**own, **taken})
    _report("actor", cfg.warm_start, taken, own)


def start_critic(cfg: DictConfig, algorithm: Algorithm) -> None:
    """Copy the critic, with its targets, from the checkpoint of the run ``cfg.warm_start``.

    Bundles have no critic, and neither has a run of another algorithm under the same name: then the
    critic keeps its initial weights, which is logged.

    Args:
        cfg: A composed ``conf/train.yaml``.
        algorithm: Algorithm, modified in place.

    Raises:
        CheckpointError: If the checkpoint is damaged.
    """
    folder = Path(cfg.warm_start)
    folder = folder.parent if folder.name == "policy" else folder
    if not is_resumed(folder):
        log.info("warm_start=%s: has no critic; it has initial weights", cfg.warm_start)
        return
    state = algorithm.state_dict()
    saved = CheckpointStore(folder / "checkpoint").load()["algorithm"].get("loss", {})
    own = _of_critic(state.get("loss", {}))
    taken = matching_layers(_of_critic(saved), own)
    if taken:
        state["loss"].update(taken)
        algorithm.load_state_dict(state)
    _report("critic", cfg.warm_start, taken, own)


def matching_layers(saved: Weights, own: Weights) -> dict[str, Tensor]:
    """Return the saved tensors of layers all of whose tensors match by name and shape.

    A linear layer with more inputs than saved matches too: further inputs are appended by streams
    at the end of an encoder, and their weights are zero, so the network answers as before.

    Example:
        >>> import torch
        >>> layer = {"0.weight": torch.ones(2, 3), "0.bias": torch.ones(2)}
        >>> list(matching_layers(layer, {**layer, "1.bias": torch.ones(1)}))
        ['0.weight', '0.bias']
        >>> matching_layers(layer, {**layer, "0.weight": torch.ones(2, 4)})["0.weight"][0]
        tensor([1., 1., 1., 0.])
        >>> matching_layers(layer, {**layer, "0.weight": torch.ones(3, 3)})
        {}
    """
    saved = {name: _widened(value, own.get(name)) for name, value in saved.items()}
    differ = {
        _layer(name)
        for name, value in own.items()
        if name not in saved or saved[name].shape != value.shape
    }
    return {name: saved[name] for name in own if _layer(name) not in differ}


def _widened(saved: Tensor, own: Tensor | None) -> Tensor:
    """Return weights ``[out, in]`` with zeros for the further inputs of the own layer."""
    if own is None or saved.ndim != 2 or own.ndim != 2:
        return saved
    missing = own.shape[1] - saved.shape[1]
    return saved if missing <= 0 else torch.nn.functional.pad(saved, (0, missing))


def _of_critic(loss: Mapping[str, Any]) -> dict[str, Tensor]:
    """Return the weights of a loss module that are not the actor's."""
    return {
        name: value
        for name, value in loss.items()
        if isinstance(value, Tensor) and "value_network_params" in name
    }


def _layer(name: str) -> str:
    return name.rpartition(".")[0]


def _shapes(weights: Weights) -> str:
    first = list(weights.items())[:2]
    return ", ".join(f"{name} {list(value.shape)}" for name, value in first)


def _report(network: str, source: str, taken: Weights, own: Weights) -> None:
    """Log how many layers were taken, and the names of those with initial weights."""
    fresh = sorted({_layer(name) for name in own.keys() - taken.keys()})
    count = len({_layer(name) for name in own})
    log.info(
        "warm_start=%s: %d of %d layers of the %s; initialized: %s",
        source,
        count - len(fresh),
        count,
        network,
        ", ".join(fresh) or "none",
    )
