"""Export of a policy to an ONNX file with a golden drive."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, open_dict

from navrl import keys
from navrl.config import instantiate
from navrl.deploy import PolicyRunner
from navrl.evaluation.recording import Recording
from navrl.export import DriveGraph, ExportError, export_network, export_policy
from navrl.export.golden import record as record_golden
from navrl.export.onnx_policy import TOLERANCE, OnnxPolicy, run_network
from navrl.extras import require
from navrl.factory.overrides import PARTS, check_policy
from navrl.factory.policy import policy_name, with_parts
from navrl.jobs.evaluation import record
from navrl.policies import PolicyBundle, load_bundle
from navrl.policies.names import bundle_folder
from navrl.training.provenance import code_version


def export(cfg: DictConfig, file: Path) -> float:
    """Write ``cfg.policy`` to an ONNX file and compare it with the runner.

    Args:
        cfg: A composed ``conf/export.yaml``.
        file: Destination.

    Returns:
        The largest difference between a command of the file and one of the runner, m/s and rad/s;
        for a network alone, of the action.

    Raises:
        ValueError: If the policy is a controller, a value is out of range, or the policy has no
            ONNX form.
        ExportError: If the written file differs from the runner; it is removed.
        BundleError: If the bundle is damaged or not allowed.
        ModuleNotFoundError: If the extra ``onnx`` is not installed.
    """
    require("onnx", "navrl-export", "onnx", "onnxscript", "onnxruntime")
    folder = bundle_folder(cfg.policy)
    check_policy(cfg, is_bundle=folder is not None)
    if folder is None:
        raise ValueError(f"policy={cfg.policy}: must be a bundle, controllers have no ONNX form")
    if cfg.golden_steps < 1:
        raise ValueError(f"golden_steps={cfg.golden_steps}: must be at least 1")
    bundle = load_bundle(folder, cfg.allow)
    parts = [instantiate(with_parts(cfg, bundle.config)[key]) for key in PARTS]
    write = _write_network if cfg.network_only else _write_policy
    error = write(cfg, bundle, parts, file)
    if not error <= TOLERANCE:
        file.unlink()
        raise ExportError(f"{file}: must be within {TOLERANCE:g} of the runner, off by {error:g}")
    return error


def _write_policy(cfg: DictConfig, bundle: PolicyBundle, parts: list[Any], file: Path) -> float:
    """Write scan to command; return the largest error over the golden drive."""
    transforms, lidar, robot = parts
    graph = DriveGraph(transforms, bundle.actor, lidar, robot)
    runner = PolicyRunner(transforms, bundle.actor, lidar, robot)
    golden = record_golden(runner, _drives(cfg), list(graph.sensors), cfg.golden_steps)
    export_policy(graph, file, golden, _metadata(cfg, parts, graph.time_step_s))
    return float(OnnxPolicy(file, check_steps=0).golden_errors().max())


def _write_network(cfg: DictConfig, bundle: PolicyBundle, parts: list[Any], file: Path) -> float:
    """Write the network alone; return the largest error over random inputs."""
    sizes = bundle.config["actor"]["shapes"]
    shapes = {str(key): list(sizes[key]) for key in bundle.actor.in_keys}
    generator = torch.Generator().manual_seed(0)
    inputs = {
        key: 2.0 * torch.rand(cfg.golden_steps, *shape, generator=generator) - 1.0
        for key, shape in shapes.items()
    }
    with torch.no_grad():
        expected = bundle.actor.module(*inputs.values()).numpy()
    golden = {key: value.numpy() for key, value in inputs.items()}
    metadata = _metadata(cfg, parts, bundle.config.get("time_step_s", 0.2))
    export_network(bundle.actor, shapes, file, {**golden, keys.ACTION: expected}, metadata)
    return float(np.abs(run_network(file, golden) - expected).max())


def _drives(cfg: DictConfig) -> Iterator[dict[str, np.ndarray]]:
    """Yield the sensor values of the episodes of the suite."""
    for episode in range(cfg.suite.num_episodes):
        yield _sensed(record(_episode(cfg, episode)))


def _episode(cfg: DictConfig, index: int) -> DictConfig:
    cfg = cfg.copy()
    with open_dict(cfg):
        cfg.episode = index
    return cfg


def _sensed(recording: Recording) -> dict[str, np.ndarray]:
    """Return the sensor values of an episode, with the last command as velocity."""
    steps = recording.num_steps
    before = np.zeros_like(recording.action[:1])
    return {
        keys.RANGES: np.asarray(recording.ranges)[:steps],
        keys.POSE: np.asarray(recording.pose)[:steps],
        keys.PATH: np.asarray(recording.path),
        keys.VELOCITY: np.concatenate([before, recording.action[: steps - 1]]),
    }


def _metadata(cfg: DictConfig, parts: list[Any], time_step_s: float) -> dict[str, Any]:
    _, lidar, robot = parts
    lower, upper = robot.command_limits
    return {
        "policy": policy_name(cfg),
        "navrl": code_version(),
        "time_step_s": float(time_step_s),
        "num_beams": lidar.num_beams,
        "max_range_m": lidar.max_range,
        "angle_min_rad": lidar.angle_min,
        "angle_increment_rad": lidar.increment,
        "mount": list(lidar.mount),
        "robot": type(robot).__name__,
        "robot_radius_m": float(robot.radius),
        "command_limits": [list(map(float, lower)), list(map(float, upper))],
    }
