"""Named steps to one transform."""

from __future__ import annotations

from torchrl.envs import Compose, Transform


def compose(**steps: Transform | None) -> Compose:
    """Chain named transforms in the order given.

    Names make each step of a configuration addressable: override one of its values, replace it,
    append another, or remove it with ``null``.

    Args:
        **steps: Transforms by name; None leaves a step out.

    Returns:
        The chain of the steps that are left.

    Raises:
        ValueError: If a step is not a transform, naming it.

    Example:
        >>> from navrl.transforms import MinPool, ScanHistory
        >>> len(compose(min_pool=MinPool(), scan_history=ScanHistory(), waypoints=None))
        2
    """
    for name, step in steps.items():
        if step is not None and not isinstance(step, Transform):
            raise ValueError(f"step {name!r} must be a torchrl Transform or null, got {step!r}")
    return Compose(*(step for step in steps.values() if step is not None))
