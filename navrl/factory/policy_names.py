"""Check the name of a policy without building it; importing this loads no torch."""

from __future__ import annotations

from navrl.config import did_you_mean, options
from navrl.policies.foreign import KINDS, foreign_node
from navrl.policies.names import bundle_folder, zoo_names

POLICY_SETS = ("all", "zoo", "controllers")
"""Words that stand for several policies in a sweep."""


def check_policy_name(policy: str) -> None:
    """Check that a name stands for a bundle, a controller or a policy from outside navrl.

    Raises:
        ValueError: If it does not, with the nearest names and all those there are.
    """
    known = options("controller")
    if policy in known or bundle_folder(policy) is not None:
        return
    if foreign_node(policy) is not None:
        return
    if policy in POLICY_SETS:
        raise ValueError(f"policy={policy}: must be one policy; for several use navrl-evaluate -m")
    near = did_you_mean(policy, [*zoo_names(), *known])
    raise ValueError(
        f"policy={policy}: no such bundle or controller{near}; "
        f"controllers: {known}, zoo: {zoo_names()}, the folder of a bundle or of a training run, "
        f"or {KINDS}"
    )
