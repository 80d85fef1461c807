"""Deprecated alias of :mod:`navrl.networks.saturation`, for one release."""

from navrl.deprecation import renamed_attributes

__getattr__ = renamed_attributes(
    __name__, {"restrain": "navrl.networks.saturation.penalize_saturation"}
)
