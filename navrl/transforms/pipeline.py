"""Composition of named transforms to a pipeline."""

from __future__ import annotations

from torchrl.envs import Compose, Transform

AFTER_POOLING = ("motion_prediction", "motion_compensation", "full_range", "pose_history")
"""Names of steps that follow ``min_pool``, in this order, wherever they are added."""


def compose(**steps: Transform | None) -> Compose:
    """Chain named transforms in the given order, those of :data:`AFTER_POOLING` after the pooling.

    Names make each step of a configuration addressable: a user can override a value of a step,
    replace it, append another, or remove it with ``null``. A bundle without, say,
    ``motion_compensation`` can be extended with it, although its configuration ends with others.

    Args:
        **steps: Transforms by name; None omits a step.

    Returns:
        The chain of the steps that are not None.

    Raises:
        ValueError: If a step is not a transform; the message names it.

    Example:
        >>> from navrl.transforms import MinPool, ScanHistory
        >>> len(compose(min_pool=MinPool(), scan_history=ScanHistory(), waypoints=None))
        2
    """
    for name, step in steps.items():
        if step is not None and not isinstance(step, Transform):
            raise ValueError(f"transforms.{name}={step!r}: must be a TorchRL Transform or null")
    return Compose([steps[name] for name in _ordered(list(steps)) if steps[name] is not None])


def _ordered(names: list[str]) -> list[str]:
    if "min_pool" not in names:
        return names
    moved = [name for name in AFTER_POOLING if name in names]
    others = [name for name in names if name not in moved]
    after = others.index("min_pool") + 1
    return [*others[:after], *moved, *others[after:]]
