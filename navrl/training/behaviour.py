"""Deprecated alias of :mod:`navrl.training.behavior`, for one release."""

from navrl.deprecation import renamed_attributes

__getattr__ = renamed_attributes(__name__, {"Behaviour": "navrl.training.behavior.Behavior"})
