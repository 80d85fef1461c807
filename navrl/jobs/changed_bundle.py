"""Export of a changed policy as a bundle of its own."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from navrl.factory.overrides import PARTS, check_policy
from navrl.factory.policy import policy_name, with_parts
from navrl.factory.values import flat_values
from navrl.policies import load_bundle, save_bundle
from navrl.policies.names import bundle_folder
from navrl.policies.nodes import build_node
from navrl.training.provenance import code_version


def export_bundle(cfg: DictConfig, folder: Path) -> None:
    """Write ``cfg.policy``, perturbed and changed, as a bundle with the same weights.

    The bundle has no scores, because those of the unchanged policy are not its own. It is written
    only if it may be loaded without code outside navrl and ``cfg.allow``.

    Args:
        cfg: A composed ``conf/export.yaml``.
        folder: Destination; must not exist.

    Raises:
        ValueError: If the policy is a controller, or the folder exists.
        BundleError: If the bundle is damaged, or the changed one not allowed.
    """
    source = bundle_folder(cfg.policy)
    check_policy(cfg, is_bundle=source is not None)
    if source is None:
        raise ValueError(f"policy={cfg.policy}: must be a bundle, controllers have no weights")
    if folder.exists():
        raise ValueError(f"output={folder}: must not exist")
    bundle = load_bundle(source, cfg.allow)
    changed = with_parts(cfg, bundle.config)
    nodes = {part: OmegaConf.to_container(changed[part], resolve=True) for part in PARTS}
    for part, node in nodes.items():
        build_node(node, cfg.allow, part)  # as a loaded bundle: nothing is written if it fails
    card = _card(cfg)
    save_bundle(
        folder, config={**bundle.config, **nodes}, actor=bundle.actor, metrics={}, card=card
    )


def _card(cfg: DictConfig) -> str:
    changes = [f"{key}={value}" for key, value in flat_values(cfg.change).items()]
    lines = "\n".join(f"- `{change}`" for change in changes) or "- none"
    return (
        f"# {policy_name(cfg)}, changed\n\nThe weights of {policy_name(cfg)} with other settings "
        f"(navrl {code_version()}), perturbation {cfg.perturbation.name}. It has not been "
        "scored.\n\n"
        f"Changes:\n\n{lines}\n"
    )
