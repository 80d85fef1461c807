"""Choices of the episodes to save as recordings; importing this loads no torch."""

KEPT = ("none", "failures", "all")
"""Values of ``recordings``."""


def is_kept(outcome: str, keep: str) -> bool:
    """Return whether an episode is saved.

    Args:
        outcome: As in ``episodes.csv``.
        keep: One of :data:`KEPT`.
    """
    return keep == "all" or (keep == "failures" and outcome != "success")
