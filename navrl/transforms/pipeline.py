"""Composition of named transforms to a pipeline."""

from __future__ import annotations

from torchrl.envs import Compose, Transform


def compose(**steps: Transform | None) -> Compose:
    """Chain named transforms in the given order.

    Names make each step of a configuration addressable: a user can override a value of a step,
    replace it, append another, or remove it with ``null``.

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
    return Compose([step for step in steps.values() if step is not None])
