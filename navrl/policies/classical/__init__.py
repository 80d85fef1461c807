"""Controllers that learn nothing."""

from navrl.policies.classical.pure_pursuit import PurePursuit

__all__ = ["PurePursuit"]
