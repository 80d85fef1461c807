"""Named perturbations of an evaluation: what is not as in training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from navrl import keys
from navrl.config import compose
from navrl.factory.values import flat_values

UNPERTURBED = "none"
"""Name of the option without any perturbation."""

_REPLACED = ("robot", "lidar", "transforms")
_ADAPTED = {keys.RANGES: keys.RANGES_ADAPTED, keys.MEASURED: keys.MEASURED_ADAPTED}
_LAYOUT = ("num_beams", "angle_min", "angle_increment", "mount")


def perturbed_parts(cfg: DictConfig) -> dict[str, Any]:
    """Return the values of robot, lidar and transforms that replace those of the policy.

    Args:
        cfg: A composed configuration; without ``perturbation`` nothing is replaced.

    Returns:
        Plain nodes by part, without the parts that are not perturbed.
    """
    node = cfg.get("perturbation") or {}
    parts = {part: node[part] for part in _REPLACED if node.get(part)}
    return {
        part: cast(dict, OmegaConf.to_container(values, resolve=False))
        for part, values in parts.items()
    }


def with_policy_beams(
    cfg: DictConfig, parts: Mapping[str, Any], change: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the :func:`perturbed_parts`, a ScanAdapter among them with the policy's beams.

    The adapter writes keys of its own, which the poolings of raw scans read instead; the raw scans
    remain those of the lidar, whose changes its scanner follows.

    Args:
        cfg: A composed configuration.
        parts: Nodes of the policy, with its ``lidar`` and ``transforms``.
        change: Changes of the parts, which are merged later.

    Raises:
        ValueError: If the policy has a ScanAdapter of its own.
    """
    perturbed = perturbed_parts(cfg)
    steps = perturbed.get("transforms", {})
    if "scan_adapter" not in steps:
        return perturbed
    lidar = parts["lidar"]
    layout = {name: lidar[name] for name in _LAYOUT if name in lidar}  # others as by default
    nodes = {name: step for name, step in parts["transforms"].items() if isinstance(step, Mapping)}
    for name, step in nodes.items():
        if step.get("_target_") == steps["scan_adapter"]["_target_"]:
            raise ValueError(
                f"perturbation={cfg.perturbation.name}: must be none or no lidar for "
                f"policy={cfg.policy}, whose transforms.{name} adapts the scans of another lidar"
            )
    own = {name: _adapted(step, layout) for name, step in nodes.items()}
    own = {name: values for name, values in own.items() if values}
    adapter = {**steps["scan_adapter"], **layout, "max_range": lidar["max_range"]}
    changed = {name: value for name, value in change.get("lidar", {}).items() if name in _LAYOUT}
    mount = layout.get("mount", (0.0, 0.0, 0.0))
    adapter["scanner"] = {**adapter["scanner"], "mount": mount, **changed}
    return {**perturbed, "transforms": {**own, **steps, "scan_adapter": adapter}}


def _adapted(step: Mapping[str, Any], layout: Mapping[str, Any]) -> dict[str, Any]:
    """Return new values of a step after a ScanAdapter.

    Angles are those of the policy's lidar, to whose replacement a controller's step refers.
    """
    values = {key: value for key, value in layout.items() if key in step}
    if step.get("_target_") == "navrl.transforms.MinPool":
        in_keys = step.get("in_keys", [keys.RANGES])
        values["in_keys"] = [_ADAPTED.get(key, key) for key in in_keys]
    return values


def perturbation_summary(cfg: DictConfig) -> dict[str, dict[str, str]]:
    """Return name, kind and label of the perturbation for a summary; empty without one."""
    node = cfg.get("perturbation")
    if node is None or node.name == UNPERTURBED:
        return {}
    return {"perturbation": {name: str(node[name]) for name in ("name", "kind", "about")}}


def check_perturbation(cfg: DictConfig) -> None:
    """Check that no override contradicts the perturbation, whose name is in the results.

    Args:
        cfg: A composed ``conf/evaluate.yaml`` or ``conf/play.yaml``.

    Raises:
        ValueError: If a value of the perturbation was overridden.
    """
    name = cfg.perturbation.name
    if name == UNPERTURBED and not perturbed_parts(cfg):
        return
    unperturbed, found = flat_values(compose("evaluate")), flat_values(cfg)
    wanted = flat_values(compose("evaluate", [f"perturbation={name}"]))
    fixed = ("perturbation.", "robot.") if cfg.perturbation.robot else ("perturbation.",)
    for key in {**wanted, **found}:
        is_set = key.startswith(fixed) or unperturbed.get(key) != wanted.get(key)
        is_set &= not key.startswith("environment.")  # a time limit of one's own is allowed
        if is_set and found.get(key) != wanted.get(key):
            raise ValueError(
                f"{key}={found.get(key)}: must be {wanted.get(key)} for perturbation={name}; a "
                "perturbation of your own may have other values, see docs/robustness.md"
            )
